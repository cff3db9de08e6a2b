"""BVH read back by two parsers: one with matrices here, and an independent program."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from kinegraph.clip import Clip
from kinegraph.formats import encode
from kinegraph.formats.bvh import euler_zxy
from kinegraph.motion.skeleton import CONVENTIONS, JOINT_NAMES, PARENTS, facing_angle
from support.motions import recorded, t_pose, turn, walk, with_recorded
from support.readers import bvh_joints

UPPER = [None if parent < 0 else JOINT_NAMES[parent] for parent in PARENTS]


def clip(joints: np.ndarray, fps: float = 20.0, text: str = "a person walks") -> Clip:
    return Clip(joints=joints, fps=fps, seed=2**40, text=text, bundle="edge 1.2")


@dataclass(frozen=True)
class BvhFile:
    """What a BVH file holds; End Sites are left out."""

    parents: dict[str, str | None]
    """In the order of the file."""
    offsets: dict[str, np.ndarray]
    channels: dict[str, np.ndarray]
    """Joint and channel ("pelvis Xposition") -> (frames,) values."""
    frames: list[dict[str, np.ndarray]]
    """Positions of all joints in the world, centimetres."""
    frame_time: float

    @property
    def joints(self) -> np.ndarray:
        """(frames, 22, 3) centimetres, in our order."""
        return np.array([[frame[name] for name in JOINT_NAMES] for frame in self.frames])

    @property
    def rest(self) -> dict[str, np.ndarray]:
        """Positions that the OFFSETs alone add up to, centimetres."""
        places: dict[str, np.ndarray] = {}
        for name, parent in self.parents.items():
            places[name] = self.offsets[name] + (0 if parent is None else places[parent])
        return places


def read_bvh(data: bytes) -> BvhFile:
    """Parse a BVH file with matrices; position channels replace the OFFSET, as in Blender."""
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
    values = np.array([row.split() for row in rows], dtype=float)
    assert values.shape[1] == len(channels)
    frames = []
    for row in values:
        axes, shifts = {name: np.eye(3) for name in names}, {name: offsets[name].copy() for name in names}
        for (name, channel), value in zip(channels, row, strict=True):
            if channel.endswith("position"):
                shifts[name]["XYZ".index(channel[0])] = value
            else:
                axes[name] = axes[name] @ turn(channel[0].lower(), np.radians(value))
        world: dict[str, np.ndarray] = {}
        for name in names:
            parent = parents[name]
            position = shifts[name] if parent is None else world[parent][:, 3] + world[parent][:, :3] @ shifts[name]
            rotated = axes[name] if parent is None else world[parent][:, :3] @ axes[name]
            world[name] = np.column_stack([rotated, position])
        frames.append({name: world[name][:, 3] for name in names})
    columns = {f"{name} {channel}": values[:, index] for index, (name, channel) in enumerate(channels)}
    return BvhFile(parents, offsets, columns, frames, float(time_line.removeprefix("Frame Time:")))


@pytest.mark.parametrize("turning", [0.0, 0.1, -0.05])
def test_bvh_of_a_walking_figure(turning: float) -> None:
    joints = walk(70, turning=turning)
    file = read_bvh(encode(clip(joints, fps=30.0), ".bvh"))
    assert file.parents == dict(zip(JOINT_NAMES, UPPER, strict=True))
    assert file.frame_time == pytest.approx(1 / 30, abs=1e-8)
    assert np.linalg.norm(file.joints / 100 - joints, axis=-1).max() < 1e-3


def test_bvh_of_recorded_clips() -> None:
    for joints in recorded(count=12):
        file = read_bvh(encode(clip(joints), ".bvh"))
        assert file.frame_time == pytest.approx(0.05)
        assert np.linalg.norm(file.joints / 100 - joints, axis=-1).max() < 1e-3


@pytest.mark.parametrize("root", [False, True])
def test_bvh_rest_pose_is_a_t_pose_that_faces_ahead_and_stands_on_the_floor(root: bool) -> None:
    rest = read_bvh(encode(clip(walk(40, heading=2.0)), ".bvh", root=root)).rest
    assert rest["left_wrist"][0] > rest["left_elbow"][0] > rest["left_shoulder"][0] > 5
    assert rest["right_wrist"][0] < rest["right_elbow"][0] < rest["right_shoulder"][0] < -5
    assert abs(rest["left_wrist"][1] - rest["left_shoulder"][1]) < 1e-4
    assert rest["head"][1] > rest["neck"][1] > rest["spine3"][1] > rest["pelvis"][1] + 20
    assert rest["left_ankle"][1] + 40 < rest["left_knee"][1] < rest["pelvis"][1] - 40
    assert min(place[1] for place in rest.values()) == pytest.approx(0.0, abs=1e-5)
    assert 90 < rest["pelvis"][1] < 100 and rest["pelvis"][0] == rest["pelvis"][2] == 0
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


def test_one_frame_can_be_written() -> None:
    for root in (False, True):
        file = read_bvh(encode(clip(t_pose(1)), ".bvh", root=root))
        np.testing.assert_allclose(file.joints[0] / 100, t_pose(1)[0], atol=1e-3)


@pytest.mark.parametrize("turning", [0.0, 0.1])
def test_a_root_joint_carries_travel_and_heading_and_leaves_the_joints_where_they_are(turning: float) -> None:
    joints = walk(60, turning=turning)
    file = read_bvh(encode(clip(joints), ".bvh", root=True))
    assert file.parents == {"root": None, **dict(zip(JOINT_NAMES, UPPER, strict=True)), "pelvis": "root"}
    assert np.linalg.norm(file.joints / 100 - joints, axis=-1).max() < 1e-3
    root = {name: file.channels[f"root {name}"] for name in ("Xposition", "Yposition", "Zposition", "Yrotation")}
    np.testing.assert_allclose(root["Xposition"] / 100, joints[:, 0, 0], atol=1e-6)
    np.testing.assert_allclose(root["Zposition"] / 100, joints[:, 0, 2], atol=1e-6)
    assert not root["Yposition"].any() and not file.offsets["root"].any()
    assert not file.channels["root Zrotation"].any() and not file.channels["root Xrotation"].any()
    np.testing.assert_allclose(root["Yrotation"], np.degrees(facing_angle(joints)), atol=1e-4)
    assert np.abs(file.channels["pelvis Xposition"]).max() < 0.1 > np.abs(file.channels["pelvis Zposition"]).max()
    np.testing.assert_allclose(file.channels["pelvis Yposition"] / 100, joints[:, 0, 1], atol=1e-3)
    assert np.abs(file.channels["pelvis Yrotation"]).max() < 15


def test_both_conventions_call_the_root_joint_root() -> None:
    for convention, names in CONVENTIONS.items():
        parents = read_bvh_names(encode(clip(walk(9)), ".bvh", convention, True))
        assert parents[0] == "root" and set(parents[1:]) == set(names)


def read_bvh_names(data: bytes) -> list[str]:
    return re.findall(r"^\s*(?:ROOT|JOINT) (\S+)$", data.decode(), flags=re.MULTILINE)


def test_a_reader_of_bvh_finds_the_joints_of_the_clip(tmp_path: Path) -> None:
    for joints in with_recorded([walk(50, turning=0.05)], 3):
        (tmp_path / "clip.bvh").write_bytes(encode(clip(joints), ".bvh", "smpl"))
        seen, fps = bvh_joints(tmp_path / "clip.bvh")
        assert fps == pytest.approx(20.0)
        error = np.linalg.norm(seen - joints, axis=-1)
        assert error.mean() < 0.005 and error.max() < 0.015
