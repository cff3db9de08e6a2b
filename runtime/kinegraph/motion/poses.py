"""Poses as they compare wherever the body is and whichever way it faces: to find where motions can be joined."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.motion.quaternions import about_axis, rotate
from kinegraph.motion.skeleton import FloatArray, facing_angle

Floats = NDArray[np.floating[Any]]

OVER_FLOOR: Final = np.array([1.0, 0.0, 1.0])
"""What travel has of a place (x, y, z)."""
VELOCITY_SECONDS: Final = 0.2
"""A difference in speed counts as the distance it makes in that time."""


def local_poses(joints: FloatArray) -> Floats:
    """(frames, 22, 3) with the pelvis above the origin and the body facing +Z."""
    centred = joints - joints[:, :1] * OVER_FLOOR
    back = about_axis(1, -facing_angle(joints).astype(np.float64))
    return rotate(back[:, None], centred)


def states(joints: FloatArray, fps: float) -> Floats:
    """(frames, 45, 3): poses in the facing frame, their speed, and the speed over the floor, all as metres."""
    poses = local_poses(joints)
    speed = np.gradient(poses, axis=0) * fps * VELOCITY_SECONDS
    over_floor = np.gradient(joints[:, :1].astype(np.float64), axis=0) * fps * VELOCITY_SECONDS
    back = about_axis(1, -facing_angle(joints).astype(np.float64))
    return np.concatenate([poses, speed, rotate(back[:, None], over_floor)], axis=1)


def smoothstep(part: Floats) -> Floats:
    """0 to 1 -> 0 to 1, level at both ends: what the second of two motions counts, `part` of the way to it."""
    return np.asarray(part * part * (3 - 2 * part))


def accelerations(joints: Floats, fps: float) -> Floats:
    """(frames - 2,) m/s^2 of the joint that is accelerated most; number k is about frame k + 1."""
    second = np.diff(np.asarray(joints, dtype=np.float64), n=2, axis=0)
    return np.asarray(np.linalg.norm(second, axis=-1).max(axis=1) * fps**2)
