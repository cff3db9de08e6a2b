"""Installing an exported bundle under a name."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinegraph.bundle import reader
from kinegraph.bundle.reader import read_bundle
from kinegraph.errors import BundleIntegrityError, InvalidInputError
from kinegraph_export.install import install_bundle
from support.synthetic_bundle import bundle_files, write_bundle


def test_bundles_share_what_reads_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bundles = tmp_path / "bundles"
    monkeypatch.setattr(reader, "BUNDLES", bundles)
    for name in ("studio", "open", "studio"):  # the second time it is replaced
        exported = tmp_path / f"exported {len(list(tmp_path.iterdir()))}"
        install_bundle(write_bundle(exported, name=name), name, bundles)
    assert sorted(path.name for path in bundles.iterdir()) == ["open", "shared", "studio"]
    assert sorted(path.name for path in (bundles / "shared").iterdir()) == [
        "parser.bin", "text_encoder.onnx", "tokenizer.json",
    ]  # fmt: skip
    for name in ("studio", "open"):
        bundle = read_bundle(name)
        assert bundle.manifest.name == name and set(bundle.files) <= set(bundle_files())
        assert not (bundles / name / "parser.bin").exists()


def test_another_parser_is_not_put_in_the_place_of_a_shared_one(tmp_path: Path) -> None:
    bundles = tmp_path / "bundles"
    install_bundle(write_bundle(tmp_path / "first"), "first", bundles)
    other = write_bundle(tmp_path / "second", {**bundle_files(), "parser.bin": b"another"})
    with pytest.raises(InvalidInputError, match=r"parser\.bin differs"):
        install_bundle(other, "second", bundles)
    assert sorted(path.name for path in bundles.iterdir()) == ["first", "shared"]


def test_a_bundle_keeps_its_own_weights_for_arguments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bundles = tmp_path / "bundles"
    monkeypatch.setattr(reader, "BUNDLES", bundles)
    for name in ("first", "second", "third"):
        weights = b"others" if name == "second" else b"weights"
        install_bundle(write_bundle(tmp_path / name, {**bundle_files(), "arguments.npz": weights}), name, bundles)
    assert [path.parent.name for path in sorted(bundles.glob("*/arguments.npz"))] == ["second", "shared"]
    assert read_bundle("second").files["arguments.npz"] == b"others"
    assert read_bundle("third").files["arguments.npz"] == read_bundle("first").files["arguments.npz"] == b"weights"


@pytest.mark.parametrize("name", ["shared", "", "../x", "Studio", "a b", ".hidden"])
def test_some_names_are_none(tmp_path: Path, name: str) -> None:
    with pytest.raises(InvalidInputError, match="a bundle's name"):
        install_bundle(write_bundle(tmp_path / "bundle"), name, tmp_path / "bundles")


def test_a_broken_bundle_is_not_installed(tmp_path: Path) -> None:
    folder = write_bundle(tmp_path / "bundle")
    (folder / "decoder.onnx").write_bytes(b"x")
    with pytest.raises(BundleIntegrityError):
        install_bundle(folder, "studio", tmp_path / "bundles")
    assert not (tmp_path / "bundles").exists()
