"""Found by PyInstaller through an entry point, so that a frozen program needs no flags for kinegraph."""

from __future__ import annotations

from pathlib import Path


def hook_directories() -> list[str]:
    """Folders with `hook-*.py` files."""
    return [str(Path(__file__).parent)]
