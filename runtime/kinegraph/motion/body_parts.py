"""Put a motion together from parts of several: legs of one, trunk and arms of those that do most with them.

As game engines layer animations under masks of the body, and as training splices captured clips. Of motions made from
texts SINC (Athanasiou et al., 2023) does so, and asks a language model for the parts that are measured here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.motion.postprocess import enforce_bone_lengths
from kinegraph.motion.skeleton import JOINT_INDEX, PELVIS, bone_lengths, heading_across

LEGS: Final = "legs"
TRUNK: Final = "trunk"
ARMS: Final[Mapping[str, tuple[int, ...]]] = {
    f"{side} arm": tuple(JOINT_INDEX[f"{side}_{name}"] for name in ("collar", "shoulder", "elbow", "wrist"))
    for side in ("left", "right")
}
UPPER_BODY: Final = tuple(JOINT_INDEX[name] for name in ("spine1", "spine2", "spine3", "neck", "head")) + sum(
    ARMS.values(), ()
)
CHEST: Final = JOINT_INDEX["spine3"]
HANGING: Final = np.array([0.0, -0.5, 0.0])
"""Metres from shoulder to wrist of an arm that hangs."""
ARM_CLEARLY: Final = 1.2
TRUNK_CLEARLY: Final = 3.0
"""How many times as much another motion does with a part that takes it from the motion below it."""


def chest_heading(joints: FloatArray) -> FloatArray:
    """Compute the heading (t,) of the chest about +Y from the line between the collars, whatever the arms do."""
    return _heading(joints, "collar")


def _heading(joints: FloatArray, ends: str) -> FloatArray:
    return heading_across(joints[:, JOINT_INDEX[f"right_{ends}"]] - joints[:, JOINT_INDEX[f"left_{ends}"]])


def rotate_about_y(vectors: FloatArray, angle: FloatArray) -> FloatArray:
    """Rotate vectors (t, n, 3) by +angle (t,) about Y."""
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, z = vectors[..., 0], vectors[..., 2]
    return np.stack([cos * x + sin * z, vectors[..., 1], cos * z - sin * x], axis=-1)


def move_arm(source: FloatArray, target: FloatArray, arm: str) -> FloatArray:
    """Copy an arm from one motion to another, relative to the chest, which it turns with.

    Args:
        source: (t, 22, 3) metres, of the arm.
        target: (t, 22, 3) metres, of the rest.
        arm: of `ARMS`.
    """
    return _copy_onto(source, target, ARMS[arm], CHEST, "collar")


def move_upper_body(source: FloatArray, target: FloatArray) -> FloatArray:
    """Copy trunk, head and arms from one motion to another, relative to the hips; see `move_arm`."""
    return _copy_onto(source, target, UPPER_BODY, PELVIS, "hip")


def _copy_onto(source: FloatArray, target: FloatArray, members: Sequence[int], anchor: int, ends: str) -> FloatArray:
    """Copy joints relative to one joint, and to the line between the left and the right one of a kind."""
    joints, anchored = list(members), slice(anchor, anchor + 1)
    relative = rotate_about_y(source[:, joints] - source[:, anchored], -_heading(source, ends))
    copied = target.copy()
    copied[:, joints] = rotate_about_y(relative, _heading(target, ends)) + target[:, anchored]
    return copied


def activity(joints: FloatArray, part: str) -> float:
    """Measure how much a motion (t, 22, 3) does with a part of the body.

    Returns:
        Of an arm, how far the wrist is from where it hangs, root mean square; of the trunk, how much its lean changes,
        as the standard deviation of the distance over the floor of chest and pelvis; both in metres. Of the legs, the
        mean speed of ankles and pelvis, metres a frame.
    """
    if part == LEGS:
        moving = joints[:, [PELVIS, JOINT_INDEX["left_ankle"], JOINT_INDEX["right_ankle"]]]
        return float(np.linalg.norm(np.diff(moving, axis=0), axis=-1).mean())
    if part == TRUNK:
        return float(np.linalg.norm((joints[:, CHEST] - joints[:, PELVIS])[:, [0, 2]], axis=-1).std())
    _, shoulder, _, wrist = ARMS[part]
    offset = joints[:, wrist] - joints[:, shoulder] - HANGING
    return float(np.sqrt((offset**2).sum(axis=-1).mean()))


def choose_parts(motions: Sequence[FloatArray]) -> dict[str, int]:
    """Choose for each part of the body the motion that does most with it.

    The trunk stays with the legs, and the arms with the trunk, unless another motion does clearly more with them.

    Args:
        motions: (t, 22, 3) metres of each.

    Returns:
        Index of a motion for `LEGS`, `TRUNK` and each of `ARMS`.
    """

    def most(part: str, below: int, clearly: float) -> int:
        done = [activity(joints, part) for joints in motions]
        best = int(np.argmax(done))
        return best if done[best] > clearly * done[below] else below

    legs = int(np.argmax([activity(joints, LEGS) for joints in motions]))
    trunk = most(TRUNK, legs, TRUNK_CLEARLY)
    return {LEGS: legs, TRUNK: trunk, **{arm: most(arm, trunk, ARM_CLEARLY) for arm in ARMS}}


def join_parts(motions: Sequence[FloatArray], chosen: Mapping[str, int]) -> FloatArray:
    """Put a motion together as `choose_parts` says: (t, 22, 3), with the bones of the motion of the legs.

    Args:
        motions: (t, 22, 3) metres of each, of equal length.
        chosen: index of a motion for each part of the body.
    """
    legs = motions[chosen[LEGS]]
    joined = legs if chosen[TRUNK] == chosen[LEGS] else move_upper_body(motions[chosen[TRUNK]], legs)
    for arm in ARMS:
        if chosen[arm] != chosen[TRUNK]:
            joined = move_arm(motions[chosen[arm]], joined, arm)
    return enforce_bone_lengths(joined, bone_lengths(legs).mean(axis=0))
