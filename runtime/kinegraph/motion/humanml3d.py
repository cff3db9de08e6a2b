"""Feature layout `humanml3d-263` of Guo et al. (2022): conversion from joints, and back from its positions.

"Generating Diverse and Natural 3D Human Motions from Text". One row per frame but the last, in the facing frame of
that frame's body:

    yaw velocity          1    half the turn to the next frame, radians, positive to the *right*
    root velocity         2    m / frame, x and z
    pelvis height         1    m
    local positions      63    21 joints relative to the pelvis on the floor plane; y is the height
    rotations           126    21 joints, first two columns of the matrix (Zhou et al., 2019)
    velocities           66    22 joints, m / frame
    contacts              4    left ankle, left toe, right ankle, right toe: 1 while planted

With `heading="humanml3d"` the facing direction is that of the released code, so that published statistics and weights
fit: it counts the hips left minus right against the shoulders, and smooths the direction. `"true"` is the direction
in which the body really faces.

The rotations of this layout are solved along five joint chains from the axes in `BONE_AXES`, without twist and with
the heading in the root. No other part uses them; animation files take theirs from `kinematics`.
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
    conjugate,
    continuous_signs,
    multiply,
    normalised,
    rotate,
    shortest_rotation,
    to_matrix,
)
from kinegraph.motion.skeleton import (
    FEET,
    HORIZONTAL,
    JOINTS,
    LEFT_HIP,
    LEFT_SHOULDER,
    RIGHT_HIP,
    RIGHT_SHOULDER,
    canonicalise,
)

Heading = Literal["humanml3d", "true"]
HEADINGS: Final[tuple[Heading, ...]] = ("humanml3d", "true")

YAW_VELOCITY: Final = slice(0, 1)
ROOT_VELOCITY: Final = slice(1, 3)
HEIGHT: Final = slice(3, 4)
POSITIONS: Final = slice(4, 67)
ROTATIONS: Final = slice(67, 193)
VELOCITIES: Final = slice(193, 259)
CONTACTS: Final = slice(259, 263)
WIDTH: Final = 263

GROUPS: Final[tuple[slice, ...]] = (*(YAW_VELOCITY, ROOT_VELOCITY, HEIGHT, POSITIONS, ROTATIONS, VELOCITIES, CONTACTS),)
"""Columns whose standard deviations are averaged in the published statistics."""

CONTACT_SQUARED_STEP: Final = 0.002
"""m^2; a foot that moves less between two frames counts as planted."""

CHAINS: Final[tuple[tuple[int, ...], ...]] = (
    (0, 2, 5, 8, 11),
    (0, 1, 4, 7, 10),
    (0, 3, 6, 9, 12, 15),
    (9, 14, 17, 19, 21),
    (9, 13, 16, 18, 20),
)
"""Kinematic chains: right leg, left leg, spine, right arm, left arm."""

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
"""(22, 3) unit vectors: direction of each joint from its parent when nothing is rotated."""

_RIGHT_LEG: Final = (5, 8)
"""Ends of thigh and shank, whose lengths scale the root path."""
_SMOOTHING_SIGMA: Final = 20.0
"""Frames."""
_SMOOTHING_RADIUS: Final = 80
"""Frames at which the Gaussian is cut off."""


def humanml3d_from_joints(
    joints: FloatArray, *, heading: Heading = "humanml3d", target_offsets: FloatArray | None = None
) -> FloatArray:
    """Convert the joints of a clip to HumanML3D features, wherever it stands.

    Args:
        joints: (frames, 22, 3) metres, Y up, 20 frames per second, at least two frames.
        heading: "humanml3d" or "true", see the module.
        target_offsets: (22, 3) metres; the clip is first retargeted to this skeleton. None keeps its own.

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
        joints = retarget(joints, target_offsets, heading=heading)
    return _feature_rows(canonicalise(joints), heading)


def joints_from_humanml3d(features: FloatArray, joint_count: int = JOINTS) -> FloatArray:
    """Convert HumanML3D features to the joints of a clip that starts at the origin.

    Reads the positions; the rotations are not used. HumanML3D's code calls this `recover_from_ric`.

    Args:
        features: (frames, 263), not normalised.
        joint_count: of the body: 22, or the 21 of KIT-ML with its 251 features.

    Returns:
        (frames, joint_count, 3) float32, metres for HumanML3D.
    """
    rows = np.asarray(features, dtype=np.float64)
    half_angle = np.concatenate([[0.0], np.cumsum(rows[:-1, 0])])
    to_world = conjugate(about_axis(1, 2.0 * half_angle))
    step = np.zeros((len(rows), 3))
    step[1:, [0, 2]] = rows[:-1, ROOT_VELOCITY]
    root = np.cumsum(rotate(to_world, step), axis=0)
    joints = np.empty((len(rows), joint_count, 3))
    joints[:, 0] = root
    joints[:, 0, 1] = rows[:, HEIGHT.start]
    others = joint_count - 1
    local = rows[:, POSITIONS.start : POSITIONS.start + 3 * others].reshape(len(rows), others, 3)
    joints[:, 1:] = rotate(to_world[:, None], local) + root[:, None]
    return joints.astype(np.float32)


def facing_directions(joints: Floats, *, heading: Heading, smooth: bool) -> Floats:
    """Compute the horizontal direction that the body faces in each frame.

    Args:
        joints: (frames, 22, 3) metres.
        heading: "true" takes hips and shoulders both right minus left; "humanml3d" takes the hips left minus
            right, as the released code does.
        smooth: with "humanml3d", filter the directions with a Gaussian of 20 frames.

    Returns:
        (frames, 3) unit vectors with y = 0.
    """
    hips = joints[:, RIGHT_HIP] - joints[:, LEFT_HIP]
    shoulders = joints[:, RIGHT_SHOULDER] - joints[:, LEFT_SHOULDER]
    across = normalised(shoulders + hips if heading == "true" else shoulders - hips)
    ahead: Floats = np.stack([across[:, 2], np.zeros_like(across[:, 0]), -across[:, 0]], axis=-1)
    if smooth and heading == "humanml3d":
        ahead = _gaussian_filter(ahead)
    return normalised(ahead)


def retarget(joints: Floats, target_offsets: Floats, *, heading: Heading) -> Floats:
    """Transfer a motion to a skeleton with other bone lengths; the root path scales with the length of the leg.

    HumanML3D's code calls this `uniform_skeleton`.

    Args:
        joints: (frames, 22, 3) metres.
        target_offsets: (22, 3) metres, `BONE_AXES` times the target bone lengths.
        heading: see `facing_directions`.

    Returns:
        (frames, 22, 3) metres.

    Raises:
        InvalidInputError: offsets of another shape, or a leg without length.
    """
    target = np.asarray(target_offsets, dtype=joints.dtype)
    if target.shape != (JOINTS, 3) or not np.isfinite(target).all():
        allowed = f"finite metres, ({JOINTS}, 3)"
        raise InvalidInputError(f"target_offsets have shape {target.shape}; they must be {allowed}")
    source_leg, target_leg = _leg_length(rest_offsets(joints[0])), _leg_length(target)
    if source_leg == 0 or target_leg == 0:
        raise InvalidInputError("the right leg has no length; retargeting needs thigh and shank on both sides")
    rotations = chain_rotations(joints, heading=heading, smooth=False)
    return chain_forward_kinematics(rotations, joints[:, 0] * (target_leg / source_leg), target)


def chain_rotations(joints: Floats, *, heading: Heading, smooth: bool) -> Floats:
    """Solve the layout's rotations: inverse kinematics along `CHAINS`, each bone by its shortest rotation.

    As in the released code, the chains of the arms start from the root's rotation, not from the spine's, and the
    root of the first frame is not rotated.

    Args:
        joints: (frames, 22, 3) metres.
        heading, smooth: see `facing_directions`.

    Returns:
        (frames, 22, 4) quaternions: the root's takes the facing direction to +Z, the others are relative to the joint
        before them in their chain.
    """
    ahead = facing_directions(joints, heading=heading, smooth=smooth)
    # about Y explicitly: the shortest rotation from straight behind may be about any axis
    root = about_axis(1, -np.arctan2(ahead[:, 0], ahead[:, 2]))
    root[0] = IDENTITY
    rotations = np.zeros((len(joints), JOINTS, 4), dtype=joints.dtype)
    rotations[:, 0] = root
    for chain in CHAINS:
        parent_global = root
        for parent, child in pairwise(chain):
            axis = BONE_AXES[child].astype(joints.dtype)
            child_global = shortest_rotation(axis, normalised(joints[:, child] - joints[:, parent]))
            rotations[:, child] = multiply(conjugate(parent_global), child_global)
            parent_global = child_global
    return rotations


def chain_forward_kinematics(rotations: Floats, root: Floats, offsets: Floats) -> Floats:
    """Compute the joints of a skeleton from the rotations of `chain_rotations`.

    Args:
        rotations: (frames, 22, 4) quaternions along `CHAINS`.
        root: (frames, 3) metres.
        offsets: (22, 3) metres from the parent.

    Returns:
        (frames, 22, 3) metres.
    """
    joints = np.zeros((len(rotations), JOINTS, 3), dtype=rotations.dtype)
    joints[:, 0] = root
    for chain in CHAINS:
        child_global = rotations[:, 0]
        for parent, child in pairwise(chain):
            child_global = multiply(child_global, rotations[:, child])
            joints[:, child] = joints[:, parent] + rotate(child_global, offsets[child])
    return joints


def _feature_rows(joints: FloatArray, heading: Heading) -> FloatArray:
    """Compute the features (frames - 1, 263) of a canonical clip."""
    rotations = chain_rotations(joints, heading=heading, smooth=True)
    # the released code leaves the sign to chance: a body that turns through its back loses its heading there
    to_facing = continuous_signs(rotations[:, 0])
    step = np.diff(joints, axis=0)
    yaw_step = multiply(to_facing[1:], conjugate(to_facing[:-1]))
    root_step = rotate(to_facing[1:], step[:, 0])
    pelvis_on_floor = joints[:, :1] * HORIZONTAL.astype(np.float32)
    local = rotate(to_facing[:, None], joints - pelvis_on_floor)[:-1]
    columns = to_matrix(rotations[:-1, 1:])[..., :2]
    planted = (step[:, FEET] ** 2).sum(-1) < CONTACT_SQUARED_STEP
    count = len(step)
    rows = np.concatenate(
        [
            np.arcsin(np.clip(yaw_step[:, 2:3], -1.0, 1.0)),  # y of the quaternion: the sine of half the turn
            root_step[:, [0, 2]],
            local[:, 0, 1:2],
            local[:, 1:].reshape(count, -1),
            columns.swapaxes(-1, -2).reshape(count, -1),
            rotate(to_facing[:-1, None], step).reshape(count, -1),
            planted,
        ],
        axis=1,
    )
    return rows.astype(np.float32)


def rest_offsets(pose: Floats) -> Floats:
    """Compute the offsets (22, 3) from the parent that a pose (22, 3) has when nothing is rotated."""
    offsets = np.zeros_like(pose)
    for chain in CHAINS:
        for parent, child in pairwise(chain):
            offsets[child] = BONE_AXES[child] * np.linalg.norm(pose[child] - pose[parent])
    return offsets


def _leg_length(offsets: Floats) -> float:
    return float(np.abs(offsets[list(_RIGHT_LEG)]).max(axis=1).sum())


def _gaussian_filter(rows: Floats) -> Floats:
    """Smooth along the first axis; the first and last row are repeated beyond the ends."""
    steps = np.arange(-_SMOOTHING_RADIUS, _SMOOTHING_RADIUS + 1)
    weights = np.exp(-0.5 * (steps / _SMOOTHING_SIGMA) ** 2)
    weights /= weights.sum()
    padded = np.concatenate([rows[:1].repeat(_SMOOTHING_RADIUS, 0), rows, rows[-1:].repeat(_SMOOTHING_RADIUS, 0)])
    columns = [np.convolve(column, weights, mode="valid") for column in padded.astype(np.float64).T]
    return np.stack(columns, axis=-1).astype(rows.dtype)
