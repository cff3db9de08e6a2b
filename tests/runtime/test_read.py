"""Clips read back from files that kinegraph wrote; every other file is refused, with a reason and in little memory."""

from __future__ import annotations

import io
import json
import struct
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph import cli, formats
from kinegraph.clip import Clip
from kinegraph.errors import InvalidInputError
from kinegraph.formats import READERS, WRITERS, encode, read
from kinegraph.motion.kinematics import forward_kinematics, rotations_from_positions
from kinegraph.motion.skeleton import CONVENTIONS
from support.cli_runs import whole
from support.motions import t_pose, walk, with_recorded

TEXT = "ein Mensch geht – 歩く"


def clip(joints: np.ndarray, fps: float = 20.0) -> Clip:
    return Clip(joints=joints, fps=fps, seed=2**62, text=TEXT, bundle="edge 1.2")


def shown(saved: Clip) -> np.ndarray:
    """Compute the joints that a file with a skeleton shows."""
    motion = rotations_from_positions(saved.joints, saved.fps)
    return forward_kinematics(motion.rest_offsets, motion.root, motion.rotations)


def distance(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.linalg.norm(first - second, axis=-1).max())


@pytest.mark.parametrize("suffix", [".bvh", ".glb"])
@pytest.mark.parametrize("root", [False, True])
@pytest.mark.parametrize("names", CONVENTIONS)
def test_a_skeleton_comes_back_as_the_file_shows_it(tmp_path: Path, suffix: str, root: bool, names: str) -> None:
    for joints in with_recorded([walk(50, turning=0.05), t_pose(1)], 2):
        saved = clip(joints)
        path = tmp_path / f"Walk 1{suffix}"
        saved.save(path, names=names, root=root, force=True)
        back = read(path)
        assert distance(back.joints, shown(saved)) < 1e-5
        assert distance(back.joints, saved.joints) < 2e-3
        assert back.fps == 20.0 and back.graph is None
        if suffix == ".glb":
            assert (back.text, back.seed, back.bundle) == (TEXT, 2**62, "edge 1.2")
        else:
            assert (back.text, back.seed, back.bundle) == ("Walk 1", 0, "unknown")


@pytest.mark.parametrize(("suffix", "error"), [(".npz", 0.0), (".json", 1e-5)])
def test_joints_come_back(tmp_path: Path, suffix: str, error: float) -> None:
    saved = clip(walk(50, turning=0.05), fps=29.97)
    saved.save(tmp_path / f"walk{suffix}")
    back = read(str(tmp_path / f"walk{suffix}"))
    assert distance(back.joints, saved.joints) <= error
    assert (back.fps, back.text, back.seed, back.bundle) == (29.97, TEXT, 2**62, "edge 1.2")


def test_npz_alone_keeps_the_graph(tmp_path: Path) -> None:
    graph = whole("a person walks")
    for suffix in READERS:
        Clip(walk(9), 20.0, 1, "a person walks", "b", graph).save(tmp_path / f"a{suffix}")
        assert read(tmp_path / f"a{suffix}").graph == (graph if suffix == ".npz" else None)


@pytest.mark.parametrize(
    "fps", [1.0, 7.5, 12.0, 20.0, 24.0, 25.0, 29.97, 30.0, 59.94, 60.0, 119.88, 120.0, 144.0, 240.0]
)
def test_frame_rates_come_back(tmp_path: Path, fps: float) -> None:
    for suffix in READERS:
        clip(walk(9), fps).save(tmp_path / f"a{suffix}")
        assert read(tmp_path / f"a{suffix}").fps == fps


def test_every_command_that_makes_clips_writes_the_root_joint(here: Path) -> None:
    pytest.importorskip("spacy", reason="plain sentences need the text extra")
    walks, options = "a person walks forward", ["--seconds", "2", "--seed", "7", "--steps", "2", "--quiet"]
    for number, command in enumerate((["generate", walks], ["compose", "--and", walks], ["sequence", walks, walks])):
        for suffix in (".glb", ".bvh"):
            assert cli.main([*command, *options, "-o", f"plain{number}{suffix}"]) == 0
            assert cli.main([*command, *options, "-o", f"root{number}{suffix}", "--root"]) == 0
            plain, with_root = (here / f"{kind}{number}{suffix}" for kind in ("plain", "root"))
            assert (b"root" in plain.read_bytes(), b"root" in with_root.read_bytes()) == (False, True)
            assert distance(read(plain).joints, read(with_root).joints) < 1e-5


def test_a_file_read_and_saved_again_stays_where_it_is(tmp_path: Path) -> None:
    first = clip(walk(60, turning=0.1))
    for suffix in (".bvh", ".glb"):
        path = tmp_path / f"a{suffix}"
        first.save(path)
        for _ in range(3):
            back = read(path)
            back.save(path, root=True, force=True)
        assert distance(read(path).joints, first.joints) < 1e-4


def test_a_long_clip_that_leaves_the_origin_comes_back(tmp_path: Path) -> None:
    saved = clip(walk(2000, speed=0.3))
    for suffix in READERS:
        saved.save(tmp_path / f"a{suffix}", **({"root": True} if suffix in formats.NAMED else {}))  # type: ignore[arg-type]
        assert distance(read(tmp_path / f"a{suffix}").joints, saved.joints) < 2e-3


def test_files_of_other_line_ends_and_older_versions_come_back(tmp_path: Path) -> None:
    saved = clip(walk(30))
    data = encode(saved, ".bvh")
    (tmp_path / "windows.bvh").write_bytes(data.replace(b"\n", b"\r\n"))
    pelvis = next(line for line in data.splitlines() if b"OFFSET" in line)
    (tmp_path / "old.bvh").write_bytes(data.replace(pelvis, b"\tOFFSET 0.000000 0.000000 0.000000", 1))
    for name in ("windows", "old"):
        assert distance(read(tmp_path / f"{name}.bvh").joints, saved.joints) < 1e-3


def test_other_formats_and_missing_files_are_named(tmp_path: Path) -> None:
    clip(walk(9)).save(tmp_path / "a.html")
    for name, message in [
        ("a.html", r"the suffix '.html'; clips are read from .bvh, .glb, .json, .npz"),
        ("a.fbx", "the suffix '.fbx'"),
        ("a", "has no suffix"),
        ("a.glb", "there is no file '.*a.glb'"),
    ]:
        with pytest.raises(InvalidInputError, match=message):
            read(tmp_path / name)
    (tmp_path / "folder.npz").mkdir()
    for path in (tmp_path / "folder.npz", tmp_path / ("x" * 300 + ".npz"), "a\0b.npz"):
        with pytest.raises(InvalidInputError):
            read(path)
    assert READERS.keys() < WRITERS.keys()


def test_names_of_files_that_are_no_text_become_some(tmp_path: Path) -> None:
    path = tmp_path / "a\udcff.bvh"
    try:
        path.write_bytes(encode(clip(walk(9)), ".bvh"))
    except (OSError, UnicodeError):
        pytest.skip("this file system has no such names")
    assert read(path).text == "a?"


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(formats, "MAX_BYTES", 1 << 20)
    for suffix in READERS:
        (tmp_path / f"a{suffix}").write_bytes(b" " * ((1 << 20) + 1))
        with pytest.raises(InvalidInputError, match="larger than 1 MiB"):
            read(tmp_path / f"a{suffix}")


def refused(data: bytes, suffix: str, folder: Path) -> str:
    """Refuse a file within 64 MB, and return the reason."""
    path = folder / f"bad{suffix}"
    path.write_bytes(data)
    tracemalloc.start()
    try:
        with pytest.raises(InvalidInputError) as caught:
            read(path)
        assert tracemalloc.get_traced_memory()[1] < len(data) * 12 + (64 << 20)
    finally:
        tracemalloc.stop()
    message = str(caught.value)
    assert repr(str(path)) in message and len(message) < 1000
    return message


@pytest.mark.parametrize("suffix", READERS)
def test_garbage_is_refused(tmp_path: Path, suffix: str) -> None:
    good = encode(clip(walk(20)), suffix)
    others = [encode(clip(walk(5)), other) for other in READERS if other != suffix]
    longer = [good + b"0 0"] if suffix != ".npz" else []  # archives may have anything behind them
    for data in (b"", b"\0", b"HIERARCHY\n", b"glTF", b"{}", b"[]", b"\xff\xfe" * 50, *longer, *others):
        refused(data, suffix, tmp_path)
    for size in np.linspace(0, len(good) - 4, 60).astype(int):
        refused(good[:size], suffix, tmp_path)


@pytest.mark.parametrize("suffix", READERS)
def test_damaged_files_are_refused_or_read_as_finite_clips(tmp_path: Path, suffix: str) -> None:
    good, rng = bytearray(encode(clip(walk(12)), suffix)), np.random.default_rng(3)
    for _ in range(400):
        data = bytearray(good)
        # mostly where the structure is: at the beginning and at the end
        where = rng.integers(0, len(good)) if rng.random() < 0.4 else rng.integers(0, 3000) % len(good)
        data[where if rng.random() < 0.8 else -1 - where] = int(rng.integers(0, 256))
        (tmp_path / f"a{suffix}").write_bytes(bytes(data))
        try:
            back = read(tmp_path / f"a{suffix}")
        except InvalidInputError:
            continue
        assert np.isfinite(back.joints).all()


def glb(change: Callable[[dict[str, Any]], object], root: bool = False) -> bytes:
    """Write a GLB whose JSON has been changed."""
    data = encode(clip(walk(20)), ".glb", root=root)
    (size,) = struct.unpack_from("<I", data, 12)
    document = json.loads(data[20 : 20 + size])
    change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + size :]
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON") + text + rest


def changed(*path: Any) -> Callable[[dict[str, Any]], None]:
    """Set a value in a document: keys and indices, then the value."""

    def change(document: dict[str, Any]) -> None:
        place: Any = document
        for key in path[:-2]:
            place = place[key]
        place[path[-2]] = path[-1]

    return change


def pelvis_times(document: dict[str, Any]) -> dict[str, Any]:
    """Find the accessor of the times."""
    accessor: dict[str, Any] = document["accessors"][document["animations"][0]["samplers"][0]["input"]]
    return accessor


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (changed("asset", "generator", "Blender"), "written by 'Blender'"),
        (
            changed("nodes", 3, "name", "Spine"),
            "not the joints of kinegraph, which start with pelvis or mixamorig:Hips",
        ),
        (changed("nodes", 0, "children", [1, 2]), "not the joints"),
        (changed("nodes", 4, "translation", [0, 1]), "parts are not"),
        (changed("nodes", 4, "translation", [0, float("nan"), 1]), "three finite"),
        (changed("nodes", 4, "translation", [[], {}, 1]), "parts are not"),
        (changed("nodes", {}), "parts are not"),
        (changed("animations", []), "parts are not"),
        (changed("animations", 0, "samplers", 3, "interpolation", "STEP"), "'STEP', not LINEAR"),
        (changed("animations", 0, "samplers", 3, "input", 1), "parts are not"),
        (changed("animations", 0, "channels", 3, "target", "node", 5), "tracks are not"),
        (changed("animations", 0, "channels", 3, "target", "path", "scale"), "tracks are not"),
        (changed("asset", "extras", "fps", 30), "not at every frame"),
        (changed("asset", "extras", "fps", 0), "fps must be"),
        (changed("asset", "extras", "fps", "20"), "fps must be"),
        (changed("asset", "extras", "seed", 7), "seed"),
        (changed("asset", "extras", "seed", "9" * 19), "seed"),
        (changed("asset", "extras", "seed", "²"), "seed"),
        (changed("asset", "extras", "text", ["a"]), "text"),
        (changed("asset", "extras", {}), "parts are not"),
        (changed("bufferViews", -1, "byteOffset", -4), "not in the file"),
        (changed("bufferViews", -1, "byteOffset", 1 << 60), "not in the file"),
        (changed("bufferViews", -1, "byteStride", 1), "plain floats"),
        (changed("accessors", -1, "componentType", 5123), "plain floats"),
        (changed("accessors", -1, "type", "VEC3"), "parts are not"),
        (changed("accessors", -1, "type", "MAT4"), "parts are not"),
        (changed("accessors", -1, "count", 19), "19 keys, not 20"),
        (changed("accessors", -1, "count", 10**30), "not in the file"),
        (changed("accessors", -1, "count", 1.5), "parts are not"),
        (lambda document: pelvis_times(document).update(count=0), "not in the file"),
        (lambda document: document["nodes"].insert(0, document["nodes"].pop()), "not the joints"),
        (lambda document: document.clear(), "parts are not"),
    ],
)
def test_glb_of_another_layout_is_refused(
    tmp_path: Path, change: Callable[[dict[str, Any]], None], message: str
) -> None:
    assert message in refused(glb(change), ".glb", tmp_path)
    assert message in refused(glb(change, root=True), ".glb", tmp_path)


def test_json_that_nests_or_lies_is_refused(tmp_path: Path) -> None:
    def chunk(text: bytes) -> bytes:
        return struct.pack("<4sIII4s", b"glTF", 2, 28 + len(text), len(text), b"JSON") + text + b"\0\0\0\0BIN\0"

    assert "damaged" in refused(chunk(b"[" * 400_000), ".glb", tmp_path)
    assert "no object" in refused(chunk(b"[]  "), ".glb", tmp_path)
    assert "at most a megabyte" in refused(chunk(b" " * (1 << 21)), ".glb", tmp_path)
    assert "more lists than numbers" in refused(b"[" * 2_000_000, ".json", tmp_path)
    assert "more lists than numbers" in refused(b'{"joints":[' + b"[]," * 3_000_000 + b"[]]}", ".json", tmp_path)
    refused(b"[" * 90_000, ".json", tmp_path)
    good = json.loads(encode(clip(walk(20)), ".json"))
    for change in (
        {"joints": None},
        {"joints": [[0.0] * 22]},
        {"joints": [[[1, 2], [3]]]},
        {"joints": ["x" * 100_000, *[""] * 20_000]},
        {"joints": [[[10**400] * 3] * 22]},
        {"joint_names": good["joint_names"][::-1]},
        {"joint_names": 3},
        {"seed": "-1"},
        {"seed": 7},
        {"fps": True},
        {"fps": float("nan")},
        {"text": 3},
        {"bundle": None},
    ):
        refused(json.dumps({**good, **change}).encode(), ".json", tmp_path)
    for key in ("joints", "joint_names", "fps", "seed", "text", "bundle"):
        assert key in refused(
            json.dumps({name: good[name] for name in good if name != key}).encode(), ".json", tmp_path
        )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"ROOT pelvis", b"ROOT Hips", "which start with ROOT pelvis, ROOT mixamorig:Hips or ROOT root"),
        (b"JOINT spine2", b"JOINT chest", "joints or channels"),
        (
            b"CHANNELS 3 Zrotation Xrotation Yrotation",
            b"CHANNELS 3 Xrotation Yrotation Zrotation",
            "joints or channels",
        ),
        (b"OFFSET 0.", b"OFFSET nan ", "OFFSET"),
        (b"\tOFFSET ", b"\tOFFSET 1 ", "three numbers"),
        (b"Frames: 20", b"Frames: 21", "frame 21 of 21 has 0 numbers, not 69"),
        (b"Frames: 20", b"Frames: 19", "more than the 19 frames"),
        (b"Frames: 20", b"Frames: 0", "its 0 frames"),
        (b"Frames: 20", b"Frames: -1", "its -1 frames"),
        (b"Frames: 20", b"Frames: 150000", "or not all there"),
        (b"Frames: 20", b"Frames: " + b"9" * 4000, "frames"),
        (b"Frames: 20", b"Frames: 2.5", "does not start with"),
        (b"Time: 0.05000000", b"Time: 0", "does not start with"),
        (b"Time: 0.05000000", b"Time: 20", "fps must be"),
        (b"Time: 0.05000000", b"Time: nan", "fps must be"),
        (b"Time: 0.05000000", b"Time: inf", "fps must be"),
        (b"0.000000 95.0", b"nan 95.0", "not finite"),
        (b"0.000000 95.0", b"x 95.0", "frame 1"),
        (b"0.000000 95.0", b"95.0", "frame 1 of 20 has 68 numbers, not 69"),
        (b"MOTION\n", "MOTIÖN\n".encode(), "ASCII"),
        (b"MOTION\n", b"", "joints or channels"),
        (b"MOTION\n", b"MOTION\nMOTION\n", "does not start with"),
        (b"\n", b"\n" + b"x" * 5000 + b"\n", "longer than 4096"),
        (b"\n\t}", b"\n}\n" * 100_000, "joints or channels"),
    ],
)
def test_bvh_of_another_kind_is_refused(tmp_path: Path, old: bytes, new: bytes, message: str) -> None:
    good = encode(clip(walk(20)), ".bvh")
    assert good.count(old)
    where = good.index(b"MOTION") if message.startswith(("frame 1", "not finite")) else 0
    assert message in refused(good[:where] + good[where:].replace(old, new, 1), ".bvh", tmp_path)


def npz(arrays: dict[str, bytes | np.ndarray], method: int = zipfile.ZIP_STORED) -> bytes:
    """Write an archive of arrays, or of the bytes of an entry."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, array in arrays.items():
            entry = io.BytesIO()
            if isinstance(array, bytes):
                entry.write(array)
            else:
                np.lib.format.write_array(entry, np.asarray(array), version=(1, 0))
            archive.writestr(f"{name}.npy", entry.getvalue())
    return buffer.getvalue()


def test_npz_that_unpacks_into_much_or_announces_much_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(io.BytesIO(encode(clip(walk(20)), ".npz"))) as archive:
        good: dict[str, Any] = {name.removesuffix(".npy"): archive.read(name) for name in archive.namelist()}
    (tmp_path / "good.npz").write_bytes(npz(good, zipfile.ZIP_DEFLATED))
    assert read(tmp_path / "good.npz").frames == 20
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"shape": (10**12, 22, 3), "fortran_order": False, "descr": "<f4"})
    text = io.BytesIO()
    np.lib.format.write_array_header_1_0(text, {"shape": (), "fortran_order": False, "descr": "<U200000000"})
    objects = io.BytesIO()
    np.lib.format.write_array(objects, np.array([{}], dtype=object), version=(1, 0), allow_pickle=True)
    for change, message in (
        ({"joints": np.zeros((20_000_000, 1, 2), dtype="<f4")}, "joints unpacks to 16"),
        ({"joints": header.getvalue()}, "joints does not hold"),
        ({"joints": header.getvalue().replace(b"1000000000000", b"-100000000000")}, "joints does not hold"),
        ({"text": text.getvalue()}, "text does not hold"),
        ({"text": objects.getvalue()}, "text does not hold"),
        ({"joints": b"\x93NUMPY\x02\0" + b" " * 99}, "version"),
        ({"joints": b""}, ""),
        ({"text": np.array(b"bytes")}, "text"),
        ({"text": np.frombuffer(b"\xff\xff\xff\x7f", dtype="<U1").reshape(())}, ""),
        ({"seed": np.array(1.5)}, "seed"),
    ):
        assert message in refused(npz({**good, **change}, zipfile.ZIP_DEFLATED), ".npz", tmp_path)
