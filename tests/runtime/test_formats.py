"""Files read back by readers of the tests' own: NumPy alone, and a small BVH parser with matrices."""

from __future__ import annotations

import json
import re
import time
from pathlib import Path

import numpy as np
import pytest

from kinegraph.clip import Clip
from kinegraph.errors import InvalidInputError
from kinegraph.formats import encode
from kinegraph.formats.bvh import euler_zxy
from kinegraph.formats.npz import read_npz
from kinegraph.motion.skeleton import JOINT_INDEX, JOINT_NAMES, PARENTS
from support.motions import recorded, t_pose, turn, walk


def clip(joints: np.ndarray, fps: float = 20.0, text: str = "a person walks") -> Clip:
    return Clip(joints=joints, fps=fps, seed=2**40, text=text, bundle="edge 1.2")


def read_bvh(data: bytes) -> tuple[list[str], dict[str, str | None], np.ndarray, float]:
    """Names in file order, parents, world positions in centimetres, frame time; End Sites left out."""
    head, motion = data.decode("ascii").split("MOTION\n")
    names, parents, offsets, channels, stack = [], {}, {}, [], []
    for line in head.splitlines()[1:]:
        words = line.split()
        if words[0] in ("ROOT", "JOINT"):
            parents[words[1]] = stack[-1] if stack else None
            stack.append(words[1])
            names.append(words[1])
        elif words[0] == "End":
            stack.append("end")
        elif words[0] == "OFFSET" and stack[-1] != "end":
            offsets[stack[-1]] = np.array(words[1:], dtype=float)
        elif words[0] == "CHANNELS":
            assert int(words[1]) == len(words) - 2
            channels += [(stack[-1], word) for word in words[2:]]
        elif words[0] == "}":
            stack.pop()
    assert not stack
    frames_line, time_line, *rows = motion.splitlines()
    assert int(frames_line.removeprefix("Frames:")) == len(rows)
    places = []
    for row in rows:
        values = [float(word) for word in row.split()]
        assert len(values) == len(channels)
        axes, shifts = {name: np.eye(3) for name in names}, {name: offsets[name].copy() for name in names}
        for (name, channel), value in zip(channels, values, strict=True):
            if channel.endswith("position"):
                shifts[name]["XYZ".index(channel[0])] += value
            else:
                axes[name] = axes[name] @ turn(channel[0].lower(), np.radians(value))
        world: dict[str, np.ndarray] = {}
        for name in names:
            parent = parents[name]
            place = shifts[name] if parent is None else world[parent][:, 3] + world[parent][:, :3] @ shifts[name]
            turned = axes[name] if parent is None else world[parent][:, :3] @ axes[name]
            world[name] = np.column_stack([turned, place])
        places.append([world[name][:, 3] for name in JOINT_NAMES])
    return names, parents, np.array(places), float(time_line.removeprefix("Frame Time:"))


@pytest.mark.parametrize("turning", [0.0, 0.1, -0.05])
def test_bvh_of_a_walking_figure(turning: float) -> None:
    joints = walk(70, turning=turning)
    names, parents, places, frame_time = read_bvh(encode(clip(joints, fps=30.0), ".bvh"))
    assert sorted(names) == sorted(JOINT_NAMES)
    expected = {name: None if up < 0 else JOINT_NAMES[up] for name, up in zip(JOINT_NAMES, PARENTS, strict=True)}
    assert parents == expected
    assert frame_time == pytest.approx(1 / 30, abs=1e-8)
    assert np.linalg.norm(places / 100 - joints, axis=-1).max() < 1e-3


def test_bvh_of_recorded_clips() -> None:
    for joints in recorded(count=12):
        _, _, places, frame_time = read_bvh(encode(clip(joints), ".bvh"))
        assert frame_time == pytest.approx(0.05)
        assert np.linalg.norm(places / 100 - joints, axis=-1).max() < 1e-3


def test_bvh_rest_pose_is_a_t_pose_that_faces_ahead() -> None:
    text = encode(clip(walk(40, heading=2.0)), ".bvh").decode()
    zeros = re.sub(r"(?m)^-?\d.*$", " ".join(["0"] * 69), text)
    _, _, places, _ = read_bvh(zeros.encode())
    rest = dict(zip(JOINT_NAMES, places[0], strict=True))
    assert rest["left_wrist"][0] > rest["left_elbow"][0] > rest["left_shoulder"][0] > 5
    assert rest["right_wrist"][0] < rest["right_elbow"][0] < rest["right_shoulder"][0] < -5
    assert abs(rest["left_wrist"][1] - rest["left_shoulder"][1]) < 1e-4
    assert rest["head"][1] > rest["neck"][1] > rest["spine3"][1] > 20
    assert rest["left_ankle"][1] < rest["left_knee"][1] < -40
    assert rest["left_foot"][2] > rest["left_ankle"][2] + 5


def test_bvh_angles_do_not_jump_while_the_body_turns_around_twice() -> None:
    data = encode(clip(walk(140, turning=0.1)), ".bvh").decode()
    rows = np.array([line.split() for line in data.splitlines() if re.match(r"^-?\d", line)], dtype=float)
    assert rows.shape == (140, 69)
    assert np.abs(np.diff(rows[:, 3:], axis=0)).max() < 40
    # Two turns and more, written as such.
    assert np.ptp(rows[:, 5]) > 700


@pytest.mark.parametrize("x", [0.3, 1.5707, np.pi / 2, -np.pi / 2, 2.5])
def test_euler_angles_give_the_matrix_back(x: float) -> None:
    rng = np.random.default_rng(0)
    turns = np.stack([turn("z", a) @ turn("x", x) @ turn("y", b) for a, b in rng.uniform(-3, 3, size=(30, 2))])[:, None]
    angles = euler_zxy(turns)
    again = np.stack([turn("z", z) @ turn("x", x) @ turn("y", y) for z, x, y in angles[:, 0]])
    np.testing.assert_allclose(again, turns[:, 0], atol=1e-6)


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


def test_json_holds_the_clip_and_a_skeleton_that_turns_into_it() -> None:
    joints, text = walk(30, turning=0.05), "ein Mensch geht – 歩く"
    found = json.loads(encode(clip(joints, fps=29.97, text=text), ".json"))
    about = {name: found[name] for name in ("text", "seed", "bundle", "fps")}
    assert about == {"text": text, "seed": str(2**40), "bundle": "edge 1.2", "fps": 29.97}
    assert tuple(found["joint_names"]) == JOINT_NAMES and tuple(found["parents"]) == PARENTS
    np.testing.assert_allclose(found["joints"], joints, atol=1e-5)
    # played by the textbook: each joint is its parent's place and its offset, turned by all joints above it
    for frame in (0, 13, 29):
        places: list[np.ndarray] = []
        axes: list[np.ndarray] = []
        for joint, parent in enumerate(found["parents"]):
            own = rotation_matrix(*found["rotations"][frame][joint])
            offset = np.array(found["rest_offsets"][joint])
            root = np.array(found["joints"][frame][0])
            places.append(root if parent < 0 else places[parent] + axes[parent] @ offset)
            axes.append(own if parent < 0 else axes[parent] @ own)
        assert np.linalg.norm(np.array(places) - joints[frame], axis=-1).max() < 1e-3


def rotation_matrix(w: float, x: float, y: float, z: float) -> np.ndarray:
    """Rodrigues: I + 2 w [v] + 2 [v]^2."""
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


@pytest.mark.parametrize("suffix", [".npz", ".bvh", ".json"])
def test_equal_clips_give_equal_bytes_at_any_time(monkeypatch: pytest.MonkeyPatch, suffix: str) -> None:
    first = encode(clip(walk(20)), suffix)
    later = time.time() + 1e7
    moment = time.gmtime(later)
    monkeypatch.setattr(time, "time", lambda: later)
    monkeypatch.setattr(time, "localtime", lambda *_: moment)
    assert encode(clip(walk(20).astype(np.float64)), suffix) == first
    assert encode(clip(walk(21)), suffix) != first


def test_one_frame_can_be_written() -> None:
    _, _, places, _ = read_bvh(encode(clip(t_pose(1)), ".bvh"))
    np.testing.assert_allclose(places[0] / 100, t_pose(1)[0], atol=1e-3)
    assert JOINT_INDEX["pelvis"] == 0


def fields(**changes: object) -> dict[str, object]:
    good = {"joints": walk(3), "fps": 20.0, "seed": 1, "text": "x", "joint_names": JOINT_NAMES, "bundle": "b"}
    return {**good, **changes}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
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
