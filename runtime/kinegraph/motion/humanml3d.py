"""The rotations of layout `humanml3d-263`: the skeleton of Guo et al. (2022), solved along five chains.

They say how each bone is turned against the axis it is given here, with no twist and with the heading of the
body in the root. They serve that layout alone; files for animation take theirs from `rotations`.

Layout `humanml3d-263`: joints -> features -> joints.

Guo et al., 2022, "Generating Diverse and Natural 3D Human Motions from Text". One row per frame but the
last, in the frame of the body's facing:

    yaw velocity          1    half the turn to the next frame, radians, positive to the *right*
    root velocity         2    m / frame, x and z
    pelvis height         1    m
    local positions      63    21 joints relative to the pelvis on the floor plane; y is the height
    rotations           126    21 joints, first two columns of the matrix (Zhou et al., 2019)
    velocities           66    22 joints, m / frame
    contacts              4    left ankle, left toe, right ankle, right toe: 1 while planted

With `heading="humanml3d"` the facing is that of the released code, so that published statistics and weights
fit: the hips count left minus right against the shoulders, and the direction is smoothed. `"true"` is the
facing one means.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Final, Literal

import numpy as np

from kinegraph.arrays import FloatArray, Floats
from kinegraph.errors import InvalidInputError
from kinegraph.motion.quaternions import (
    IDENTITY,
    about_axis,
    between,
    conjugate,
    continuous,
    multiply,
    normalised,
    rotate,
    to_matrix,
)
from kinegraph.motion.skeleton import FEET, JOINTS, LEFT_HIP, LEFT_SHOULDER, RIGHT_HIP, RIGHT_SHOULDER, canonicalise

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


def facing(joints: Floats, *, heading: Heading, smooth: bool) -> Floats:
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
    ahead: Floats = np.stack([across[:, 2], np.zeros_like(across[:, 0]), -across[:, 0]], axis=-1)
    if smooth and heading == "humanml3d":
        ahead = _smoothed(ahead)
    return normalised(ahead)


def solve(joints: Floats, *, heading: Heading, smooth: bool) -> Floats:
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


def chain_kinematics(turns: Floats, root: Floats, offsets: Floats) -> Floats:
    """Joints (frames, 22, 3) of `solve`'s turns on a skeleton with `offsets` (22, 3); root (frames, 3)."""
    joints = np.zeros((len(turns), JOINTS, 3), dtype=turns.dtype)
    joints[:, 0] = root
    for chain in CHAINS:
        turn = turns[:, 0]
        for parent, child in pairwise(chain):
            turn = multiply(turn, turns[:, child])
            joints[:, child] = joints[:, parent] + rotate(turn, offsets[child])
    return joints


def retargeted(joints: Floats, target_offsets: Floats, *, heading: Heading) -> Floats:
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


def _offsets_of(pose: Floats) -> Floats:
    offsets = np.zeros_like(pose)
    for chain in CHAINS:
        for parent, child in pairwise(chain):
            offsets[child] = BONE_AXES[child] * np.linalg.norm(pose[child] - pose[parent])
    return offsets


def _leg_length(offsets: Floats) -> float:
    return float(np.abs(offsets[list(_LEG)]).max(axis=1).sum())


def _smoothed(rows: Floats) -> Floats:
    """Gaussian along the first axis; beyond the ends the first and last row go on."""
    steps = np.arange(-_RADIUS, _RADIUS + 1)
    weights = np.exp(-0.5 * (steps / _SIGMA) ** 2)
    weights /= weights.sum()
    longer = np.concatenate([rows[:1].repeat(_RADIUS, 0), rows, rows[-1:].repeat(_RADIUS, 0)])
    columns = [np.convolve(column, weights, mode="valid") for column in longer.astype(np.float64).T]
    return np.stack(columns, axis=-1).astype(rows.dtype)


YAW_VELOCITY: Final = slice(0, 1)
ROOT_VELOCITY: Final = slice(1, 3)
HEIGHT: Final = slice(3, 4)
POSITIONS: Final = slice(4, 67)
ROTATIONS: Final = slice(67, 193)
VELOCITIES: Final = slice(193, 259)
CONTACTS: Final = slice(259, 263)
WIDTH: Final = 263

GROUPS: Final[tuple[slice, ...]] = (*(YAW_VELOCITY, ROOT_VELOCITY, HEIGHT, POSITIONS, ROTATIONS, VELOCITIES, CONTACTS),)
"""Features whose standard deviation is averaged together in the published statistics."""

CONTACT_SQUARED_STEP: Final = 0.002
"""m^2; a foot that moves less between two frames counts as planted."""


def humanml3d_from_joints(
    joints: FloatArray, *, heading: Heading = "humanml3d", target_offsets: FloatArray | None = None
) -> FloatArray:
    """Features of a clip, wherever it stands.

    Args:
        joints: (frames, 22, 3) metres, Y up, 20 frames per second, at least two frames.
        heading: "humanml3d" or "true", see above.
        target_offsets: (22, 3) metres; the clip is first moved to this skeleton. None keeps its own.

    Returns:
        (frames - 1, 263) float32.

    Raises:
        InvalidInputError: too few frames, another skeleton, or an unknown heading.
    """
    joints = np.asarray(joints, dtype=np.float32)
    if joints.ndim != 3 or joints.shape[1:] != (JOINTS, 3) or len(joints) < 2:
        allowed = f"(frames, {JOINTS}, 3), two frames or more"
        raise InvalidInputError(f"joints have shape {joints.shape}; it must be {allowed}")
    if heading not in HEADINGS:
        raise InvalidInputError(f"heading is {heading!r}; it must be one of {', '.join(HEADINGS)}")
    if target_offsets is not None:
        joints = retargeted(joints, target_offsets, heading=heading)
    return _rows(canonicalise(joints), heading)


def joints_from_humanml3d(features: FloatArray) -> FloatArray:
    """Joints of a clip that starts at the origin, from its positions; the rotations are not used.

    Args:
        features: (frames, 263), not normalised.

    Returns:
        (frames, 22, 3) float32 metres.
    """
    rows = np.asarray(features, dtype=np.float64)
    half = np.concatenate([[0.0], np.cumsum(rows[:-1, 0])])
    to_world = conjugate(about_axis(1, 2.0 * half))
    step = np.zeros((len(rows), 3))
    step[1:, [0, 2]] = rows[:-1, ROOT_VELOCITY]
    root = np.cumsum(rotate(to_world, step), axis=0)
    joints = np.empty((len(rows), JOINTS, 3))
    joints[:, 0] = root
    joints[:, 0, 1] = rows[:, HEIGHT.start]
    local = rows[:, POSITIONS].reshape(len(rows), JOINTS - 1, 3)
    joints[:, 1:] = rotate(to_world[:, None], local) + root[:, None]
    return joints.astype(np.float32)


def _rows(joints: FloatArray, heading: Heading) -> FloatArray:
    turns = solve(joints, heading=heading, smooth=True)
    # The released code leaves the sign to chance: a body that turns through its back loses its heading there.
    to_body = continuous(turns[:, 0])
    step = np.diff(joints, axis=0)
    turn = multiply(to_body[1:], conjugate(to_body[:-1]))
    root_step = rotate(to_body[1:], step[:, 0])
    on_floor = joints[:, :1] * np.array([1.0, 0.0, 1.0], dtype=np.float32)
    local = rotate(to_body[:, None], joints - on_floor)[:-1]
    columns = to_matrix(turns[:-1, 1:])[..., :2]
    planted = (step[:, FEET] ** 2).sum(-1) < CONTACT_SQUARED_STEP
    count = len(step)
    rows = np.concatenate(
        [
            np.arcsin(np.clip(turn[:, 2:3], -1.0, 1.0)),
            root_step[:, [0, 2]],
            local[:, 0, 1:2],
            local[:, 1:].reshape(count, -1),
            columns.swapaxes(-1, -2).reshape(count, -1),
            rotate(to_body[:-1, None], step).reshape(count, -1),
            planted,
        ],
        axis=1,
    )
    return rows.astype(np.float32)
