"""PyInstaller hooks, registered as an entry point: a frozen program needs no flags for kinegraph."""

from __future__ import annotations

from pathlib import Path


def hook_directories() -> list[str]:
    """List the folders with `hook-*.py` files."""
    return [str(Path(__file__).parent)]
