"""One body for clips of many: bone lengths of HumanML3D, and one layout of hips, spine and shoulders.

Motion capture systems disagree on more than lengths. Where one puts the collar bones level with the top of the spine,
another lets them rise from the chest, so that the same shrug has other directions. A bone of hips, spine or shoulders
is therefore turned by the rotation that leads from where the source's bone rests to where this body's does, in the
frame of the pelvis or of the chest. Bones of arms and legs keep their directions. The hips travel as far as the legs
are longer, so that planted feet stay planted.

Frames are right-handed with Y up; a resting body faces +Z and has its left at +X. Lengths are in metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from kinegraph.arrays import DoubleArray, FloatArray, Floats
from kinegraph.motion.quaternions import shortest_rotation, to_matrix
from kinegraph.motion.skeleton import FEET, JOINT_INDEX, JOINT_NAMES, JOINTS, PARENTS, PELVIS

_SIDED: Final = {
    "hip": (0.107, (0.57, -0.80, -0.17)),
    "knee": (0.392, None),
    "ankle": (0.429, None),
    "foot": (0.146, None),
    "collar": (0.140, (0.53, 0.84, -0.14)),
    "shoulder": (0.127, (0.93, 0.34, -0.14)),
    "elbow": (0.260, None),
    "wrist": (0.268, None),
}
_MIDDLE: Final = {
    "spine1": (0.132, (0.0, 0.955, -0.29)),
    "spine2": (0.143, (0.0, 0.98, 0.19)),
    "spine3": (0.057, (0.0, 1.0, 0.05)),
    "neck": (0.219, (0.0, 0.99, -0.14)),
    "head": (0.103, (0.0, 0.87, 0.49)),
}
"""Joint -> length of the bone to its parent, and the direction in which it rests; None where any pose is usual."""

FLOOR_QUANTILE: Final = 0.02
"""Of the lowest foot joint's heights over a clip: the height that a clip keeps when its body changes."""

_LOWER: Final = frozenset(("left_hip", "right_hip", "spine1", "spine2"))
"""Bones that turn with the pelvis; the others of the trunk turn with the chest."""


def _bone(name: str) -> tuple[float, tuple[float, float, float] | None]:
    side, _, part = name.partition("_")
    if part not in _SIDED:
        return _MIDDLE[name]
    length, rest = _SIDED[part]
    return length, rest if rest is None or side == "left" else (-rest[0], rest[1], rest[2])


BONE_LENGTHS: Final[FloatArray] = np.array([_bone(name)[0] for name in JOINT_NAMES[1:]], dtype=np.float32)
"""(21,) metres; bone k belongs to joint k + 1."""

_RESTS: Final = {
    JOINT_INDEX[name]: np.array(rest) / np.linalg.norm(rest)
    for name in JOINT_NAMES[1:]
    if (rest := _bone(name)[1]) is not None
}
_LEGS: Final = tuple(JOINT_INDEX[f"{side}_{part}"] for side in ("left", "right") for part in ("knee", "ankle"))


def trunk_frames(joints: Floats) -> tuple[DoubleArray, DoubleArray]:
    """Compute the axes of pelvis and chest: left, up and forward as columns.

    Args:
        joints: (frames, 22, 3).

    Returns:
        Two rotations, (frames, 3, 3) each.
    """
    points = joints.astype(np.float64)
    hips = points[:, JOINT_INDEX["left_hip"]] - points[:, JOINT_INDEX["right_hip"]]
    shoulders = points[:, JOINT_INDEX["left_shoulder"]] - points[:, JOINT_INDEX["right_shoulder"]]
    # From the middle of the hips and to the neck: points that every capture system means alike.
    base = 0.5 * (points[:, JOINT_INDEX["left_hip"]] + points[:, JOINT_INDEX["right_hip"]])
    middle = points[:, JOINT_INDEX["spine2"]]
    return _axes(hips, middle - base), _axes(shoulders, points[:, JOINT_INDEX["neck"]] - middle)


def _axes(left: DoubleArray, up: DoubleArray) -> DoubleArray:
    """Make axes (frames, 3, 3) of a direction to the left and one upwards, which is kept exactly."""
    up = up / np.linalg.norm(up, axis=-1, keepdims=True).clip(min=1e-6)
    forward = np.cross(left, up)
    forward /= np.linalg.norm(forward, axis=-1, keepdims=True).clip(min=1e-6)
    return np.stack([np.cross(up, forward), up, forward], axis=-1)


def rest_directions(clips: Sequence[Floats]) -> dict[int, DoubleArray]:
    """Measure where the bones of a source's trunk rest: the mean direction of each in its frame.

    Args:
        clips: all of one skeleton, (frames, 22, 3) each.

    Returns:
        Unit vector (3,) by joint, left and right mirror images of each other.
    """
    sums = {joint: np.zeros(3) for joint in _RESTS}
    for joints in clips:
        frames = trunk_frames(joints)
        for joint in _RESTS:
            axes = frames[0] if JOINT_NAMES[joint] in _LOWER else frames[1]
            sums[joint] += np.einsum("tji,tj->i", axes, _directions(joints, joint))
    for joint in _RESTS:
        name = JOINT_NAMES[joint]
        if name.startswith("left_"):
            other = JOINT_INDEX["right_" + name.removeprefix("left_")]
            sums[joint] = sums[joint] + sums[other] * (-1, 1, 1)
            sums[other] = sums[joint] * (-1, 1, 1)
        elif not name.startswith("right_"):
            sums[joint][0] = 0.0
    return {joint: total / np.linalg.norm(total) for joint, total in sums.items()}


def _directions(joints: Floats, joint: int) -> DoubleArray:
    """Compute the unit direction (frames, 3) from a joint's parent to it."""
    bone = (joints[:, joint] - joints[:, PARENTS[joint]]).astype(np.float64)
    return bone / np.linalg.norm(bone, axis=-1, keepdims=True).clip(min=1e-6)


def to_common_skeleton(joints: FloatArray, rests: dict[int, DoubleArray]) -> FloatArray:
    """Bring a clip to `BONE_LENGTHS` and the common layout of the trunk.

    Args:
        joints: (frames, 22, 3).
        rests: of the clip's source, see `rest_directions`.

    Returns:
        (frames, 22, 3) over the same floor, starting on the same vertical axis.
    """
    frames = trunk_frames(joints)
    bones = np.zeros((len(joints), JOINTS, 3))
    for joint in range(1, JOINTS):
        direction = _directions(joints, joint)
        if joint in _RESTS:
            axes = frames[0] if JOINT_NAMES[joint] in _LOWER else frames[1]
            turn = axes @ to_matrix(shortest_rotation(rests[joint], _RESTS[joint])) @ axes.transpose(0, 2, 1)
            direction = np.einsum("tij,tj->ti", turn, direction)
        bones[:, joint] = direction * BONE_LENGTHS[joint - 1]
    hips = [JOINT_INDEX["left_hip"], JOINT_INDEX["right_hip"]]
    old_legs = np.mean([np.linalg.norm(joints[:, leg] - joints[:, PARENTS[leg]], axis=-1).mean() for leg in _LEGS])
    scale = BONE_LENGTHS[[leg - 1 for leg in _LEGS]].mean() / old_legs
    moved = np.zeros_like(bones)
    moved[:, PELVIS] = joints[:, hips].mean(axis=1) * scale - bones[:, hips].mean(axis=1)
    for joint in range(1, JOINTS):
        moved[:, joint] = moved[:, PARENTS[joint]] + bones[:, joint]
    moved[..., 1] += _floor(joints) - _floor(moved)
    moved[..., [0, 2]] += (joints[0, PELVIS] - moved[0, PELVIS])[[0, 2]]
    return moved.astype(np.float32)


def _floor(joints: Floats) -> float:
    """Measure the height that the lowest foot joint of a clip keeps to."""
    return float(np.quantile(joints[:, list(FEET), 1].min(axis=1), FLOOR_QUANTILE))
