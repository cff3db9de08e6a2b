"""Where a clip stands: on the floor, starting at the origin, facing +Z."""

from __future__ import annotations

import numpy as np

from kinegraph.motion.skeleton import PELVIS, FloatArray, facing_angle


def placed(joints: FloatArray) -> FloatArray:
    """The clip moved and turned as every clip of kinegraph starts.

    The lowest joint of the whole clip is at y = 0; in the first frame the pelvis is at x = z = 0 and the body
    faces +Z (`skeleton.facing_angle`).

    Args:
        joints: (frames, 22, 3) metres, Y up.

    Returns:
        (frames, 22, 3) float32.
    """
    joints = np.asarray(joints, dtype=np.float64)
    origin = joints[0, PELVIS].copy()
    origin[1] = joints[..., 1].min()
    moved = joints - origin
    heading = float(facing_angle(moved[:1])[0])
    cos, sin = np.cos(heading), np.sin(heading)
    x, y, z = moved[..., 0], moved[..., 1], moved[..., 2]
    return np.stack([cos * x - sin * z, y, sin * x + cos * z], axis=-1).astype(np.float32)
