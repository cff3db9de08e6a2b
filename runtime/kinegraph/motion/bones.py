"""Bones that keep their length: a decoder places every joint by itself, and is off by a millimetre or two."""

from __future__ import annotations

from typing import Final

import numpy as np

from kinegraph.motion.skeleton import JOINT_INDEX, JOINTS, PARENTS, FloatArray, bone_lengths

ITERATIONS: Final = 5
_FEET_YIELD: Final = 0.1
"""How much a toe gives way where any other joint gives way by 1: feet that stand must not be pushed about."""
_SHORTEST: Final = 1e-6

_PARENT: Final = np.array(PARENTS[1:])
_CHILD: Final = np.arange(1, JOINTS)


def _shares() -> FloatArray:
    """(22, 21): the part of a bone's correction that each joint takes, averaged over the bones that meet in it."""
    give = np.ones(JOINTS)
    give[[JOINT_INDEX["left_foot"], JOINT_INDEX["right_foot"]]] = _FEET_YIELD
    give[[JOINT_INDEX["left_ankle"], JOINT_INDEX["right_ankle"]]] = _FEET_YIELD**0.5
    shares, bones = np.zeros((JOINTS, JOINTS - 1)), np.arange(JOINTS - 1)
    total = give[_PARENT] + give[_CHILD]
    shares[_PARENT, bones] = give[_PARENT] / total
    shares[_CHILD, bones] = -give[_CHILD] / total
    meeting = (shares != 0).sum(axis=1, keepdims=True)
    averaged: FloatArray = (shares / np.maximum(1.0, 0.7 * meeting)).astype(np.float32)
    return averaged


_SHARES: Final = _shares()


def with_bone_lengths(joints: FloatArray, lengths: FloatArray | None) -> FloatArray:
    """The nearby motion whose bones have exactly these lengths.

    Position-based dynamics (Müller et al. 2007): a few rounds in which both ends of a wrong bone give way, feet least,
    then one pass from the pelvis outwards that leaves no error. The pass alone would add up all errors of a leg at
    the toe, and feet that stand would slide.

    Args:
        joints: (frames, 22, 3) metres.
        lengths: (21,) metres, of the bone from each joint but the pelvis to its parent; None takes each bone's
            median over the frames.

    Returns:
        (frames, 22, 3).
    """
    found = joints.astype(np.float32)
    usual = np.median(bone_lengths(found), axis=0) if lengths is None else lengths
    wanted = usual.astype(np.float32)[:, None]
    for _ in range(ITERATIONS):
        bones = found[:, _CHILD] - found[:, _PARENT]
        length = np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), _SHORTEST)
        found += _SHARES @ (bones * (1.0 - wanted / length))
    bones = found[:, _CHILD] - found[:, _PARENT]
    bones *= wanted / np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), _SHORTEST)
    for child, parent in zip(_CHILD, _PARENT, strict=True):
        found[:, child] = found[:, parent] + bones[:, child - 1]
    return found
