"""Feature layout `joints-137`: conversion between joints and the features that models see.

One row per frame, in the facing frame of that frame's body (`skeleton.facing_angle`, not smoothed):

    yaw velocity          1    rad / frame, positive to the left
    root velocity         2    m / frame, x (left) and z (forward)
    pelvis height         1    m
    local positions      63    21 joints relative to the pelvis on the floor plane; y is the height above the floor
    velocities           66    22 joints, m / frame
    contacts              4    left ankle, left toe, right ankle, right toe: 1 while planted

This is HumanML3D's layout (Guo et al., 2022) without its 126 rotations, which no animation file can use, and with
the true facing direction. T frames give T rows; the last row repeats the velocities of the row before it.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from kinegraph.arrays import DoubleArray, FloatArray, Floats
from kinegraph.motion.skeleton import FEET, HORIZONTAL, JOINTS, facing_angle

LAYOUT: Final = "joints-137"
YAW_VELOCITY: Final = slice(0, 1)
ROOT_VELOCITY: Final = slice(1, 3)
HEIGHT: Final = slice(3, 4)
POSITIONS: Final = slice(4, 67)
VELOCITIES: Final = slice(67, 133)
CONTACTS: Final = slice(133, 137)
WIDTH: Final = 137

GROUPS: Final[tuple[slice, ...]] = (YAW_VELOCITY, ROOT_VELOCITY, HEIGHT, POSITIONS, VELOCITIES, CONTACTS)
"""Columns that share one standard deviation: some single features are nearly constant."""

CONTACT_SPEED: Final = 0.018
"""Metres per frame at 20 frames per second (0.36 m/s); slower feet count as planted.

HumanML3D's 0.9 m/s would call 81 % of all frames planted.
"""

CONTACT_HEIGHT: Final[tuple[float, ...]] = (0.16, 0.08, 0.16, 0.08)
"""Metres, in the order of `skeleton.FEET`; a foot above is in the air however slow it is."""


def features_from_joints(joints: FloatArray) -> FloatArray:
    """Convert the joints of a clip that stands on the floor y = 0 to features.

    Args:
        joints: (frames, 22, 3) metres, Y up, at least two frames.

    Returns:
        (frames, 137) float32.
    """
    joints = np.asarray(joints, dtype=np.float32)
    angle = facing_angle(joints)
    step = np.diff(joints, axis=0)
    step = np.concatenate([step, step[-1:]])
    yaw_velocity = np.diff(angle)
    yaw_velocity = np.concatenate([yaw_velocity, yaw_velocity[-1:]])
    pelvis_on_floor = joints[:, :1] * HORIZONTAL.astype(np.float32)
    positions = _to_facing_frame(joints[:, 1:] - pelvis_on_floor, angle)
    # the repeated last step is rotated by the last heading, so that the last row fits its own frame
    velocities = _to_facing_frame(step, angle)
    planted = (np.linalg.norm(step[:, FEET], axis=-1) < CONTACT_SPEED) & (joints[:, FEET, 1] < CONTACT_HEIGHT)
    rows = np.concatenate(
        [
            yaw_velocity[:, None],
            velocities[:, 0, [0, 2]],
            joints[:, 0, 1:2],
            positions.reshape(len(joints), -1),
            velocities.reshape(len(joints), -1),
            planted.astype(np.float32),
        ],
        axis=1,
    )
    return rows.astype(np.float32)


def joints_from_features(features: Floats, *, heading: float = 0.0) -> FloatArray:
    """Convert features to the joints of a clip that starts at the origin.

    Integrates yaw and root velocity over time; local positions are rotated back by the heading.

    Args:
        features: (frames, 137), not normalised.
        heading: facing angle of the first frame, radians; 0 faces +Z. Features do not store it.

    Returns:
        (frames, 22, 3) float32 metres.
    """
    features = np.asarray(features, dtype=np.float64)
    frames = len(features)
    angle = heading + np.concatenate([[0.0], np.cumsum(features[:-1, 0])])
    cos, sin = np.cos(angle), np.sin(angle)
    # root velocity from the facing frame to the world: rotation by +angle about Y
    left, forward = features[:, 1], features[:, 2]
    step = np.stack([cos * left + sin * forward, -sin * left + cos * forward], axis=-1)
    root = np.concatenate([np.zeros((1, 2)), np.cumsum(step[:-1], axis=0)])
    local = features[:, POSITIONS].reshape(frames, JOINTS - 1, 3)
    joints = np.empty((frames, JOINTS, 3))
    joints[:, 0] = np.stack([root[:, 0], features[:, 3], root[:, 1]], axis=-1)
    joints[:, 1:, 0] = cos[:, None] * local[..., 0] + sin[:, None] * local[..., 2] + root[:, :1]
    joints[:, 1:, 1] = local[..., 1]
    joints[:, 1:, 2] = -sin[:, None] * local[..., 0] + cos[:, None] * local[..., 2] + root[:, 1:]
    return joints.astype(np.float32)


def joints_vjp(features: Floats, cotangent: Floats) -> DoubleArray:
    """Carry a gradient back through `joints_from_features` with heading 0: dE/djoints -> dE/dfeatures.

    With w = R(angle) local, the part of a joint that turns with the body: d(w_x, w_z) / d(angle) = (w_z, -w_x), and the
    same for steps of the root. Sums over time become sums over the frames after. Velocities and contacts get 0, for
    joints do not depend on them.

    Args:
        features: (frames, 137), not normalised.
        cotangent: (frames, 22, 3), dE/djoints.

    Returns:
        (frames, 137), dE/dfeatures.
    """
    features = np.asarray(features, dtype=np.float64)
    frames = len(features)
    angle = np.concatenate([[0.0], np.cumsum(features[:-1, 0])])
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    local = features[:, POSITIONS].reshape(frames, JOINTS - 1, 3)
    turned = np.concatenate([features[:, None, 1:3], local[..., [0, 2]]], axis=1)  # root velocity, then joints
    turned_x, turned_z = cos * turned[..., 0] + sin * turned[..., 1], cos * turned[..., 1] - sin * turned[..., 0]
    # the step of a frame moves the root of all frames after it
    of_root = _sum_after(cotangent[..., [0, 2]].sum(axis=1))
    along_x = np.concatenate([of_root[:, :1], cotangent[:, 1:, 0]], axis=1)
    along_z = np.concatenate([of_root[:, 1:], cotangent[:, 1:, 2]], axis=1)
    left, forward = cos * along_x - sin * along_z, sin * along_x + cos * along_z
    of_angle = (along_x * turned_z - along_z * turned_x).sum(axis=1)
    gradient = np.zeros((frames, WIDTH))
    gradient[:, 0] = _sum_after(of_angle)
    gradient[:, 1], gradient[:, 2] = left[:, 0], forward[:, 0]
    gradient[:, 3] = cotangent[:, 0, 1]
    positions = np.stack([left[:, 1:], cotangent[:, 1:, 1], forward[:, 1:]], axis=-1)
    gradient[:, POSITIONS] = positions.reshape(frames, -1)
    return gradient


def _sum_after(values: Floats) -> Floats:
    """Sum the frames after each frame: the transpose of a sum over the frames before."""
    later = np.zeros_like(values)
    later[:-1] = np.cumsum(values[:0:-1], axis=0)[::-1]
    return later


def normalisation(clips: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Compute the statistics that normalise features: mean per feature, standard deviation per group.

    A group that never changes (feet that never lift) gets a deviation of 1, so that its normalised features are 0
    and not NaN.

    Args:
        clips: (frames, 137) each.

    Returns:
        Mean and standard deviation, both (137,) float32.
    """
    rows = np.concatenate(clips).astype(np.float64)
    mean = rows.mean(axis=0)
    variance = rows.var(axis=0)
    std = np.empty(WIDTH)
    for group in GROUPS:
        deviation = np.sqrt(variance[group].mean())
        std[group] = deviation if deviation > 1e-6 else 1.0
    return mean.astype(np.float32), std.astype(np.float32)


def _to_facing_frame(vectors: FloatArray, angle: FloatArray) -> FloatArray:
    """Rotate world vectors (frames, n, 3) by -`angle` (frames,) about Y, into each frame's facing frame."""
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return np.stack([cos * x - sin * z, y, sin * x + cos * z], axis=-1)
