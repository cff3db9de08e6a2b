"""Joints of features whose positions and velocities were predicted apart, as in skeleton space.

A network's error in a velocity is a few millimetres a frame, in a position a few centimetres, since each is a share of
how much they vary. Read off the positions alone a body trembles; read off the velocities alone it drifts. The motion p
that both say is that of least squares:

    min_p  sum_t c_t |p_t - p'_t|^2 + lambda sum_t |p_t+1 - p_t - v'_t|^2

with the predicted positions p', velocities v' in metres per frame, certainties c_t, and lambda how much more a velocity
is to be trusted. Its normal equations are tridiagonal.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from kinegraph.arrays import DoubleArray, FloatArray, Floats
from kinegraph.motion.features import HEIGHT, POSITIONS, VELOCITIES, joints_from_features
from kinegraph.motion.known_features import KnownFeatures
from kinegraph.motion.skeleton import JOINTS

VELOCITY_TRUST: Final = 4.0
"""lambda. Third derivatives of skeleton-space walks: 59 m/s^3 at 0, 30 at 1, 27 at 4 and at 16; of waves 45, 20, 16 and
16. Waves stay as wide."""
HELD: Final = 1e6
"""Certainty of a position that is known and not predicted: it moves by less than a thousandth of a millimetre."""


def fused_joints(features: Floats, certainty: Floats | None = None) -> FloatArray:
    """Convert features to the joints (frames, 22, 3) in metres that fit both their positions and their velocities.

    Where the two agree, as in features of a captured clip, this is `features.joints_from_features`.

    Args:
        features: (frames, 137), not normalised, see `motion.features`.
        certainty: (frames, 22) c of every joint; None is 1.
    """
    joints = joints_from_features(features)
    if certainty is None:
        certainty = np.ones(joints.shape[:2])
    return fit_steps(joints, _world_steps(features), certainty, VELOCITY_TRUST).astype(np.float32)


def certainty_of(known: KnownFeatures) -> DoubleArray:
    """Compute the certainty (frames, 22) of joints: HELD where a pose is known, else 1.

    The pelvis is known where its height is, for a pose has it, and `known_features.lead_root` leads it to its place.
    """
    positions = known.known[:, POSITIONS].reshape(len(known.known), JOINTS - 1, 3).all(axis=2)
    return np.where(np.concatenate([known.known[:, HEIGHT], positions], axis=1), HELD, 1.0)


def fit_steps(positions: Floats, steps: Floats, certainty: Floats, trust: float) -> DoubleArray:
    """Solve the least squares of this module by forward elimination and back substitution.

    Args:
        positions: p', (frames, n, 3).
        steps: v', (frames - 1, n, 3), from each frame to the next.
        certainty: c, (frames, n), above 0.
        trust: lambda, at least 0.

    Returns:
        p, (frames, n, 3).
    """
    frames = len(positions)
    weight = np.asarray(certainty, dtype=np.float64)[..., None]
    right = weight * positions
    right[1:] += trust * np.asarray(steps)
    right[:-1] -= trust * np.asarray(steps)
    neighbours = np.full((frames, 1, 1), 2.0)
    neighbours[0] -= 1.0
    neighbours[-1] -= 1.0
    diagonal = weight + trust * neighbours
    for t in range(1, frames):
        share = trust / diagonal[t - 1]
        diagonal[t] -= trust * share
        right[t] += share * right[t - 1]
    found = np.empty_like(right)
    found[-1] = right[-1] / diagonal[-1]
    for t in range(frames - 2, -1, -1):
        found[t] = (right[t] + trust * found[t + 1]) / diagonal[t]
    return found


def _world_steps(features: Floats) -> DoubleArray:
    """Turn the velocities of features (frames, 137) into the world: (frames - 1, 22, 3) metres per frame."""
    features = np.asarray(features, dtype=np.float64)
    angle = np.concatenate([[0.0], np.cumsum(features[:-2, 0])])[:, None]
    x, y, z = np.moveaxis(features[:-1, VELOCITIES].reshape(-1, JOINTS, 3), -1, 0)
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([cos * x + sin * z, y, cos * z - sin * x], axis=-1)
