"""How clean a motion is, whatever it shows. joints: (frames, 22, 3) metres at 20 frames per second."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinegraph.motion.skeleton import JOINT_INDEX, bone_lengths

FPS = 20
SOLE = 0.05
"""Metres: a toe below this height stands on the floor."""

Joints = NDArray[np.float32]


def jerk(joints: Joints) -> float:
    """Mean length of the third derivative of the joints' positions, m/s^3."""
    third = np.diff(joints.astype(np.float64), n=3, axis=0) * FPS**3
    return float(np.linalg.norm(third, axis=-1).mean())


def foot_skate(joints: Joints) -> float:
    """Mean horizontal speed of the toes while they are below 5 cm, m/s; NaN if they never are."""
    toes = joints[:, [JOINT_INDEX["left_foot"], JOINT_INDEX["right_foot"]]].astype(np.float64)
    speed = np.linalg.norm(np.diff(toes[..., [0, 2]], axis=0), axis=-1) * FPS
    down = np.maximum(toes[1:, :, 1], toes[:-1, :, 1]) < SOLE
    return float(speed[down].mean()) if down.any() else float("nan")


def hand_speed(joints: Joints) -> float:
    """Mean speed of the busier wrist around the pelvis, m/s."""
    wrists = joints[:, [JOINT_INDEX["left_wrist"], JOINT_INDEX["right_wrist"]]] - joints[:, [JOINT_INDEX["pelvis"]]]
    speed = np.linalg.norm(np.diff(wrists.astype(np.float64), axis=0), axis=-1) * FPS
    return float(speed.mean(axis=0).max())


def bone_error(joints: Joints, lengths: NDArray[np.float64]) -> float:
    """Mean absolute difference of the bones to `lengths` (21,), millimetres."""
    return float(np.abs(bone_lengths(joints) - lengths).mean() * 1000)
