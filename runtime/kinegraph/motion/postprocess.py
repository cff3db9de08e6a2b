"""Feet that stand stay where they stand: contacts read off the joints, ankles pinned by two-bone inverse kinematics.

Bones that keep their length: a decoder places every joint by itself, and is off by a millimetre or two."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import FloatArray, Floats
from kinegraph.motion.quaternions import normalised
from kinegraph.motion.skeleton import JOINT_INDEX, JOINTS, PARENTS, bone_lengths

SIDES: Final[tuple[tuple[int, int, int, int], ...]] = tuple(
    (JOINT_INDEX[f"{side}_hip"], JOINT_INDEX[f"{side}_knee"], JOINT_INDEX[f"{side}_ankle"], JOINT_INDEX[f"{side}_foot"])
    for side in ("left", "right")
)
"""Hip, knee, ankle and toe of both legs."""

STANDS: Final = 0.5
"""m/s over the floor: a toe that is slower and low stands, or is meant to."""
LOW: Final = 0.07
"""Metres above the toe's lowest tenth."""
SHORTEST_STAND: Final = 0.15
"""Seconds; a shorter contact is a swinging foot that happens to be slow."""
RAMP: Final = 0.2
"""Seconds in which a correction comes and goes beside a contact."""
PER_JERK: Final = 6e-5
"""Metres of correction beside a contact that count as much as a jerk of 1 m/s^3."""
_OVER_FLOOR: Final = np.array([1.0, 0.0, 1.0])
FURTHEST: Final = 0.08
"""Metres: a foot that is further from where it would stand is meant to move."""
STRETCHED: Final = 0.98
"""Of the length of a leg: the nearer to straight, the further the knee moves for a centimetre of the foot; no leg is
stretched beyond this that was not."""


def lock_feet(joints: FloatArray, fps: float) -> FloatArray:
    """The nearby motion whose standing toes do not slide.

    While a foot stands, its toe is held where it was on average; beside a contact it takes the path of least jerk. The
    whole foot moves with its toe, the knee bends in its own plane, and all bones keep their length.

    Args:
        joints: (frames, 22, 3) metres, Y up.
        fps: frames per second.

    Returns:
        (frames, 22, 3).
    """
    found = joints.astype(np.float64)
    for hip, knee, ankle, toe in SIDES:
        shift = _shifts(found[:, toe], fps)
        if not shift.any():
            continue
        new_knee, new_ankle = two_bones(found[:, hip], found[:, knee], found[:, ankle], found[:, ankle] + shift)
        found[:, toe] += new_ankle - found[:, ankle]
        found[:, knee], found[:, ankle] = new_knee, new_ankle
    return found.astype(np.float32)


def contacts(toe: Floats, fps: float) -> list[tuple[int, int]]:
    """First and last frame + 1 of every time a toe (frames, 3) stands."""
    if len(toe) < 3:
        return []
    speed = np.linalg.norm(np.gradient(toe[:, [0, 2]], axis=0), axis=-1) * fps
    down = (speed < STANDS) & (toe[:, 1] < np.quantile(toe[:, 1], 0.1) + LOW)
    return [(start, end) for start, end in _runs(down) if end - start >= SHORTEST_STAND * fps]


def two_bones(hip: Floats, knee: Floats, ankle: Floats, goal: Floats) -> tuple[Floats, Floats]:
    """Knee and ankle (frames, 3) of a leg that reaches for `goal`, bending in the plane in which it is bent.

    The law of cosines; a goal out of reach is approached as far as the leg goes.
    """
    upper, lower = np.linalg.norm(knee - hip, axis=-1), np.linalg.norm(ankle - knee, axis=-1)
    way = goal - hip
    nearest, furthest = np.abs(upper - lower) + 1e-3, (upper + lower) * STRETCHED
    # a leg that was stretched further may stay so
    furthest = np.maximum(furthest, np.minimum(np.linalg.norm(ankle - hip, axis=-1), upper + lower))
    distance = np.clip(np.linalg.norm(way, axis=-1), nearest, furthest)
    along = normalised(way)
    bend = (knee - hip) - ((knee - hip) * along).sum(-1, keepdims=True) * along
    reach = (upper**2 - lower**2 + distance**2) / (2 * distance)
    height = np.sqrt(np.maximum(upper**2 - reach**2, 0.0))
    new_knee = hip + reach[:, None] * along + height[:, None] * normalised(bend)
    return new_knee, hip + distance[:, None] * along


def _shifts(toe: Floats, fps: float) -> Floats:
    """(frames, 3) over the floor: what holds a toe in its contacts, and leads it there and away beside them.

    Beside a contact the correction s minimises sum |D^3 (toe + s)|^2 + (s / `PER_JERK`)^2, with D^3 the third
    derivative: the path of least jerk (Flash & Hogan, 1985, Eq. 1), kept near to the one that was there.
    """
    runs = contacts(toe, fps)
    shift, free = np.zeros_like(toe), np.zeros(len(toe), dtype=bool)
    ramp = max(1, round(RAMP * fps))
    for start, end in runs:
        free[max(0, start - ramp) : end + ramp] = True
        own = (np.median(toe[start:end], axis=0) - toe[start:end]) * _OVER_FLOOR
        shift[start:end] = own * np.minimum(1.0, FURTHEST / np.maximum(np.linalg.norm(own, axis=-1), 1e-9))[:, None]
    for start, end in runs:
        free[start:end] = False
    for start, end in _runs(free):
        # three frames on each side see the same third derivatives
        first, last = max(0, start - 3), min(len(toe), end + 3)
        third = np.diff(np.eye(last - first), n=3, axis=0) * fps**3
        unknown = third[:, start - first : end - first]
        jerk = third @ (toe[first:last] * _OVER_FLOOR + shift[first:last])
        shift[start:end] = -np.linalg.solve(unknown.T @ unknown + np.eye(end - start) / PER_JERK**2, unknown.T @ jerk)
    return shift


def _runs(down: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last frame + 1 of every stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], down, [False]]).astype(int)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


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


def enforce_bone_lengths(joints: FloatArray, lengths: FloatArray | None) -> FloatArray:
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
