"""The rotations of layout `humanml3d-263`: the skeleton of Guo et al. (2022), solved along five chains.

They say how each bone is turned against the axis it is given here, with no twist and with the heading of the
body in the root. They serve that layout alone; files for animation take theirs from `rotations`.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from kinegraph.errors import InvalidInputError
from kinegraph.motion.quaternions import (
    IDENTITY,
    about_axis,
    between,
    conjugate,
    multiply,
    normalised,
    rotate,
)
from kinegraph.motion.skeleton import JOINTS, LEFT_HIP, LEFT_SHOULDER, RIGHT_HIP, RIGHT_SHOULDER

FloatArray = NDArray[np.floating[Any]]

Heading = Literal["humanml3d", "true"]
HEADINGS: Final[tuple[Heading, ...]] = ("humanml3d", "true")

CHAINS: Final[tuple[tuple[int, ...], ...]] = (
    (0, 2, 5, 8, 11),
    (0, 1, 4, 7, 10),
    (0, 3, 6, 9, 12, 15),
    (9, 14, 17, 19, 21),
    (9, 13, 16, 18, 20),
)

_AXES: Final = {
    "left": (1, 0, 0),
    "right": (-1, 0, 0),
    "up": (0, 1, 0),
    "down": (0, -1, 0),
    "ahead": (0, 0, 1),
}
_DIRECTIONS: Final = (
    *("left", "right", "up", "down", "down", "up", "down", "down", "up", "ahead", "ahead"),
    *("up", "left", "right", "ahead", "down", "down", "down", "down", "down", "down"),
)
BONE_AXES: Final = np.array([(0, 0, 0), *(_AXES[name] for name in _DIRECTIONS)], dtype=np.float32)
"""(22, 3): the direction of each joint from its parent when nothing is turned."""

_LEG: Final = (5, 8)
_SIGMA: Final = 20.0
_RADIUS: Final = 80


def facing(joints: FloatArray, *, heading: Heading, smooth: bool) -> FloatArray:
    """Horizontal unit vectors (frames, 3) the body faces.

    Args:
        joints: (frames, 22, 3).
        heading: "true" takes hips and shoulders both right minus left; "humanml3d" takes the hips left minus
            right, as the released code does.
        smooth: with "humanml3d", a Gaussian of 20 frames over the directions.
    """
    hips = joints[:, RIGHT_HIP] - joints[:, LEFT_HIP]
    shoulders = joints[:, RIGHT_SHOULDER] - joints[:, LEFT_SHOULDER]
    across = normalised(shoulders + hips if heading == "true" else shoulders - hips)
    ahead: FloatArray = np.stack([across[:, 2], np.zeros_like(across[:, 0]), -across[:, 0]], axis=-1)
    if smooth and heading == "humanml3d":
        ahead = _smoothed(ahead)
    return normalised(ahead)


def solve(joints: FloatArray, *, heading: Heading, smooth: bool) -> FloatArray:
    """Quaternions (frames, 22, 4): the root's takes the facing to +Z, the others are relative in their chain.

    As in the released code the chains of the arms start from the root's turn, not from the spine's, and the
    root of the first frame is not turned.
    """
    ahead = facing(joints, heading=heading, smooth=smooth)
    # About Y by name: the shortest turn from straight behind may go about any axis.
    root = about_axis(1, -np.arctan2(ahead[:, 0], ahead[:, 2]))
    root[0] = IDENTITY
    turns = np.zeros((len(joints), JOINTS, 4), dtype=joints.dtype)
    turns[:, 0] = root
    for chain in CHAINS:
        before = root
        for parent, child in pairwise(chain):
            axis = BONE_AXES[child].astype(joints.dtype)
            now = between(axis, normalised(joints[:, child] - joints[:, parent]))
            turns[:, child] = multiply(conjugate(before), now)
            before = now
    return turns


def chain_kinematics(turns: FloatArray, root: FloatArray, offsets: FloatArray) -> FloatArray:
    """Joints (frames, 22, 3) of `solve`'s turns on a skeleton with `offsets` (22, 3); root (frames, 3)."""
    joints = np.zeros((len(turns), JOINTS, 3), dtype=turns.dtype)
    joints[:, 0] = root
    for chain in CHAINS:
        turn = turns[:, 0]
        for parent, child in pairwise(chain):
            turn = multiply(turn, turns[:, child])
            joints[:, child] = joints[:, parent] + rotate(turn, offsets[child])
    return joints


def retargeted(joints: FloatArray, target_offsets: FloatArray, *, heading: Heading) -> FloatArray:
    """The motion on a skeleton with other bone lengths; the root's path is scaled with the length of the leg.

    Args:
        joints: (frames, 22, 3) metres.
        target_offsets: (22, 3) metres, `BONE_AXES` times the wanted bone lengths.
        heading: see `facing`.

    Raises:
        InvalidInputError: offsets of another shape, or a leg without length.
    """
    target = np.asarray(target_offsets, dtype=joints.dtype)
    if target.shape != (JOINTS, 3) or not np.isfinite(target).all():
        allowed = f"finite metres, ({JOINTS}, 3)"
        raise InvalidInputError(f"target_offsets have shape {target.shape}; they must be {allowed}")
    own, wanted = _leg_length(_offsets_of(joints[0])), _leg_length(target)
    if own == 0 or wanted == 0:
        raise InvalidInputError("the right leg has no length; retargeting needs thigh and shank on both sides")
    turns = solve(joints, heading=heading, smooth=False)
    return chain_kinematics(turns, joints[:, 0] * (wanted / own), target)


def _offsets_of(pose: FloatArray) -> FloatArray:
    offsets = np.zeros_like(pose)
    for chain in CHAINS:
        for parent, child in pairwise(chain):
            offsets[child] = BONE_AXES[child] * np.linalg.norm(pose[child] - pose[parent])
    return offsets


def _leg_length(offsets: FloatArray) -> float:
    return float(np.abs(offsets[list(_LEG)]).max(axis=1).sum())


def _smoothed(rows: FloatArray) -> FloatArray:
    """Gaussian along the first axis; beyond the ends the first and last row go on."""
    steps = np.arange(-_RADIUS, _RADIUS + 1)
    weights = np.exp(-0.5 * (steps / _SIGMA) ** 2)
    weights /= weights.sum()
    longer = np.concatenate([rows[:1].repeat(_RADIUS, 0), rows, rows[-1:].repeat(_RADIUS, 0)])
    columns = [np.convolve(column, weights, mode="valid") for column in longer.astype(np.float64).T]
    return np.stack(columns, axis=-1).astype(rows.dtype)
