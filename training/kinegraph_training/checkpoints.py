"""Checkpoints: tensors and plain values, read without running anything that somebody put into the file.

`torch.load` unpickles; with `weights_only` it builds tensors, numbers, strings and containers alone (PyTorch, notes on
serialization semantics). Everything that training and export take from users goes through here.
"""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import lightning as L
import torch

from kinegraph.errors import InvalidInputError


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint that torch saved.

    Raises:
        InvalidInputError: missing, cut short, no checkpoint, or one that holds more than tensors and plain values.
    """
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        raise InvalidInputError(
            f"{path} is no checkpoint of tensors and plain values; it may hold code, and is not opened"
        ) from error
    except (OSError, RuntimeError, EOFError, ValueError, KeyError, IndexError, TypeError, AttributeError) as error:
        raise InvalidInputError(f"{path} is no checkpoint that can be read ({str(error)[:200]})") from error
    if not isinstance(state, dict):
        raise InvalidInputError(f"{path} holds no dictionary, as checkpoints do")
    return state


def last_checkpoint(run: Path) -> str | None:
    """Return the checkpoint to resume from, if the run was started before."""
    path = run / "last.ckpt"
    return str(path) if path.is_file() else None


def fit(trainer: L.Trainer, module: L.LightningModule, train: Any, val: Any, run: Path) -> None:
    """Train a module, from the last checkpoint of its run if there is one.

    Raises:
        InvalidInputError: that checkpoint holds more than tensors and plain values.
    """
    try:
        trainer.fit(module, train, val, ckpt_path=last_checkpoint(run), weights_only=True)
    except pickle.UnpicklingError as error:
        raise InvalidInputError(
            f"{last_checkpoint(run)} is no checkpoint of tensors and plain values; it may hold code, and is not opened"
        ) from error
