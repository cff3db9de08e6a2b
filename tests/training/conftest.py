"""Fixtures of training and export: one run at the size of a toy."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.workers import made_once


@pytest.fixture(scope="session")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a toy's `data` and `run`; only read it."""
    for needed in ("torch", "lightning", "spacy"):
        pytest.importorskip(needed)
    from support.toy_run import train

    return made_once(tmp_path_factory, "toy", train)
