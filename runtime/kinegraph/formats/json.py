"""`.json`: the clip as text that any language can read.

Holds what `.npz` holds, and the solved skeleton:

    joints          (frames, 22, 3) metres, Y up
    parents         (22,) indices, -1 for the root
    rest_offsets    (22, 3) metres from the parent in a T-pose
    rotations       (frames, 22, 4) quaternions w, x, y, z relative to the parent; the root is at joint 0
    seed            a string, because JavaScript's integers end at 2**53
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.motion.kinematics import rotations_from_positions
from kinegraph.motion.skeleton import JOINT_NAMES, PARENTS

if TYPE_CHECKING:
    from kinegraph.clip import Clip

DIGITS: Final = 5
"""Decimal places: a hundredth of a millimetre, a thousandth of a degree."""


def encode(clip: Clip) -> bytes:
    """Encode a clip as JSON in UTF-8; equal clips give equal bytes."""
    motion = rotations_from_positions(clip.joints, clip.fps, loops=clip.loops)
    document = {
        "text": clip.text,
        "seed": str(clip.seed),
        "bundle": clip.bundle,
        "fps": clip.fps,
        "joint_names": JOINT_NAMES,
        "parents": PARENTS,
        "rest_offsets": _rounded(motion.rest_offsets),
        "joints": _rounded(clip.joints),
        "rotations": _rounded(motion.rotations),
    }
    return json.dumps(document, ensure_ascii=False, separators=(",", ":")).encode()


def _rounded(values: NDArray[Any]) -> Any:
    """Convert an array to nested lists of rounded numbers."""
    # adding 0.0 turns -0.0 into 0.0
    return (np.round(values.astype(np.float64), DIGITS) + 0.0).tolist()
