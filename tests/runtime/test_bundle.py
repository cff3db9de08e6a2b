"""Bundles are read whole and once; folders that are no bundle are named. Damage: `tests/promises/test_integrity.py`."""

from __future__ import annotations

import io
import os
from pathlib import Path

import numpy as np
import pytest

from kinegraph.bundle.contract import optional_graph_files
from kinegraph.bundle.manifest import FileSpec
from kinegraph.bundle.reader import MAX_FILE_BYTES, read_bundle
from kinegraph.errors import BundleError, BundleFormatError, BundleIntegrityError
from support.opened_paths import opened_paths
from support.synthetic_bundle import bundle_files, manifest_for, tables_npz, write_bundle


def test_a_good_bundle_is_read_whole(bundle: Path) -> None:
    read = read_bundle(bundle)
    everything = {**read.files, **{name: read.read_later(name) for name in optional_graph_files()}}
    assert everything == bundle_files() and not optional_graph_files() & set(read.files)
    assert read.manifest == manifest_for(bundle_files())
    with np.load(io.BytesIO(tables_npz())) as expected:
        assert sorted(read.tables) == sorted(expected.files)
        for name in expected.files:
            np.testing.assert_array_equal(read.tables[name], expected[name])


def test_what_was_read_cannot_be_changed(bundle: Path) -> None:
    read = read_bundle(bundle)
    with pytest.raises(ValueError, match="read-only"):
        read.tables["bone_lengths"][0, 0] = 1.0
    with pytest.raises(TypeError):
        read.files["decoder.onnx"] = b""  # type: ignore[index]


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may read everything")
def test_an_unreadable_file_is_named(bundle: Path) -> None:
    (bundle / "decoder.onnx").chmod(0)
    with pytest.raises(BundleIntegrityError, match=r"decoder\.onnx cannot be opened"):
        read_bundle(bundle)


@pytest.mark.parametrize("path", ["missing", "a\0b", "x" * 5000])
def test_no_such_folder(tmp_path: Path, path: str) -> None:
    with pytest.raises(BundleError, match="no bundle at"):
        read_bundle(tmp_path / path)


def test_a_file_is_no_bundle(bundle: Path) -> None:
    with pytest.raises(BundleError, match="not a folder"):
        read_bundle(bundle / "manifest.json")


def test_an_empty_folder_is_no_bundle(tmp_path: Path) -> None:
    with pytest.raises(BundleIntegrityError, match=r"manifest\.json is missing"):
        read_bundle(tmp_path)


def test_a_huge_manifest_is_not_read(bundle: Path) -> None:
    with (bundle / "manifest.json").open("r+b") as file:
        file.truncate(1 << 40)
    with pytest.raises(BundleIntegrityError, match=r"manifest\.json is too large"):
        read_bundle(bundle)


@pytest.mark.parametrize("size", [MAX_FILE_BYTES + 1, MAX_FILE_BYTES])
def test_huge_files_are_not_read(tmp_path: Path, size: int) -> None:
    entries = dict(manifest_for(bundle_files()).files)
    for name in ("decoder.onnx", "parser.bin", "tokenizer.json", "text_encoder.onnx", "tables.npz"):
        entries[name] = FileSpec("0" * 64, size)
    folder = write_bundle(tmp_path / "huge", files=entries)
    with opened_paths() as opened, pytest.raises(BundleFormatError, match=r"bytes; a (file|bundle) may have"):
        read_bundle(folder)
    assert opened == [str(folder / "manifest.json")]
