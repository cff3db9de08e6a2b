"""Any damage to the files of a bundle is a typed error that names the file, before anything is parsed."""

from __future__ import annotations

import io
import os
import random
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.bundle.manifest import FileSpec, optional_graph_files
from kinegraph.bundle.reader import MAX_FILE_BYTES, read_bundle
from kinegraph.bundle.verify import verify_bundle
from kinegraph.errors import BundleError, BundleFormatError, BundleIntegrityError
from support.synthetic_bundle import bundle_files, manifest_for, tables_npz, write_bundle

FILES = sorted(bundle_files())
OPTIONAL_GRAPH_FILES = optional_graph_files()
posix = pytest.mark.skipif(os.name != "posix", reason="needs POSIX file types")


_opened: list[str] | None = None


def _watch(event: str, arguments: tuple[Any, ...]) -> None:
    # An open file that is wrapped a second time shows up as its number.
    if event == "open" and _opened is not None and not isinstance(arguments[0], int):
        _opened.append(os.fsdecode(arguments[0]))


sys.addaudithook(_watch)


@contextmanager
def opened_paths() -> Iterator[list[str]]:
    """Record every path that is opened inside the block."""
    global _opened
    _opened = paths = []
    try:
        yield paths
    finally:
        _opened = None


def test_a_good_bundle_is_read_whole(bundle: Path) -> None:
    read = read_bundle(bundle)
    everything = {**read.files, **{name: read.read_optional(name) for name in OPTIONAL_GRAPH_FILES}}
    assert everything == bundle_files() and not OPTIONAL_GRAPH_FILES & set(read.files)
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


def test_each_file_is_opened_once_and_nothing_else_is(bundle: Path) -> None:
    read_bundle(bundle)
    with opened_paths() as opened:
        read_bundle(bundle)
    # optional graphs are left alone until they are used
    needed = [name for name in [*FILES, "manifest.json"] if name not in OPTIONAL_GRAPH_FILES]
    assert sorted(opened) == sorted(str(bundle / name) for name in needed)


@pytest.mark.parametrize("name", sorted(OPTIONAL_GRAPH_FILES))
def test_an_optional_graph_is_hashed_when_it_is_read(bundle: Path, name: str) -> None:
    read = read_bundle(bundle)
    good = (bundle / name).read_bytes()
    (bundle / name).write_bytes(bytes([good[0] ^ 1]) + good[1:])
    with pytest.raises(BundleIntegrityError, match=f"{name} differs"):
        read.read_optional(name)
    (bundle / name).unlink()
    with pytest.raises(BundleIntegrityError, match=f"{name} is missing"):
        read.read_optional(name)


@pytest.mark.usefixtures("no_sessions")
@pytest.mark.parametrize("name", FILES)
def test_a_flipped_bit_is_noticed(bundle: Path, name: str) -> None:
    good = (bundle / name).read_bytes()
    generator = random.Random(name)
    for _ in range(200):
        flipped = bytearray(good)
        flipped[generator.randrange(len(good))] ^= 1 << generator.randrange(8)
        (bundle / name).write_bytes(flipped)
        with pytest.raises(BundleIntegrityError, match=name):
            verify_bundle(bundle)


@pytest.mark.usefixtures("no_sessions")
@pytest.mark.parametrize("name", [*FILES, "manifest.json"])
def test_cut_grown_emptied_or_missing_files_are_noticed(bundle: Path, name: str) -> None:
    good = (bundle / name).read_bytes()
    for broken in (good[:-1], good[: len(good) // 2], good + b"\0", b""):
        (bundle / name).write_bytes(broken)
        with pytest.raises(BundleIntegrityError, match=name):
            verify_bundle(bundle)
    (bundle / name).unlink()
    with pytest.raises(BundleIntegrityError, match=rf"{name} is missing"):
        verify_bundle(bundle)


@pytest.mark.usefixtures("no_sessions")
def test_two_swapped_files_are_noticed(bundle: Path) -> None:
    shutil.move(bundle / "denoiser_action.onnx", bundle / "aside")
    shutil.move(bundle / "denoiser_motion.onnx", bundle / "denoiser_action.onnx")
    shutil.move(bundle / "aside", bundle / "denoiser_motion.onnx")
    with pytest.raises(BundleIntegrityError, match=r"denoiser_(motion|action)\.onnx"):
        verify_bundle(bundle)


@pytest.mark.parametrize("name", ["notes.txt", ".DS_Store", "weights.bin", "DECODER.ONNX", "denoiser_action_new.onnx"])
def test_an_extra_file_is_noticed(bundle: Path, name: str) -> None:
    (bundle / name).write_bytes(b"x")
    with pytest.raises(BundleIntegrityError, match=name):
        read_bundle(bundle)


def test_an_extra_folder_is_noticed(bundle: Path) -> None:
    (bundle / "more").mkdir()
    with pytest.raises(BundleIntegrityError, match="more"):
        read_bundle(bundle)


def test_a_file_in_other_letters_is_another_file(bundle: Path) -> None:
    (bundle / "decoder.onnx").rename(bundle / "Decoder.onnx")
    with pytest.raises(BundleIntegrityError, match=r"decoder\.onnx is missing"):
        read_bundle(bundle)


@posix
@pytest.mark.parametrize("name", ["decoder.onnx", "manifest.json"])
@pytest.mark.parametrize("where", ["outside", "inside", "nowhere", "itself"])
def test_a_link_is_refused_unread(bundle: Path, tmp_path: Path, name: str, where: str) -> None:
    target = {
        "outside": tmp_path / "target",
        "inside": bundle / "parser.bin",
        "nowhere": tmp_path / "no",
    }.get(where, bundle / name)
    if where == "outside":
        # Even the right content does not make a link welcome.
        target.write_bytes((bundle / name).read_bytes())
    (bundle / name).unlink()
    (bundle / name).symlink_to(target)
    with opened_paths() as opened, pytest.raises(BundleIntegrityError, match=name):
        read_bundle(bundle)
    assert str(tmp_path / "target") not in opened
    assert str(bundle / name) not in opened


@posix
def test_a_linked_folder_inside_is_refused(bundle: Path, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (bundle / "more").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(BundleIntegrityError, match="more"):
        read_bundle(bundle)


@posix
def test_the_way_to_the_bundle_may_be_a_link(bundle: Path, tmp_path: Path) -> None:
    (tmp_path / "current").symlink_to(bundle)
    assert read_bundle(tmp_path / "current").path == bundle.resolve()


@posix
def test_hard_links_are_how_uv_installs_files(bundle: Path, tmp_path: Path) -> None:
    os.link(bundle / "decoder.onnx", tmp_path / "cache")
    read_bundle(bundle)
    (tmp_path / "cache").write_bytes(b"changed through the other name")
    with pytest.raises(BundleIntegrityError, match=r"decoder\.onnx"):
        read_bundle(bundle)


@posix
@pytest.mark.timeout(20)
@pytest.mark.parametrize("name", ["decoder.onnx", "manifest.json"])
@pytest.mark.parametrize("kind", ["fifo", "folder", "socket"])
def test_only_regular_files_are_read(bundle: Path, name: str, kind: str) -> None:
    (bundle / name).unlink()
    if kind == "fifo":
        os.mkfifo(bundle / name)
    elif kind == "folder":
        (bundle / name).mkdir()
    else:
        os.mknod(bundle / name, 0o140600)
    with pytest.raises(BundleIntegrityError, match=name):
        read_bundle(bundle)


@posix
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
