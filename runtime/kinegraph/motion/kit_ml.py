"""Feature layout `kit-251` of KIT-ML (Guo et al., 2022): 21 joints in units of their own, brought to our 22 in metres.

The columns are those of `humanml3d-263` for 20 joints instead of 21 beside the pelvis. Joints that KIT-ML lacks are put
between their neighbours.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.errors import InvalidInputError
from kinegraph.motion.humanml3d import joints_from_humanml3d
from kinegraph.motion.skeleton import JOINT_INDEX

KIT_JOINTS: Final = 21
WIDTH: Final = 251
FPS: Final = 12.5
LEG_METRES: Final = 0.821
"""Thigh and shank of the common body of the training data, which KIT-ML's leg is scaled to."""
SOURCES: Final = {
    "pelvis": (0,), "spine1": (1,), "spine2": (2,), "spine3": (2, 3), "neck": (3,), "head": (4,),
    "left_hip": (16,), "left_knee": (17,), "left_ankle": (18,), "left_foot": (20,),
    "right_hip": (11,), "right_knee": (12,), "right_ankle": (13,), "right_foot": (15,),
    "left_collar": (3, 8), "left_shoulder": (8,), "left_elbow": (9,), "left_wrist": (10,),
    "right_collar": (3, 5), "right_shoulder": (5,), "right_elbow": (6,), "right_wrist": (7,),
}  # fmt: skip
"""Our joint -> joints of KIT-ML whose middle it is."""


def joints_from_kit(features: FloatArray) -> FloatArray:
    """Convert features (frames, 251), not normalised, to joints (frames, 22, 3) in metres at 12.5 per second."""
    return from_kit_joints(joints_from_humanml3d(features, KIT_JOINTS))


def from_kit_joints(joints: FloatArray) -> FloatArray:
    """Map joints of KIT-ML (frames, 21, 3) to ours (frames, 22, 3) in metres, at the same frame rate.

    Raises:
        InvalidInputError: the right leg has no length, which tells the unit.
    """
    ours = np.stack([joints[:, SOURCES[name]].mean(axis=1) for name in JOINT_INDEX], axis=1)
    hip, knee, ankle = (ours[:, JOINT_INDEX[f"right_{part}"]] for part in ("hip", "knee", "ankle"))
    leg = float((np.linalg.norm(knee - hip, axis=-1) + np.linalg.norm(ankle - knee, axis=-1)).mean())
    if not leg > 0:
        raise InvalidInputError("the right leg has no length")
    return np.asarray(ours * (LEG_METRES / leg), dtype=np.float32)
