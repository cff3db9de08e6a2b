"""The 22-joint body that every part of kinegraph speaks: HumanML3D's order, the first 22 SMPL joints.

Axes are right-handed, Y up, metres; a body faces +Z in its first frame and its left side is +X.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float32]

JOINT_NAMES: Final[tuple[str, ...]] = (
    "pelvis",
    "left_hip",
    "right_hip",
    "spine1",
    "left_knee",
    "right_knee",
    "spine2",
    "left_ankle",
    "right_ankle",
    "spine3",
    "left_foot",
    "right_foot",
    "neck",
    "left_collar",
    "right_collar",
    "head",
    "left_shoulder",
    "right_shoulder",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
)
JOINTS: Final = len(JOINT_NAMES)
PARENTS: Final[tuple[int, ...]] = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)
JOINT_INDEX: Final[dict[str, int]] = {name: index for index, name in enumerate(JOINT_NAMES)}

PELVIS: Final = 0
LEFT_HIP, RIGHT_HIP = JOINT_INDEX["left_hip"], JOINT_INDEX["right_hip"]
LEFT_SHOULDER, RIGHT_SHOULDER = JOINT_INDEX["left_shoulder"], JOINT_INDEX["right_shoulder"]
FEET: Final[tuple[int, ...]] = tuple(
    JOINT_INDEX[name] for name in ("left_ankle", "left_foot", "right_ankle", "right_foot")
)
"""Order of the four contact features (HumanML3D: left ankle and toe, then right)."""

MIRROR: Final[tuple[int, ...]] = tuple(
    JOINT_INDEX[name.replace("left", "right") if name.startswith("left") else name.replace("right", "left")]
    for name in JOINT_NAMES
)
"""`joints[:, MIRROR] * (-1, 1, 1)` is the same motion seen in a mirror."""


def facing_angle(joints: FloatArray) -> FloatArray:
    """Heading of the body about +Y, radians, from +Z towards +X (positive is a turn to the left).

    The facing direction is `cross(Y, across)` with `across = (right hip - left hip) +
    (right shoulder - left shoulder)`, HumanML3D's convention with both pairs right minus left.

    Args:
        joints: (frames, 22, 3) metres.

    Returns:
        (frames,) unwrapped angles.
    """
    across = (joints[:, RIGHT_HIP] - joints[:, LEFT_HIP]) + (joints[:, RIGHT_SHOULDER] - joints[:, LEFT_SHOULDER])
    # cross((0,1,0), a) = (a_z, 0, -a_x)
    return np.unwrap(np.arctan2(across[:, 2], -across[:, 0])).astype(np.float32)


def mirrored(joints: FloatArray) -> FloatArray:
    """The motion with left and right exchanged. joints: (frames, 22, 3); returns the same shape."""
    return joints[:, list(MIRROR)] * np.array([-1.0, 1.0, 1.0], dtype=np.float32)


def bone_lengths(joints: FloatArray) -> FloatArray:
    """Distance of every joint but the pelvis to its parent, in each frame: (frames, 21), metres."""
    children = np.arange(1, JOINTS)
    lengths: FloatArray = np.linalg.norm(joints[:, children] - joints[:, list(PARENTS[1:])], axis=-1)
    return lengths
