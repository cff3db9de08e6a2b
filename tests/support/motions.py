"""Motion for tests: a stick figure that walks, waves and bows, computed with matrices; recorded clips of ../shared."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from kinegraph.motion.kinematics import CHILDREN, rotations_from_positions
from kinegraph.motion.quaternions import multiply, normalised, shortest_rotation
from kinegraph.motion.skeleton import PARENTS
from support.shared import shared_path

# Parent, and offset from it in metres, in the order of the 22 joints; standing with the arms out, facing +Z.
BONES = (
    (-1, (0.0, 0.0, 0.0)),
    (0, (0.10, -0.08, 0.0)),
    (0, (-0.10, -0.08, 0.0)),
    (0, (0.0, 0.10, -0.01)),
    (1, (0.0, -0.40, 0.0)),
    (2, (0.0, -0.40, 0.0)),
    (3, (0.0, 0.13, 0.0)),
    (4, (0.0, -0.41, 0.0)),
    (5, (0.0, -0.41, 0.0)),
    (6, (0.0, 0.06, 0.02)),
    (7, (0.0, -0.06, 0.12)),
    (8, (0.0, -0.06, 0.12)),
    (9, (0.0, 0.21, -0.03)),
    (9, (0.07, 0.12, -0.02)),
    (9, (-0.07, 0.12, -0.02)),
    (12, (0.0, 0.10, 0.04)),
    (13, (0.12, 0.04, 0.0)),
    (14, (-0.12, 0.04, 0.0)),
    (16, (0.26, 0.0, 0.0)),
    (17, (-0.26, 0.0, 0.0)),
    (18, (0.25, 0.0, 0.0)),
    (19, (-0.25, 0.0, 0.0)),
)


def turn(axis: str, angle: float) -> np.ndarray:
    """Build the right-handed rotation matrix about x, y or z, radians."""
    c, s = np.cos(angle), np.sin(angle)
    rows = {
        "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
        "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }
    return np.array(rows[axis], dtype=np.float64)


def posed(root: np.ndarray, turns: dict[int, np.ndarray]) -> np.ndarray:
    """Pose the figure with some joints turned relative to their parents: (22, 3)."""
    positions, axes = [np.asarray(root, dtype=np.float64)], [turns.get(0, np.eye(3))]
    for joint, (parent, offset) in enumerate(BONES[1:], start=1):
        positions.append(positions[parent] + axes[parent] @ np.array(offset))
        axes.append(axes[parent] @ turns.get(joint, np.eye(3)))
    return np.stack(positions)


def t_pose(frames: int = 4) -> np.ndarray:
    """Stand still with the arms out, toes on the floor: (frames, 22, 3)."""
    pose = posed(np.zeros(3), {})
    pose[:, 1] -= pose[:, 1].min()
    return np.repeat(pose[None], frames, axis=0).astype(np.float32)


def walk(
    frames: int = 60,
    *,
    turning: float = 0.0,
    heading: float = 0.0,
    speed: float = 0.05,
    cadence: float = 0.35,
    swing: float = 0.5,
) -> np.ndarray:
    """Walk along a heading that may turn: (frames, 22, 3) metres.

    Args:
        frames: at 20 per second.
        turning: radians per frame, positive to the left.
        heading: radians at the first frame, 0 is +Z.
        speed: metres per frame.
        cadence: radians of the step cycle per frame.
        swing: largest angle of a leg from the vertical, radians.
    """
    root, rows = np.array([0.0, 0.95, 0.0]), []
    for frame in range(frames):
        phase, angle = cadence * frame, heading + turning * frame
        leg = swing * np.sin(phase)
        turns = {
            0: turn("y", angle) @ turn("z", 0.04 * np.sin(phase)),
            1: turn("x", -leg),
            2: turn("x", leg),
            3: turn("x", 0.1) @ turn("y", 0.15 * np.sin(phase)),
            4: turn("x", 0.4 + 0.3 * np.sin(phase)),
            5: turn("x", 0.4 - 0.3 * np.sin(phase)),
            6: turn("x", -0.05),
            7: turn("x", -0.2),
            8: turn("x", -0.2 + 0.1 * np.cos(phase)),
            12: turn("x", 0.1 * np.cos(phase)),
            13: turn("z", 0.05 * np.sin(phase)),
            16: turn("x", leg) @ turn("z", -1.2),
            17: turn("x", -leg) @ turn("z", 1.2),
            18: turn("y", -0.3 - 0.2 * np.sin(phase)),
            19: turn("y", 0.3 - 0.2 * np.sin(phase)),
        }
        rows.append(posed(root, turns))
        root = root + speed * np.array([np.sin(angle), 0.0, np.cos(angle)])
    joints = np.stack(rows)
    joints[..., 1] -= joints[..., 1].min()
    return joints.astype(np.float32)


def stand(frames: int = 40, *, wave: float = 0.0, bow: float = 0.0, rate: float = 0.6) -> np.ndarray:
    """Stand with hanging arms, raise and wave the right hand, bow, and come back: (frames, 22, 3) metres.

    Args:
        frames: at 20 per second.
        wave: radians by which the right arm is raised at the most.
        bow: radians by which the back bends forward at the most.
        rate: radians of the waving hand's cycle per frame.
    """
    rows = []
    for frame in range(frames):
        share = np.sin(np.pi * frame / (frames - 1)) ** 2
        raised = min(1.0, 3.0 * share) * wave
        bent = bow * share / 3.0
        turns = {
            **{joint: turn("x", bent) for joint in (3, 6, 9)},
            12: turn("x", bent),
            16: turn("z", -1.2),
            17: turn("z", 1.2 - raised),
            19: turn("z", -0.5 * raised * (1.0 + np.sin(rate * frame)) / 2.0),
        }
        rows.append(posed(np.array([0.0, 0.95, 0.0]), turns))
    joints = np.stack(rows)
    joints[..., 1] -= joints[..., 1].min()
    return joints.astype(np.float32)


def world_turns(joints: np.ndarray, fps: float = 20.0) -> np.ndarray:
    """Solve the rotation of every joint in world space: (frames, 22, 4) quaternions."""
    turns = np.array(rotations_from_positions(joints, fps).rotations)
    for joint in range(1, len(PARENTS)):
        turns[:, joint] = multiply(turns[:, PARENTS[joint]], turns[:, joint])
    return turns


def largest_twist(joints: np.ndarray, fps: float = 20.0) -> float:
    """Find the largest twist of a limb about its own length between two frames, degrees.

    The twist is the joint's rotation without the shortest rotation that moves its bone.
    """
    turns, largest = world_turns(joints, fps), 0.0
    for joint, children in enumerate(CHILDREN):
        if len(children) == 1:
            bone = normalised((joints[:, children[0]] - joints[:, joint]).astype(np.float64))
            swung = multiply(shortest_rotation(bone[:-1], bone[1:]), turns[:-1, joint])
            cosine = np.abs((turns[1:, joint] * swung).sum(-1))
            largest = max(largest, float(np.degrees(2 * np.arccos(cosine.clip(0, 1))).max()))
    return largest


def with_recorded(made: list[np.ndarray], count: int) -> list[np.ndarray]:
    """Add about `count` recorded clips to made ones, where there are any."""
    try:
        return [*made, *recorded(count=count)]
    except pytest.skip.Exception:
        return made


def recorded(source: str = "bandai", count: int | None = None, split: str = "val") -> list[np.ndarray]:
    """Read about `count` recorded clips (frames, 22, 3), spread over a split; skip the test where there are none."""
    path = shared_path("data", source, f"{split}.npz")
    with np.load(path, allow_pickle=False) as pack:
        offsets, joints, root, scale = pack["offsets"], pack["joints"], pack["root_xz"], pack["scale"]
    metres = joints.astype(np.float32) * scale
    metres[..., [0, 2]] += root[:, None]
    pairs = list(pairwise(offsets))
    step = max(1, len(pairs) // count) if count else 1
    return [metres[start:end] for start, end in pairs[::step]]
