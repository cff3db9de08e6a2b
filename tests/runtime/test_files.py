"""Targets that are refused without writing anything, and files that appear complete or not at all."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

import kinegraph
from kinegraph.clip import Clip
from kinegraph.errors import KinegraphError, OutputError
from kinegraph.formats import check_clip_target
from kinegraph.formats.npz import read_npz
from support.motions import walk


def clip() -> Clip:
    return Clip(joints=walk(5), fps=20.0, seed=7, text="a person walks", bundle="edge 1")


def test_a_saved_file_has_the_rights_of_any_new_file(tmp_path: Path) -> None:
    clip().save(tmp_path / "walk.npz")
    (tmp_path / "other").write_bytes(b"")
    assert (tmp_path / "walk.npz").stat().st_mode == (tmp_path / "other").stat().st_mode


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("walk", "no suffix.*.bvh, .gif, .glb"),
        ("walk.mp3", "'.mp3'.*.bvh, .gif, .glb"),
        (".npz", "no suffix"),
        ("missing/walk.npz", "does not exist"),
        ("file.txt/walk.npz", "file.txt.*is not a folder"),
        ("file.txt/deeper/walk.npz", "does not exist"),
        ("folder.npz", "is a directory"),
        (".", "is a directory"),
        ("there.npz", "exists.*force"),
        ("pipe.npz", "device or pipe"),
        ("n" * 300 + ".npz", "choose another name"),
        ("nul\0.npz", "choose another name"),
    ],
)
def test_bad_targets(tmp_path: Path, name: str, message: str) -> None:
    (tmp_path / "folder.npz").mkdir()
    (tmp_path / "there.npz").write_bytes(b"precious")
    (tmp_path / "file.txt").write_bytes(b"a file")
    os.mkfifo(tmp_path / "pipe.npz")
    before = sorted(tmp_path.rglob("*"))
    target = f"{tmp_path}/{name}"
    with pytest.raises(OutputError, match=message):
        check_clip_target(target)
    with pytest.raises(OutputError, match=message):
        clip().save(target)
    assert sorted(tmp_path.rglob("*")) == before
    assert (tmp_path / "there.npz").read_bytes() == b"precious"


@pytest.mark.parametrize("name", ["walk", "missing/walk.npz", "folder.npz", "pipe.npz"])
def test_force_does_not_help_a_target_that_is_no_file(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder.npz").mkdir()
    os.mkfifo(tmp_path / "pipe.npz")
    with pytest.raises(OutputError):
        check_clip_target(tmp_path / name, force=True)


def test_force_replaces(tmp_path: Path) -> None:
    target = tmp_path / "there.npz"
    target.write_bytes(b"old")
    check_clip_target(target, True)
    assert target.read_bytes() == b"old"
    clip().save(target, force=True)
    assert read_npz(target).seed == 7


def test_a_link_is_followed(tmp_path: Path) -> None:
    (tmp_path / "real.npz").write_bytes(b"old")
    (tmp_path / "link.npz").symlink_to(tmp_path / "real.npz")
    clip().save(tmp_path / "link.npz", force=True)
    assert (tmp_path / "link.npz").is_symlink()
    assert read_npz(tmp_path / "real.npz").seed == 7


def test_check_target_writes_nothing(tmp_path: Path) -> None:
    check_clip_target(tmp_path / "walk.bvh")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("blocked", ["folder", "file"])
def test_targets_without_the_right_to_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, blocked: str) -> None:
    # tests may run as root, whom permissions do not bind
    target = tmp_path / "there.npz"
    target.write_bytes(b"old")
    forbidden = {"folder": tmp_path, "file": target}[blocked]
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != forbidden)
    with pytest.raises(OutputError, match=r"cannot be written|write-protected"):
        check_clip_target(target, force=True)


@pytest.mark.parametrize("call", ["fsync", "open"])
def test_a_full_disk_leaves_the_old_file_and_no_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    target = tmp_path / "there.npz"
    target.write_bytes(b"old")

    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, call, full)
    with pytest.raises(OutputError, match="No space left") as caught:
        clip().save(target, force=True)
    monkeypatch.undo()
    assert isinstance(caught.value, KinegraphError)
    assert [path.name for path in tmp_path.iterdir()] == ["there.npz"]
    assert target.read_bytes() == b"old"


@pytest.mark.skipif(os.name != "posix", reason="limits of POSIX")
def test_a_file_that_the_system_cuts_short_is_an_error_and_leaves_the_old_one(tmp_path: Path) -> None:
    # no mock: the kernel takes the first 1,000 bytes and refuses the rest, like a disk that fills up
    (tmp_path / "there.npz").write_bytes(b"old")
    code = (
        "import resource, sys; from kinegraph.errors import OutputError; from kinegraph.clip import Clip\n"
        "import numpy as np\n"
        "clip = Clip(joints=np.zeros((9, 22, 3)), fps=20, seed=1, text='x', bundle='y')\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "for name in ('there.npz', 'new.glb', 'new.bvh'):\n"
        "    try: clip.save(name, force=True)\n"
        "    except OutputError as error: print(error)\n"
    )
    path = str(Path(kinegraph.__file__).resolve().parents[1])
    process = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
    )
    assert process.stdout.count("cannot be written (File too large)") == 3, process.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["there.npz"]
    assert (tmp_path / "there.npz").read_bytes() == b"old"


def test_an_interrupt_leaves_no_rest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(_: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises(KeyboardInterrupt):
        clip().save(tmp_path / "walk.npz")
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_comes_while_the_clip_is_written_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "walk.json"

    def slow(_: Clip) -> bytes:
        target.write_text("of somebody else")
        return b"ours"

    monkeypatch.setattr("kinegraph.formats.json.encode", slow)
    with pytest.raises(OutputError, match="exists"):
        clip().save(target)
    assert target.read_text() == "of somebody else" and [path.name for path in tmp_path.iterdir()] == ["walk.json"]
    clip().save(target, force=True)
    assert target.read_text() == "ours"


@pytest.mark.parametrize("there", [False, True])
def test_where_files_cannot_be_linked_they_are_renamed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there: bool
) -> None:
    def refused(*_: object) -> None:
        if there:
            (tmp_path / "walk.json").write_text("of somebody else")
        raise OSError(errno.EPERM, "no links here")

    monkeypatch.setattr(os, "link", refused)
    if there:
        with pytest.raises(OutputError, match="exists"):
            clip().save(tmp_path / "walk.json")
    else:
        clip().save(tmp_path / "walk.json")
    assert [path.name for path in tmp_path.iterdir()] == ["walk.json"]


def test_a_place_where_nothing_can_be_taken_away_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def read_only(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(os, "open", read_only)
    monkeypatch.setattr(Path, "unlink", read_only)
    with pytest.raises(OutputError, match="Read-only"):
        clip().save(tmp_path / "walk.json")
