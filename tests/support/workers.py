"""Folders that all workers of pytest-xdist share, so that what takes long is made once in a run of the tests."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest


def shared_folder(factory: pytest.TempPathFactory, name: str) -> Path:
    """Make a folder that all workers of this run see."""
    base = factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / name
    folder.mkdir(exist_ok=True)
    return folder


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """Let `make` fill a shared folder, unless another worker has; wait while one does."""
    from filelock import FileLock  # torch needs it too, and what needs torch is what takes long

    folder = shared_folder(factory, name)
    done = folder.with_name(f"{name}.done")
    with FileLock(folder.with_name(f"{name}.lock")):
        if not done.is_file():
            make(folder)
            done.touch()
    return folder
