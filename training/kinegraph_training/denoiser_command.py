"""What the commands share that train denoisers, of latents and of frames: their arguments, and their trainer."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lightning as L
import torch
from torch.utils.data import DataLoader

from kinegraph_training.checkpoints import fit
from kinegraph_training.config import OptimiserConfig, Preset, read_preset
from kinegraph_training.denoiser_module import HideLate
from kinegraph_training.trainer import add_common_arguments, lightning_flags, make_trainer

VALIDATE_EVERY = 500
"""Steps between validations, and between checkpoints."""


@dataclass(frozen=True)
class DenoiserCommand:
    """What a command line asks for."""

    arguments: argparse.Namespace
    preset: Preset
    lightning: dict[str, Any]
    """Further arguments of `lightning.Trainer`."""


def read_command(
    name: str, doc: str, argv: list[str] | None, declare: Callable[[argparse.ArgumentParser], None] | None = None
) -> DenoiserCommand:
    """Read the command line of a module, and seed every generator as its preset says.

    Args:
        name: of the module.
        doc: its docstring.
        argv: the words; None takes those of the process.
        declare: adds the arguments that this module alone has.
    """
    parser = argparse.ArgumentParser(prog=f"kinegraph_training.{name}", description=doc.split("\n")[0])
    add_common_arguments(parser)
    parser.add_argument(
        "--assets", type=Path, required=True, help="folder with text_encoder.onnx, tokenizer.json, parser.bin"
    )
    if declare:
        declare(parser)
    arguments, words = parser.parse_known_args(argv)
    command = DenoiserCommand(arguments, read_preset(arguments.preset), lightning_flags(words))
    if arguments.threads:
        torch.set_num_threads(arguments.threads)
    L.seed_everything(command.preset.seed)
    return command


def fit_denoisers(
    command: DenoiserCommand,
    stage: Path,
    config: OptimiserConfig,
    module: L.LightningModule,
    batches: tuple[DataLoader, DataLoader],
    callbacks: Sequence[L.Callback] = (),
) -> None:
    """Train to the end, from where a stopped run left off.

    Args:
        command: of `read_command`.
        stage: folder of the checkpoints.
        config: of the stage.
        module: to train.
        batches: of training and of validation.
        callbacks: of the stage, beside those of all.
    """
    train_batches, val_batches = batches
    collate: Any = train_batches.collate_fn
    trainer = make_trainer(
        stage,
        config,
        validate_every=min(VALIDATE_EVERY, config.steps),
        lightning=command.lightning,
        callbacks=[HideLate(collate, command.preset.data.hide_from * config.steps), *callbacks],
    )
    fit(trainer, module, train_batches, val_batches, stage)
