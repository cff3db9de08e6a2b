"""A training run of the preset `tiny`: sixteen clips of a stick figure, all stages, six steps each."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from unittest import mock

import torch

from kinegraph.bundle.reader import text_files_folder
from kinegraph_training import train_denoisers, train_vae, trainer
from kinegraph_training.data.folder import PreparedClip, write_data
from support.motions import walk

ASSETS = text_files_folder()

CARD: Mapping[str, object] = {
    "name": "made", "version": "0", "training_data": "made by the tests", "scope": {}, "training": {}, "quality": {},
    "licence": dict.fromkeys(("code", "weights", "data", "text_encoder", "parser"), "public domain"),
    "steps": {"motion": 2, "action": 2, "specific": 3}, "guidance": {"motion": 2.0, "action": 2.0, "specific": 2.0},
    "guidance_base": "coarse", "seconds": 2.0,
}  # fmt: skip
"""Of an exported bundle."""


def write_walks(folder: Path) -> None:
    """Write sixteen clips of a stick figure whose captions name the side they turn to."""
    clips = []
    for number in range(16):
        side = "left" if number % 2 else "right"
        turning = 0.02 if number % 2 else -0.02
        joints = walk(40 + 4 * number, turning=turning, speed=0.03 + 0.002 * number)
        split = "val" if number in (4, 5) else "train"
        clips.append(PreparedClip(f"walk{number}", joints, (f"a person walks to the {side}",), "made", split))
    write_data(folder, clips, 20)


def run_stage(module: object, folder: Path, *more: str, preset: str = "tiny", curves: bool = False) -> None:
    """Run one command of training on the data and the run in `folder`; drawing its curves would take as long again."""
    words = ["--data", str(folder / "data"), "--run", str(folder / "run"), "--preset", preset, "--threads", "1"]
    flags = ["--enable_progress_bar", "0", "--accelerator", "cpu"]
    with nullcontext() if curves else mock.patch.object(trainer, "draw_curves"):
        module.main([*words, *more, *flags])  # type: ignore[attr-defined]


def steps_of(checkpoint: Path) -> int:
    """Read how many steps a checkpoint has been trained."""
    return int(torch.load(checkpoint, weights_only=True, map_location="cpu")["global_step"])


def train(folder: Path) -> None:
    """Write the data and train all stages; the denoisers stop half-way and the same command resumes them."""
    write_walks(folder / "data")
    for level in ("motion", "action", "specific"):
        run_stage(train_vae, folder, "--level", level, curves=True)
    run_stage(train_denoisers, folder, "--assets", str(ASSETS), "--max_steps", "3", "--val_check_interval", "3")
    assert steps_of(folder / "run" / "denoisers" / "last.ckpt") == 3
    run_stage(train_denoisers, folder, "--assets", str(ASSETS), curves=True)
