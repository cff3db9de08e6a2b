"""What a body must have done for a caption to be true, read off the joints alone.

Every predicate takes joints (frames, 22, 3) in metres at 20 frames per second, +Y up, starting at the origin facing +Z
with the left side at +X, and answers yes or no. Thresholds are round numbers between what the captured clips of the
label do and what those of its neighbours do; the rate of the captured clips is always printed beside.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from kinegraph.arrays import FloatArray
from numpy.typing import NDArray

from kinegraph.motion.skeleton import JOINT_INDEX, facing_angle

FPS = 20
Predicate = Callable[[FloatArray], bool]


def displacement(joints: FloatArray) -> NDArray[np.float64]:
    """Pelvis from first to last frame along (left, forward) of the first facing, metres."""
    moved = joints[-1, 0] - joints[0, 0]
    heading = facing_angle(joints)[0]
    sin, cos = np.sin(heading), np.cos(heading)
    return np.array([cos * moved[0] - sin * moved[2], sin * moved[0] + cos * moved[2]])


def speed(joints: FloatArray) -> float:
    """Mean speed of the pelvis over the floor, metres per second."""
    steps = np.linalg.norm(np.diff(joints[:, 0][:, [0, 2]], axis=0), axis=1)
    return float(steps.mean() * FPS)


def net_turn(joints: FloatArray) -> float:
    """Change of heading from first to last frame, degrees, positive to the left."""
    heading = facing_angle(joints)
    return float(np.degrees(heading[-1] - heading[0]))


def above_head(joints: FloatArray, side: str) -> bool:
    """Whether that wrist is above the head joint at any moment."""
    return bool((joints[:, JOINT_INDEX[f"{side}_wrist"], 1] > joints[:, JOINT_INDEX["head"], 1]).any())


def wrist_path(joints: FloatArray, side: str) -> float:
    """Length of that wrist's path relative to the pelvis, metres."""
    relative = joints[:, JOINT_INDEX[f"{side}_wrist"]] - joints[:, 0]
    return float(np.linalg.norm(np.diff(relative, axis=0), axis=1).sum())


def ankle_gap(joints: FloatArray) -> float:
    """Smallest distance of the ankles over the floor, metres."""
    gap = joints[:, JOINT_INDEX["left_ankle"]] - joints[:, JOINT_INDEX["right_ankle"]]
    return float(np.linalg.norm(gap[:, [0, 2]], axis=1).min())


def wrist_gap(joints: FloatArray) -> float:
    """Mean distance of the wrists, metres."""
    return float(
        np.linalg.norm(joints[:, JOINT_INDEX["left_wrist"]] - joints[:, JOINT_INDEX["right_wrist"]], axis=1).mean()
    )


def goes(axis: int, sign: float, metres: float) -> Predicate:
    """Net displacement along left (0) or forward (1), in the sense of `sign`, of more than `metres`."""
    return lambda joints: bool(sign * displacement(joints)[axis] > metres)


def turns(side: str) -> Predicate:
    """Ends more than 45 degrees from where it faced, to that side."""
    sign = 1.0 if side == "left" else -1.0
    return lambda joints: sign * net_turn(joints) > 45.0


def raises(side: str) -> Predicate:
    """That wrist comes above the head and the other never; "both": both do."""
    return lambda joints: all(above_head(joints, each) == (side in (each, "both")) for each in ("left", "right"))


def stands(joints: FloatArray) -> bool:
    """Ends less than 0.5 m from where it started."""
    return bool(np.linalg.norm(displacement(joints)) < 0.5)


def swings(side: str) -> Predicate:
    """That wrist travels more than 0.8 m and twice as far as the other; "both": both wrists travel so far."""

    def holds(joints: FloatArray) -> bool:
        left, right = wrist_path(joints, "left"), wrist_path(joints, "right")
        if side == "both":
            return min(left, right) > 0.8
        moving, still = (left, right) if side == "left" else (right, left)
        return moving > 0.8 and moving > 2 * still

    return holds


def waves(side: str) -> Predicate:
    """Swings that hand, or both, standing."""
    return both(stands, swings(side))


def swings_high(side: str) -> Predicate:
    """That wrist travels more than 0.5 m while it is above its shoulder; "both": both do.

    For waving beside another action: a walker's arms swing further than 0.8 m (99 % of captured walks), but below the
    shoulder (1 %); of captured waves 81 % are high.
    """

    def path(joints: FloatArray, each: str) -> float:
        wrist = joints[:, JOINT_INDEX[f"{each}_wrist"]]
        high = wrist[:, 1] > joints[:, JOINT_INDEX[f"{each}_shoulder"], 1]
        steps = np.linalg.norm(np.diff(wrist - joints[:, 0], axis=0), axis=1)
        return float(steps[high[1:] & high[:-1]].sum())

    return lambda joints: all(path(joints, each) > 0.5 for each in ("left", "right") if side in (each, "both"))


def waves_a_hand(joints: FloatArray) -> bool:
    """Any wrist travels more than 0.8 m, standing."""
    return max(wrist_path(joints, "left"), wrist_path(joints, "right")) > 0.8 and stands(joints)


def bows(joints: FloatArray) -> bool:
    """The head drops by more than 0.1 m below where it was at first."""
    height = joints[:, JOINT_INDEX["head"], 1]
    return bool(height[0] - height.min() > 0.1)


def kicks(joints: FloatArray) -> bool:
    """An ankle rises more than 0.3 m above its lowest point while the body stays within 1 m."""
    ankles = joints[:, [JOINT_INDEX["left_ankle"], JOINT_INDEX["right_ankle"]], 1]
    return bool((ankles.max(0) - ankles.min(0)).max() > 0.3 and np.linalg.norm(displacement(joints)) < 1.0)


def punches(joints: FloatArray) -> bool:
    """A wrist moves faster than 3 m/s relative to the pelvis and the body stays within 1 m."""
    wrists = joints[:, [JOINT_INDEX["left_wrist"], JOINT_INDEX["right_wrist"]]] - joints[:, :1]
    fastest = np.linalg.norm(np.diff(wrists, axis=0), axis=-1).max() * FPS
    return bool(fastest > 3.0 and np.linalg.norm(displacement(joints)) < 1.0)


def both(*predicates: Predicate) -> Predicate:
    """All of them hold."""
    return lambda joints: all(predicate(joints) for predicate in predicates)


def slower(metres_per_second: float) -> Predicate:
    """The pelvis is slower than that on average."""
    return lambda joints: speed(joints) < metres_per_second


def faster(metres_per_second: float) -> Predicate:
    """The pelvis is faster than that on average."""
    return lambda joints: speed(joints) > metres_per_second
