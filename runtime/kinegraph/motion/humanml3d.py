"""Layout `humanml3d-263`: joints -> features -> joints.

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

from typing import Final

import numpy as np

from kinegraph.errors import InvalidInputError
from kinegraph.motion.humanml3d_skeleton import HEADINGS, Heading, retargeted, solve
from kinegraph.motion.placement import placed
from kinegraph.motion.quaternions import about_axis, conjugate, continuous, multiply, rotate, to_matrix
from kinegraph.motion.skeleton import FEET, JOINTS, FloatArray

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
    return _rows(placed(joints), heading)


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
