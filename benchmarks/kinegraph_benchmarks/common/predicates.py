"""Decide from the joints alone whether a body does what a caption says.

Every predicate takes joints (frames, 22, 3) in metres at 20 frames per second, +Y up, starting at the origin facing +Z
with the left side at +X. Thresholds are round numbers between what captured clips of the label do and what those of
similar labels do; benchmarks always print the rate of the captured clips beside that of generated ones.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import FloatArray
from kinegraph.motion.skeleton import JOINT_INDEX, facing_angle

FPS = 20
SIDES = ("left", "right")
Predicate = Callable[[FloatArray], bool]


# Quantities


def displacement(joints: FloatArray) -> NDArray[np.float64]:
    """Measure how far the pelvis gets, metres along (left, forward) of the facing direction in the first frame."""
    moved = joints[-1, 0] - joints[0, 0]
    heading = facing_angle(joints)[0]
    sin, cos = np.sin(heading), np.cos(heading)
    return np.array([cos * moved[0] - sin * moved[2], sin * moved[0] + cos * moved[2]])


def speed(joints: FloatArray) -> float:
    """Measure the mean speed of the pelvis over the floor, metres per second."""
    steps = np.linalg.norm(np.diff(joints[:, 0][:, [0, 2]], axis=0), axis=1)
    return float(steps.mean() * FPS)


def net_turn(joints: FloatArray) -> float:
    """Measure the change of heading from first to last frame, degrees, positive to the left."""
    heading = facing_angle(joints)
    return float(np.degrees(heading[-1] - heading[0]))


def wrist_path(joints: FloatArray, side: str) -> float:
    """Measure the length of a wrist's path relative to the pelvis, metres."""
    relative = joints[:, JOINT_INDEX[f"{side}_wrist"]] - joints[:, 0]
    return float(np.linalg.norm(np.diff(relative, axis=0), axis=1).sum())


def ankle_gap(joints: FloatArray) -> float:
    """Measure the smallest distance of the ankles over the floor, metres."""
    gap = joints[:, JOINT_INDEX["left_ankle"]] - joints[:, JOINT_INDEX["right_ankle"]]
    return float(np.linalg.norm(gap[:, [0, 2]], axis=1).min())


def wrist_gap(joints: FloatArray) -> float:
    """Measure the mean distance of the wrists, metres."""
    gap = joints[:, JOINT_INDEX["left_wrist"]] - joints[:, JOINT_INDEX["right_wrist"]]
    return float(np.linalg.norm(gap, axis=1).mean())


# Predicates


def above_head(joints: FloatArray, side: str) -> bool:
    """Tell whether a wrist is above the head joint at any moment."""
    return bool((joints[:, JOINT_INDEX[f"{side}_wrist"], 1] > joints[:, JOINT_INDEX["head"], 1]).any())


def stands(joints: FloatArray) -> bool:
    """Tell whether a body ends less than 0.5 m from where it started."""
    return bool(np.linalg.norm(displacement(joints)) < 0.5)


def waves_a_hand(joints: FloatArray) -> bool:
    """Tell whether any wrist travels more than 0.8 m while the body stands."""
    return max(wrist_path(joints, side) for side in SIDES) > 0.8 and stands(joints)


def bows(joints: FloatArray) -> bool:
    """Tell whether the head drops by more than 0.1 m below where it was at first."""
    height = joints[:, JOINT_INDEX["head"], 1]
    return bool(height[0] - height.min() > 0.1)


def kicks(joints: FloatArray) -> bool:
    """Tell whether an ankle rises more than 0.3 m above its lowest point while the body stays within 1 m."""
    ankles = joints[:, [JOINT_INDEX["left_ankle"], JOINT_INDEX["right_ankle"]], 1]
    return bool((ankles.max(0) - ankles.min(0)).max() > 0.3 and np.linalg.norm(displacement(joints)) < 1.0)


def punches(joints: FloatArray) -> bool:
    """Tell whether a wrist moves faster than 3 m/s relative to the pelvis while the body stays within 1 m."""
    wrists = joints[:, [JOINT_INDEX["left_wrist"], JOINT_INDEX["right_wrist"]]] - joints[:, :1]
    fastest = np.linalg.norm(np.diff(wrists, axis=0), axis=-1).max() * FPS
    return bool(fastest > 3.0 and np.linalg.norm(displacement(joints)) < 1.0)


# Makers of predicates


def goes(axis: int, sign: float, metres: float) -> Predicate:
    """Make a predicate: the net displacement to the left (axis 0) or forward (1), times `sign`, exceeds `metres`."""
    return lambda joints: bool(sign * displacement(joints)[axis] > metres)


def turns(side: str) -> Predicate:
    """Make a predicate: the body ends more than 45 degrees to that side of where it faced."""
    sign = 1.0 if side == "left" else -1.0
    return lambda joints: sign * net_turn(joints) > 45.0


def raises(side: str) -> Predicate:
    """Make a predicate: that wrist comes above the head and the other never does; for "both", both do."""
    return lambda joints: all(above_head(joints, wrist) == (side in (wrist, "both")) for wrist in SIDES)


def swings(side: str) -> Predicate:
    """Make a predicate: that wrist travels more than 0.8 m and twice as far as the other; for "both", both do 0.8 m."""

    def holds(joints: FloatArray) -> bool:
        left, right = wrist_path(joints, "left"), wrist_path(joints, "right")
        if side == "both":
            return min(left, right) > 0.8
        moving, still = (left, right) if side == "left" else (right, left)
        return moving > 0.8 and moving > 2 * still

    return holds


def waves(side: str) -> Predicate:
    """Make a predicate: that hand, or both, swings while the body stands."""
    return all_of(stands, swings(side))


def swings_high(side: str) -> Predicate:
    """Make a predicate: that wrist travels more than 0.5 m while it is above its shoulder; for "both", both do.

    For waving beside another action. A walker's arms swing further than 0.8 m (99 % of captured walks), but below the
    shoulder (all but 1 %); of captured waves 81 % are high.
    """

    def high_path(joints: FloatArray, wrist_side: str) -> float:
        wrist = joints[:, JOINT_INDEX[f"{wrist_side}_wrist"]]
        high = wrist[:, 1] > joints[:, JOINT_INDEX[f"{wrist_side}_shoulder"], 1]
        steps = np.linalg.norm(np.diff(wrist - joints[:, 0], axis=0), axis=1)
        return float(steps[high[1:] & high[:-1]].sum())

    return lambda joints: all(high_path(joints, wrist) > 0.5 for wrist in SIDES if side in (wrist, "both"))


def all_of(*predicates: Predicate) -> Predicate:
    """Make a predicate: all of these hold."""
    return lambda joints: all(predicate(joints) for predicate in predicates)


def slower(metres_per_second: float) -> Predicate:
    """Make a predicate: the mean speed of the pelvis is below this."""
    return lambda joints: speed(joints) < metres_per_second


def faster(metres_per_second: float) -> Predicate:
    """Make a predicate: the mean speed of the pelvis is above this."""
    return lambda joints: speed(joints) > metres_per_second
