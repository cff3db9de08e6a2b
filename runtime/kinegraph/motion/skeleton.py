"""The 22-joint skeleton of kinegraph: HumanML3D's order, the first 22 joints of SMPL.

Coordinate frame: right-handed, Y up, metres. In its first frame a body faces +Z, with its left side towards +X.
`canonicalise` brings a clip into that frame: on the floor, pelvis above the origin.

Sources: Loper et al. (2015), SMPL; Guo et al. (2022), HumanML3D.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from kinegraph.arrays import FloatArray, Floats

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
"""Index of each joint's parent; -1 for the root."""
JOINT_INDEX: Final[dict[str, int]] = {name: index for index, name in enumerate(JOINT_NAMES)}

PELVIS: Final = 0
LEFT_HIP, RIGHT_HIP = JOINT_INDEX["left_hip"], JOINT_INDEX["right_hip"]
LEFT_SHOULDER, RIGHT_SHOULDER = JOINT_INDEX["left_shoulder"], JOINT_INDEX["right_shoulder"]
FEET: Final[tuple[int, ...]] = tuple(
    JOINT_INDEX[name] for name in ("left_ankle", "left_foot", "right_ankle", "right_foot")
)
"""Joints of the four contact features, in HumanML3D's order: left ankle and toe, then right."""

MIRROR: Final[tuple[int, ...]] = tuple(
    JOINT_INDEX[name.replace("left", "right") if name.startswith("left") else name.replace("right", "left")]
    for name in JOINT_NAMES
)
"""Index of each joint's counterpart: `joints[:, MIRROR] * (-1, 1, 1)` swaps left and right."""

HORIZONTAL: Final = np.array([1.0, 0.0, 1.0])
"""Mask that projects a point or vector (x, y, z) onto the floor plane."""

_MIXAMO: Final = (
    "Hips", "LeftUpLeg", "RightUpLeg", "Spine", "LeftLeg", "RightLeg", "Spine1", "LeftFoot", "RightFoot", "Spine2",
    "LeftToeBase", "RightToeBase", "Neck", "LeftShoulder", "RightShoulder", "Head", "LeftArm", "RightArm",
    "LeftForeArm", "RightForeArm", "LeftHand", "RightHand",
)  # fmt: skip
DEFAULT_NAMES: Final = "smpl"
CONVENTIONS: Final[dict[str, tuple[str, ...]]] = {
    "smpl": JOINT_NAMES,
    "mixamo": tuple(f"mixamorig:{name}" for name in _MIXAMO),
}
"""Naming convention -> joint names, in the order of `JOINT_NAMES`; for files of animation programs."""
ROOT_NAME: Final = "root"
"""Name of the joint on the floor that files can have above the pelvis, in every convention: that of Unreal's."""


def facing_angle(joints: Floats) -> FloatArray:
    """Compute the heading of the body about +Y, from +Z towards +X (positive is a turn to the left).

    The facing direction is `cross(Y, across)` with `across = (right hip - left hip) +
    (right shoulder - left shoulder)`: HumanML3D's convention, with both pairs taken right minus left.

    Args:
        joints: (frames, 22, 3) metres, Y up.

    Returns:
        (frames,) radians, unwrapped.
    """
    across = (joints[:, RIGHT_HIP] - joints[:, LEFT_HIP]) + (joints[:, RIGHT_SHOULDER] - joints[:, LEFT_SHOULDER])
    return heading_across(across)


def heading_across(across: Floats) -> FloatArray:
    """Compute headings (frames,) from a line through the body (frames, 3), right minus left; see `facing_angle`."""
    # cross((0, 1, 0), a) = (a_z, 0, -a_x)
    heading: FloatArray = np.unwrap(np.arctan2(across[:, 2], -across[:, 0])).astype(np.float32)
    return heading


def canonicalise(joints: FloatArray) -> FloatArray:
    """Move and turn a clip to the canonical start: on the floor, at the origin, facing +Z.

    Afterwards the lowest joint of the whole clip is at y = 0. In the first frame the pelvis is at x = z = 0 and
    the body faces +Z (`facing_angle`).

    Args:
        joints: (frames, 22, 3) metres, Y up.

    Returns:
        (frames, 22, 3) float32 metres.
    """
    joints = np.asarray(joints, dtype=np.float64)
    return start_at_origin(joints - np.array([0.0, joints[..., 1].min(), 0.0]))


def start_at_origin(joints: Floats) -> FloatArray:
    """Move and turn a clip over the floor so that it starts at x = z = 0 and faces +Z; heights stay.

    Args:
        joints: (frames, 22, 3) metres, Y up.

    Returns:
        (frames, 22, 3) float32 metres.
    """
    moved = joints - joints[0, PELVIS] * HORIZONTAL.astype(joints.dtype)
    # rotation by -heading about Y
    heading = float(facing_angle(moved[:1])[0])
    cos, sin = np.cos(heading), np.sin(heading)
    x, y, z = moved[..., 0], moved[..., 1], moved[..., 2]
    return np.stack([cos * x - sin * z, y, sin * x + cos * z], axis=-1).astype(np.float32)


def mirrored(joints: FloatArray) -> FloatArray:
    """Swap left and right of a motion.

    Args:
        joints: (frames, 22, 3) metres.

    Returns:
        (frames, 22, 3), reflected in the plane x = 0.
    """
    return joints[:, list(MIRROR)] * np.array([-1.0, 1.0, 1.0], dtype=np.float32)


def bone_lengths(joints: FloatArray) -> FloatArray:
    """Measure the distance from every joint but the pelvis to its parent.

    Args:
        joints: (frames, 22, 3) metres.

    Returns:
        (frames, 21) metres; bone k belongs to joint k + 1.
    """
    children = np.arange(1, JOINTS)
    lengths: FloatArray = np.linalg.norm(joints[:, children] - joints[:, list(PARENTS[1:])], axis=-1)
    return lengths
