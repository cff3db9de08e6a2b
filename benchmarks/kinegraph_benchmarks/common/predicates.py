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
from kinegraph.motion.turning import net_turn

FPS = 20
SIDES = ("left", "right")
Predicate = Callable[[FloatArray], bool]

RAISED = -0.1
"""Metres above its shoulder from which a wrist is raised, if it is also above its elbow."""
WIDE_STROKE, WIDE_REVERSALS = 0.06, 2
"""Strokes of a wave with a raised hand, metres, and how often they turn around at least."""
MOVING_STROKE = 0.12
"""The same beside another action: a hand that a runner holds up sways by 6 to 11 cm. Captured waves on bodies that go
or turn are as wide, or flicks; captured raises there are not (tests/benchmarks/test_two_actions.py)."""
FLICK_STROKE, FLICK_REVERSALS, FLICK_SECONDS = 0.01, 4, 0.4
"""The same of a wave from the wrist, and the longest time between reversals: joints end at the wrist, which shakes."""
MOST_TURN = 200.0
"""Degrees of a turn to a side."""
BESIDE_SHOULDER = 0.05
"""Metres above its shoulder below which a wrist may wave in flicks; higher up all captured waves are wide."""


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


def turning_points(values: NDArray[np.float64], stroke: float) -> list[int]:
    """Find where a quantity turns around, between moves of at least `stroke` in opposite directions.

    Args:
        values: (n,) of the quantity, one a frame.
        stroke: smallest move that counts, in its unit.

    Returns:
        Indices of the extremes; the first and last move need an extreme on one side only.
    """
    turns: list[int] = []
    low = high = extreme = direction = 0
    for index, value in enumerate(values):
        if direction == 0:
            low, high = (index if value < values[low] else low), (index if value > values[high] else high)
            if value - values[low] >= stroke or values[high] - value >= stroke:
                direction, extreme = (1 if value - values[low] >= stroke else -1), index
        elif (value - values[extreme]) * direction > 0:
            extreme = index
        elif (values[extreme] - value) * direction >= stroke:
            turns.append(extreme)
            direction, extreme = -direction, index
    return turns


def raised_hand_paths(joints: FloatArray, side: str) -> list[NDArray[np.float64]]:
    """Cut out the path of a hand for each time that it is raised: beside or above its shoulder, above its elbow.

    Returns:
        (frames, 2) of each time: metres of the wrist to the left of its shoulder, as the body faces, and above it.
    """
    wrist, shoulder, elbow = (joints[:, JOINT_INDEX[f"{side}_{name}"]] for name in ("wrist", "shoulder", "elbow"))
    offset = (wrist - shoulder).astype(np.float64)
    heading = facing_angle(joints)
    left = np.cos(heading) * offset[:, 0] - np.sin(heading) * offset[:, 2]
    raised = np.flatnonzero((offset[:, 1] > RAISED) & (wrist[:, 1] > elbow[:, 1]))
    spans = np.split(raised, np.flatnonzero(np.diff(raised) > 1) + 1)
    return [np.stack([left[span], offset[span, 1]], axis=1) for span in spans if len(span)]


def wave_strokes(joints: FloatArray, side: str) -> NDArray[np.float64]:
    """Measure the strokes of a raised hand between one reversal and the next, metres sideways; 1 cm at least.

    Raising and lowering the hand are no strokes: they have a reversal at one end only.
    """
    strokes = [
        np.abs(np.diff(path[turning_points(path[:, 0], FLICK_STROKE), 0])) for path in raised_hand_paths(joints, side)
    ]
    return np.concatenate(strokes) if strokes else np.zeros(0)


# Predicates


def hand_waves(joints: FloatArray, side: str, stroke: float = WIDE_STROKE) -> bool:
    """Tell whether a raised hand goes to and fro sideways: by `stroke` twice, or in quick flicks beside the shoulder.

    A hand that is raised and lowered turns around once. Of captured waves 99 % are met in each style, of captured
    raises 1 %, of walks and runs none. Feminine waves are flicks: the wrist moves 1 to 3 cm, as the hand turns.
    """
    for path in raised_hand_paths(joints, side):
        if len(turning_points(path[:, 0], stroke)) >= WIDE_REVERSALS:
            return True
        flicks = [turn for turn in turning_points(path[:, 0], FLICK_STROKE) if path[turn, 1] < BESIDE_SHOULDER]
        spans = np.subtract(flicks[FLICK_REVERSALS - 1 :], flicks[: 1 - FLICK_REVERSALS])
        if (spans <= FLICK_SECONDS * FPS * (FLICK_REVERSALS - 1)).any():
            return True
    return False


def above_head(joints: FloatArray, side: str) -> bool:
    """Tell whether a wrist is above the head joint at any moment."""
    return bool((joints[:, JOINT_INDEX[f"{side}_wrist"], 1] > joints[:, JOINT_INDEX["head"], 1]).any())


def stands(joints: FloatArray) -> bool:
    """Tell whether a body ends less than 0.5 m from where it started."""
    return bool(np.linalg.norm(displacement(joints)) < 0.5)


def waves_a_hand(joints: FloatArray) -> bool:
    """Tell whether a hand waves while the body stands."""
    return stands(joints) and any(hand_waves(joints, side) for side in SIDES)


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
    """Make a predicate: the body ends more than 45 degrees to that side of where it faced, and goes on to no circle.

    Captured turns to a side have 181 degrees at most, captured circles 204 at least.
    """
    sign = 1.0 if side == "left" else -1.0
    return lambda joints: 45.0 < sign * net_turn(joints) < MOST_TURN


def raises(side: str) -> Predicate:
    """Make a predicate: that wrist alone comes above the head, for "both" both do, and no hand waves."""
    return lambda joints: (
        all(above_head(joints, wrist) == (side in (wrist, "both")) for wrist in SIDES)
        and not any(hand_waves(joints, wrist) for wrist in SIDES)
    )


def _wrists(side: str) -> list[str]:
    """List the sides that "left", "right" or "both" stands for."""
    return [wrist for wrist in SIDES if side in (wrist, "both")]


def raises_beside(side: str) -> Predicate:
    """Make a predicate: that wrist, or both, comes above the head and does not wave, whatever else the body does."""
    return lambda joints: all(
        above_head(joints, wrist) and not hand_waves(joints, wrist, MOVING_STROKE) for wrist in _wrists(side)
    )


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
    """Make a predicate: that hand waves while the body stands, and the other does not; for "both", both do."""
    return lambda joints: (
        stands(joints) and all(hand_waves(joints, wrist) == (side in (wrist, "both")) for wrist in SIDES)
    )


def waves_beside(side: str) -> Predicate:
    """Make a predicate: that hand, or both, waves, whatever else the body does."""
    return lambda joints: all(hand_waves(joints, wrist, MOVING_STROKE) for wrist in _wrists(side))


def all_of(*predicates: Predicate) -> Predicate:
    """Make a predicate: all of these hold."""
    return lambda joints: all(predicate(joints) for predicate in predicates)


def slower(metres_per_second: float) -> Predicate:
    """Make a predicate: the mean speed of the pelvis is below this."""
    return lambda joints: speed(joints) < metres_per_second


def faster(metres_per_second: float) -> Predicate:
    """Make a predicate: the mean speed of the pelvis is above this."""
    return lambda joints: speed(joints) > metres_per_second
