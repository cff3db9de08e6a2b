"""NPZ and JSON read back by NumPy and json alone; equal clips give equal bytes; files that are no clip are refused."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinegraph.clip import Clip
from kinegraph.constraints import Miss
from kinegraph.errors import InvalidInputError
from kinegraph.formats import encode, read
from kinegraph.formats.npz import read_npz
from kinegraph.motion.skeleton import JOINT_NAMES, PARENTS
from support.motions import walk


def clip(joints: np.ndarray, fps: float = 20.0, text: str = "a person walks") -> Clip:
    return Clip(joints=joints, fps=fps, seed=2**40, text=text, bundle="edge 1.2")


def test_npz_holds_what_it_should(tmp_path: Path) -> None:
    joints = walk(9)
    clip(joints, text="ein Mensch geht – 歩く").save(tmp_path / "walk.npz")
    with np.load(tmp_path / "walk.npz", allow_pickle=False) as pack:
        assert sorted(pack) == ["bundle", "fps", "joint_names", "joints", "seed", "text"]
        np.testing.assert_array_equal(pack["joints"], joints)
        assert pack["joints"].dtype == np.dtype("<f4")
        assert pack["fps"] == 20.0
        assert pack["seed"] == 2**40
        assert str(pack["text"]) == "ein Mensch geht – 歩く"
        assert str(pack["bundle"]) == "edge 1.2"
        assert tuple(pack["joint_names"]) == JOINT_NAMES


@pytest.mark.parametrize("suffix", [".npz", ".json", ".glb"])
def test_a_loop_is_one_when_it_is_read_again(suffix: str, tmp_path: Path) -> None:
    plain = clip(walk(60))
    loop = plain.looped()
    for name, made in (("plain", plain), ("loop", loop)):
        made.save(tmp_path / f"{name}{suffix}")
        assert read(tmp_path / f"{name}{suffix}").loops == made.loops
    assert read(tmp_path / f"loop{suffix}").resampled(30).frames == loop.resampled(30).frames
    one = Clip(walk(1), 20.0, 1, "a person stands", "toy 1", loops=True)
    assert one.resampled(30).frames <= 2 and encode(one, suffix)


def test_json_holds_the_clip_and_a_skeleton_that_turns_into_it() -> None:
    joints, text = walk(30, turning=0.05), "ein Mensch geht – 歩く"
    document = json.loads(encode(clip(joints, fps=29.97, text=text), ".json"))
    about = {name: document[name] for name in ("text", "seed", "bundle", "fps")}
    assert about == {"text": text, "seed": str(2**40), "bundle": "edge 1.2", "fps": 29.97}
    assert tuple(document["joint_names"]) == JOINT_NAMES and tuple(document["parents"]) == PARENTS
    np.testing.assert_allclose(document["joints"], joints, atol=1e-5)
    # forward kinematics by the textbook: the parent's position plus the offset, rotated by all joints above
    for frame in (0, 13, 29):
        positions: list[np.ndarray] = []
        axes: list[np.ndarray] = []
        for joint, parent in enumerate(document["parents"]):
            local = rotation_matrix(*document["rotations"][frame][joint])
            offset = np.array(document["rest_offsets"][joint])
            root = np.array(document["joints"][frame][0])
            positions.append(root if parent < 0 else positions[parent] + axes[parent] @ offset)
            axes.append(local if parent < 0 else axes[parent] @ local)
        assert np.linalg.norm(np.array(positions) - joints[frame], axis=-1).max() < 1e-3


def rotation_matrix(w: float, x: float, y: float, z: float) -> np.ndarray:
    """Convert a quaternion to a matrix by Rodrigues: I + 2 w [v] + 2 [v]^2."""
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def test_json_of_odd_text_is_still_json() -> None:
    text = 'a "quote", \\ and \u2028 \x00'
    assert json.loads(encode(clip(walk(2), text=text), ".json").decode())["text"] == text


@pytest.mark.parametrize("text", ["a person walks", "", "  two\nlines ", "👋"])
def test_npz_comes_back(tmp_path: Path, text: str) -> None:
    saved = clip(walk(3), fps=29.97, text=text)
    saved.save(tmp_path / "x.npz")
    back = read_npz(tmp_path / "x.npz")
    np.testing.assert_array_equal(back.joints, saved.joints)
    assert (back.fps, back.seed, back.text, back.bundle) == (29.97, 2**40, text, "edge 1.2")


@pytest.mark.parametrize("suffix", [".npz", ".json"])
def test_misses_come_back(tmp_path: Path, suffix: str) -> None:
    misses = (Miss("path of 4 m", 0.013, 0.151, 7.6), Miss("left_wrist at 1 s – 手", 0.0, 0.0))
    saved = replace(clip(walk(3)), misses=misses)
    saved.save(tmp_path / f"x{suffix}")
    assert read(tmp_path / f"x{suffix}").misses == misses
    clip(walk(3)).save(tmp_path / f"without{suffix}")
    assert read(tmp_path / f"without{suffix}").misses == ()


@pytest.mark.parametrize("suffix", [".npz", ".bvh", ".json"])
def test_equal_clips_give_equal_bytes_at_any_time(monkeypatch: pytest.MonkeyPatch, suffix: str) -> None:
    first = encode(clip(walk(20)), suffix)
    later = time.time() + 1e7
    moment = time.gmtime(later)
    monkeypatch.setattr(time, "time", lambda: later)
    monkeypatch.setattr(time, "localtime", lambda *_: moment)
    assert encode(clip(walk(20).astype(np.float64)), suffix) == first
    assert encode(clip(walk(21)), suffix) != first


def fields(**changes: object) -> dict[str, object]:
    good = {"joints": walk(3), "fps": 20.0, "seed": 1, "text": "x", "joint_names": JOINT_NAMES, "bundle": "b"}
    return {**good, **changes}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"misses": '[{"what": "path", "metres": 1}]'}, "a miss must be an object with the keys what, metres"),
        ({"misses": '[{"what": "path", "metres": null, "worst": 1, "degrees": null}]'}, "by how much"),
        ({"joint_names": JOINT_NAMES[::-1]}, "other joints"),
        ({"text": ["a", "b"]}, "single value"),
        ({"joints": np.zeros((3, 5, 3))}, "shape"),
        ({"fps": -1.0}, "fps"),
        ({"joints": np.array([object()])}, "no clip"),
    ],
)
def test_npz_of_another_kind_is_refused(tmp_path: Path, changes: dict[str, object], message: str) -> None:
    np.savez(tmp_path / "x.npz", **fields(**changes))  # type: ignore[arg-type]
    with pytest.raises(InvalidInputError, match=message):
        read_npz(tmp_path / "x.npz")


def test_files_that_are_no_clip_are_refused(tmp_path: Path) -> None:
    clip(walk(3)).save(tmp_path / "good.npz")
    good = (tmp_path / "good.npz").read_bytes()
    missing = fields()
    del missing["seed"]
    np.savez(tmp_path / "lacking.npz", **missing)  # type: ignore[arg-type]
    np.save(tmp_path / "single.npy", walk(3))
    (tmp_path / "text.npz").write_text("no archive")
    (tmp_path / "empty.npz").write_bytes(b"")
    (tmp_path / "short.npz").write_bytes(good[: len(good) // 2])
    (tmp_path / "flipped.npz").write_bytes(good[:400] + bytes([good[400] ^ 1]) + good[401:])
    names = ["lacking.npz", "single.npy", "text.npz", "empty.npz", "short.npz", "flipped.npz", "absent.npz"]
    for name in [*names, "."]:
        with pytest.raises(InvalidInputError):
            read_npz(tmp_path / name)
