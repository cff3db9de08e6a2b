"""Promise 2, containment: a bundle names regular files in its folder, and nothing else is opened."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from kinegraph import BundleError, BundleFormatError, BundleIntegrityError
from kinegraph.bundle.contract import graph_files, optional_graph_files
from kinegraph.bundle.manifest import FileSpec
from kinegraph.bundle.reader import read_bundle
from support.opened_paths import opened_paths
from support.synthetic_bundle import (
    bundle_files,
    field,
    filler_model,
    manifest_for,
    manifest_object,
    sealed,
    write_bundle,
)

posix = pytest.mark.skipif(os.name != "posix", reason="needs POSIX file types")
LONGEST = 0.05
"""Seconds of CPU that a refusal may take; other work on the machine does not count."""
NAMES = ("../decoder.onnx", "/etc/hostname", "C:\\decoder.onnx", "C:decoder.onnx", "a/b.onnx", "dec\0der.onnx", "..",
         "", "CON", "NUL", "Decoder.onnx", "decoder.onnx/", "./decoder.onnx", "decoder.onnx\n", "decoder.onnx:stream",
         "weights.bin", "manifest.json")  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_a_manifest_cannot_name_anything_else(bundle: Path, name: str) -> None:
    value = manifest_object()
    value["files"][name] = dict(value["files"]["decoder.onnx"])
    (bundle / "manifest.json").write_bytes(sealed(value))
    best = 1.0
    for _ in range(3):
        start = time.thread_time()
        with opened_paths() as opened, pytest.raises(BundleError):
            read_bundle(bundle)
        best = min(best, time.thread_time() - start)
        assert opened == [str(bundle / "manifest.json")]
    assert best < LONGEST


def external_graph(name: str, location: str) -> bytes:
    """Build a graph with an initializer that refers to another file."""
    entry = field(13, field(1, "location") + field(2, location))
    tensor = field(1, 4) + field(2, 1) + field(8, "weights") + entry + field(14, 1)
    whole = filler_model(manifest_for(bundle_files()).contracts[name.removesuffix(".onnx")])
    # A second `graph` field is merged into the first by every protobuf reader.
    return whole + field(7, field(5, tensor))


@pytest.mark.usefixtures("no_sessions")
@pytest.mark.parametrize("name", sorted({*graph_files(), *optional_graph_files()}))
@pytest.mark.parametrize(
    "location", ["weights.bin", "../weights.bin", "/etc/hostname", "parser.bin", "*/_ORT_MEM_ADDR_/*"]
)
def test_tensors_outside_the_file_are_refused(tmp_path: Path, name: str, location: str) -> None:
    folder = write_bundle(tmp_path / "external", {**bundle_files(), name: external_graph(name, location)})
    read_bundle(write_bundle(tmp_path / "good", bundle_files())).read_later("decoder_motion.onnx")  # loads modules
    with opened_paths() as opened, pytest.raises(BundleFormatError, match=f"{name} keeps tensors in another file"):
        bundle = read_bundle(folder)
        assert name in optional_graph_files()  # the others are refused when the bundle is read
        bundle.read_later(name)
    assert all(Path(path).parent == folder for path in opened)


@posix
@pytest.mark.parametrize("name", ["decoder.onnx", "manifest.json"])
def test_a_link_that_comes_after_the_look_is_refused(
    bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """A file may be replaced by a link between `is_symlink` and `open`."""
    (tmp_path / "target").write_bytes((bundle / name).read_bytes())
    (bundle / name).unlink()
    (bundle / name).symlink_to(tmp_path / "target")
    monkeypatch.setattr(Path, "is_symlink", lambda _: False)
    with pytest.raises(BundleIntegrityError, match=f"{name} cannot be opened"):
        read_bundle(bundle)


def test_sizes_are_compared_before_anything_is_read(tmp_path: Path) -> None:
    entries = {**manifest_for(bundle_files()).files, "decoder.onnx": FileSpec("0" * 64, 5)}
    folder = write_bundle(tmp_path / "short", files=entries)
    with pytest.raises(BundleIntegrityError, match=r"decoder\.onnx is too large"):
        read_bundle(folder)


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
    with pytest.raises(BundleIntegrityError, match=f"{name} (is not a regular file|cannot be opened)"):
        read_bundle(bundle)
