"""BVH read back by two parsers: one with matrices here, and an independent program."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from kinegraph.clip import Clip
from kinegraph.formats import encode
from kinegraph.formats.bvh import euler_zxy
from kinegraph.motion.skeleton import JOINT_INDEX, JOINT_NAMES, PARENTS
from support.motions import recorded, t_pose, turn, walk
from support.readers import bvh_joints


def clip(joints: np.ndarray, fps: float = 20.0, text: str = "a person walks") -> Clip:
    return Clip(joints=joints, fps=fps, seed=2**40, text=text, bundle="edge 1.2")


def read_bvh(data: bytes) -> tuple[list[str], dict[str, str | None], np.ndarray, float]:
    """Parse a BVH file with matrices.

    Returns:
        Names in file order, parents, world positions (frames, 22, 3) in centimetres, seconds per frame; End Sites are
        left out.
    """
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
    positions = []
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
            position = shifts[name] if parent is None else world[parent][:, 3] + world[parent][:, :3] @ shifts[name]
            rotated = axes[name] if parent is None else world[parent][:, :3] @ axes[name]
            world[name] = np.column_stack([rotated, position])
        positions.append([world[name][:, 3] for name in JOINT_NAMES])
    return names, parents, np.array(positions), float(time_line.removeprefix("Frame Time:"))


@pytest.mark.parametrize("turning", [0.0, 0.1, -0.05])
def test_bvh_of_a_walking_figure(turning: float) -> None:
    joints = walk(70, turning=turning)
    names, parents, positions, frame_time = read_bvh(encode(clip(joints, fps=30.0), ".bvh"))
    assert sorted(names) == sorted(JOINT_NAMES)
    expected = {name: None if up < 0 else JOINT_NAMES[up] for name, up in zip(JOINT_NAMES, PARENTS, strict=True)}
    assert parents == expected
    assert frame_time == pytest.approx(1 / 30, abs=1e-8)
    assert np.linalg.norm(positions / 100 - joints, axis=-1).max() < 1e-3


def test_bvh_of_recorded_clips() -> None:
    for joints in recorded(count=12):
        _, _, positions, frame_time = read_bvh(encode(clip(joints), ".bvh"))
        assert frame_time == pytest.approx(0.05)
        assert np.linalg.norm(positions / 100 - joints, axis=-1).max() < 1e-3


def test_bvh_rest_pose_is_a_t_pose_that_faces_ahead() -> None:
    text = encode(clip(walk(40, heading=2.0)), ".bvh").decode()
    zeros = re.sub(r"(?m)^-?\d.*$", " ".join(["0"] * 69), text)
    _, _, positions, _ = read_bvh(zeros.encode())
    rest = dict(zip(JOINT_NAMES, positions[0], strict=True))
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


def test_one_frame_can_be_written() -> None:
    _, _, positions, _ = read_bvh(encode(clip(t_pose(1)), ".bvh"))
    np.testing.assert_allclose(positions[0] / 100, t_pose(1)[0], atol=1e-3)
    assert JOINT_INDEX["pelvis"] == 0


def test_a_reader_of_bvh_finds_the_joints_of_the_clip(tmp_path: Path) -> None:
    for joints in [walk(50, turning=0.05), *recorded(count=3)]:
        (tmp_path / "clip.bvh").write_bytes(encode(clip(joints), ".bvh", "smpl"))
        seen, fps = bvh_joints(tmp_path / "clip.bvh")
        assert fps == pytest.approx(20.0)
        error = np.linalg.norm(seen - joints, axis=-1)
        assert error.mean() < 0.005 and error.max() < 0.015
