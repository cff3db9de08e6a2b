"""What animation programs call the joints of `skeleton`."""

from __future__ import annotations

from typing import Final

from kinegraph.motion.skeleton import JOINT_NAMES

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
"""Convention -> names in the order of `skeleton.JOINT_NAMES`."""
