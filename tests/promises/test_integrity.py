"""Promise 1, integrity: what differs from the manifest's SHA-256 is never parsed, and never given to onnxruntime."""

from __future__ import annotations

import random
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from kinegraph import BundleIntegrityError, MotionPipeline
from kinegraph.bundle.contract import graph_files, optional_graph_files
from kinegraph.bundle.reader import DEFAULT_BUNDLE, MANIFEST, read_bundle, read_manifest, text_files_folder
from kinegraph.bundle.sessions import open_sessions
from kinegraph.bundle.verify import verify_bundle
from support.opened_paths import opened_paths
from support.synthetic_bundle import bundle_files

FILES = sorted(bundle_files())
REAL_FILES = sorted((MANIFEST, *read_manifest(DEFAULT_BUNDLE).files))


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the default bundle in one folder; tests put back what they change."""
    folder = shutil.copytree(DEFAULT_BUNDLE, tmp_path_factory.mktemp("real") / "bundle")
    for name in REAL_FILES:  # those that installed bundles share lie beside it
        if not (folder / name).is_file():
            shutil.copy(text_files_folder() / name, folder / name)
    return folder


def read_whole(folder: Path) -> None:
    """Read all files of a bundle, those too that are read at their first use."""
    bundle = read_bundle(folder)
    for name in optional_graph_files(bundle.manifest.format_version) & set(bundle.manifest.files):
        bundle.read_later(name)


def test_the_real_bundle_is_whole(real: Path) -> None:
    read_whole(real)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.usefixtures("no_sessions")
@pytest.mark.parametrize("name", REAL_FILES)
def test_a_flipped_bit_of_the_real_bundle_is_noticed(real: Path, name: str, is_long: bool) -> None:
    generator = random.Random(name)
    size = (real / name).stat().st_size
    positions = [size - 1, *(generator.randrange(size) for _ in range(199))] if is_long else [generator.randrange(size)]
    for position in positions:
        with (real / name).open("r+b") as file:
            file.seek(position)
            good = file.read(1)
            file.seek(position)
            file.write(bytes([good[0] ^ 1 << generator.randrange(8)]))
        with pytest.raises(BundleIntegrityError, match=name):
            read_whole(real)
        with (real / name).open("r+b") as file:
            file.seek(position)
            file.write(good)


@pytest.mark.usefixtures("no_sessions")
def test_a_flipped_bit_stops_the_pipeline_before_a_session_is_made(real: Path) -> None:
    optional = optional_graph_files()
    largest = max(REAL_FILES, key=lambda name: 0 if name in optional else (real / name).stat().st_size)
    good = (real / largest).read_bytes()
    (real / largest).write_bytes(good[:-1] + bytes([good[-1] ^ 1]))
    with pytest.raises(BundleIntegrityError, match=largest):
        MotionPipeline.load(real)
    (real / largest).write_bytes(good)


@pytest.mark.parametrize("name", [MANIFEST, "text_encoder.onnx"])
def test_the_bytes_that_are_hashed_are_the_bytes_that_are_loaded(
    bundle: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """A file that changes as soon as it was read is not read again."""
    good, seen = (bundle / name).read_bytes(), []

    def change(data: bytes, file: str) -> None:
        seen.append(file)
        (bundle / name).write_bytes(b"changed behind the reader's back")

    monkeypatch.setattr("kinegraph.bundle.reader.check_self_contained", change)
    read = read_bundle(bundle)
    assert seen and (name == MANIFEST or read.files[name] == good)


def test_each_file_is_opened_once_and_nothing_else_is(bundle: Path) -> None:
    read_bundle(bundle)
    with opened_paths() as opened:
        read_bundle(bundle)
    # optional graphs are left alone until they are used
    needed = [name for name in [*FILES, "manifest.json"] if name not in optional_graph_files()]
    assert sorted(opened) == sorted(str(bundle / name) for name in needed)


@pytest.mark.parametrize("name", sorted(optional_graph_files()))
def test_an_optional_graph_is_hashed_when_it_is_read(bundle: Path, name: str) -> None:
    read = read_bundle(bundle)
    good = (bundle / name).read_bytes()
    (bundle / name).write_bytes(bytes([good[0] ^ 1]) + good[1:])
    with pytest.raises(BundleIntegrityError, match=f"{name} differs"):
        read.read_later(name)
    (bundle / name).unlink()
    with pytest.raises(BundleIntegrityError, match=f"{name} is missing"):
        read.read_later(name)


def open_as_a_pipeline_does(bundle: Path) -> None:
    """Open the sessions of a bundle, whose files are let go of meanwhile."""
    read = read_bundle(bundle)
    open_sessions(replace(read, files={}), threads=1, files=dict(read.files))


def test_a_large_graph_is_hashed_when_its_session_is_opened(bundle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Released denoisers are gigabytes together: each is read, hashed and opened by itself."""
    monkeypatch.setattr("kinegraph.bundle.reader.LARGE_FILE", 1)
    assert not [name for name in read_bundle(bundle).files if name.endswith(".onnx")]
    with opened_paths() as opened:
        open_as_a_pipeline_does(bundle)
    assert len(opened) == len(set(opened))
    assert {str(bundle / name) for name in graph_files()} <= set(opened)
    for name in ("denoiser_action.onnx", "text_encoder.onnx"):
        good = (bundle / name).read_bytes()
        (bundle / name).write_bytes(bytes([good[0] ^ 1]) + good[1:])
        for load in (open_as_a_pipeline_does, verify_bundle):
            with pytest.raises(BundleIntegrityError, match=f"{name} differs"):
                load(bundle)
        (bundle / name).write_bytes(good)


@pytest.mark.usefixtures("no_sessions")
@pytest.mark.parametrize("name", FILES)
def test_a_flipped_bit_is_noticed(bundle: Path, name: str, is_long: bool) -> None:
    good = (bundle / name).read_bytes()
    generator = random.Random(name)
    for _ in range(200 if is_long else 10):
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
