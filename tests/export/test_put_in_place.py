"""A bundle's folder is replaced as a whole, or stays what it was."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("torch")
pytest.importorskip("onnxscript")

from kinegraph_export.export_bundle import put_in_place


def make(folder: Path, text: str) -> Path:
    folder.mkdir()
    (folder / "manifest.json").write_text(text)
    return folder


def test_a_folder_takes_the_place_of_another(tmp_path: Path) -> None:
    staged, out = make(tmp_path / "staged", "new"), make(tmp_path / "bundle", "old")
    (out / "gone.onnx").write_text("old")
    put_in_place(staged, out)
    assert [path.name for path in out.iterdir()] == ["manifest.json"] and (out / "manifest.json").read_text() == "new"
    put_in_place(staged, tmp_path / "deeper" / "bundle")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bundle", "deeper", "staged"]


def test_a_copy_that_fails_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    staged, out = make(tmp_path / "staged", "new"), make(tmp_path / "bundle", "old")

    def full(*_: Any) -> None:
        raise OSError("no space left")

    with monkeypatch.context() as patched, pytest.raises(OSError, match="no space"):
        patched.setattr(shutil, "copytree", full)
        put_in_place(staged, out)
    assert (out / "manifest.json").read_text() == "old"
    put_in_place(staged, out)  # what was left behind is no hindrance
    assert (out / "manifest.json").read_text() == "new"
