"""Graphs of constraints are added to a bundle as a whole, or the bundle stays what it was."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import pytest

pytest.importorskip("torch")
pytest.importorskip("onnx")

from kinegraph.bundle.contract import DECODER_GRADIENTS
from kinegraph.bundle.manifest import encode_manifest
from kinegraph.bundle.reader import read_bundle
from kinegraph.errors import BundleError
from kinegraph_export import add_gradients as command
from support.toy import TOY_BUNDLE

ADDED = ("encoder.onnx", *(f"{name}.onnx" for name in DECODER_GRADIENTS.values()))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The toy bundle without what constraints need."""
    folder = tmp_path / "bundle"
    shutil.copytree(TOY_BUNDLE, folder)
    manifest = read_bundle(folder).manifest
    for name in ADDED:
        (folder / name).unlink()
    files, operators = (
        {name: value for name, value in listed.items() if name not in ADDED}
        for listed in (manifest.files, manifest.operators)
    )
    parity = {name: value for name, value in manifest.parity.items() if f"{name}.onnx" not in ADDED}
    lean = dataclasses.replace(manifest, files=files, operators=operators, parity=parity)
    (folder / "manifest.json").write_bytes(encode_manifest(lean))
    read_bundle(folder)
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_what_is_added_is_told_in_the_manifest(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = {name: (TOY_BUNDLE / name).read_bytes() for name in ADDED}
    monkeypatch.setattr(command, "constraint_graphs", lambda *_: (dict(made), {"encoder": 1e-6}))
    assert command.add_gradients(folder, tmp_path) == {"encoder": 1e-6}
    manifest, whole = read_bundle(folder).manifest, read_bundle(TOY_BUNDLE).manifest
    assert manifest.files.keys() == whole.files.keys() and manifest.operators == whole.operators
    assert manifest.parity["encoder"] == 1e-6 and "decoder" in manifest.parity
    assert {name: (folder / name).read_bytes() for name in ADDED} == made


def test_a_bundle_that_would_be_refused_stays_what_it_was(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = contents(folder)
    made = {name: (TOY_BUNDLE / name).read_bytes() for name in ADDED}
    made["encoder.onnx"] = before["decoder.onnx"]
    monkeypatch.setattr(command, "constraint_graphs", lambda *_: (dict(made), {}))
    with pytest.raises(BundleError, match=r"encoder\.onnx"):
        command.add_gradients(folder, tmp_path)
    assert contents(folder) == before
