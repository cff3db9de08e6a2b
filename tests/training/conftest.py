"""What several test files of training and export start from."""

from __future__ import annotations

from pathlib import Path

import pytest

import kinegraph

PARSER = Path(kinegraph.__file__).parent / "bundles" / "default" / "parser.bin"


@pytest.fixture(scope="session")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a toy's `data` and `run`; only read it."""
    for needed in ("torch", "lightning", "spacy"):
        pytest.importorskip(needed)
    if not PARSER.is_file():
        pytest.skip("no default bundle to take the text files from")
    from support.toy_run import train

    folder = tmp_path_factory.mktemp("toy")
    train(folder)
    return folder
