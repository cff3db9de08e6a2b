"""Turn a motion further, or less far, and keep its steps.

Heading and travel of a body are features relative to the frame before (`motion.features`). Adding an angle to the
heading of every frame bends the path and leaves the gait as it is. Angles are about +Y, positive to the left.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from kinegraph.arrays import DoubleArray, FloatArray
from kinegraph.motion.features import features_from_joints, joints_from_features
from kinegraph.motion.skeleton import HORIZONTAL, JOINT_INDEX, facing_angle

Span = tuple[int, int]

MOST_LONGER: Final = 2.0
"""How many times as far a motion is turned at most: one that turns less was not meant to."""
BEYOND: Final = 0.4
"""Share of a turn by which one that is held back goes further at most."""
BEYOND_SCALE: Final = 1.5
"""How far beyond itself, in its own size, a turn is made that goes further by 63 % of that."""
ON_THE_SPOT: Final = 0.5
"""Metres from its start within which a body turns on its place."""
SMOOTH_SECONDS: Final = 0.5
"""Deviation of the Gaussian window that tells a turn from the sway of hips and shoulders at each step."""


def bend(joints: FloatArray, turn: DoubleArray) -> FloatArray:
    """Turn a motion by an extra angle from each frame to the next.

    Args:
        joints: (frames, 22, 3) metres, from the origin on and facing +Z.
        turn: (frames,) radians, of which the last counts for nothing.
    """
    features = features_from_joints(joints)
    features[:, 0] += turn[: len(features)].astype(np.float32)
    return joints_from_features(features)


def net_turn(joints: FloatArray) -> float:
    """Measure the change of heading from the first frame to the last, degrees, with all rounds."""
    heading = facing_angle(joints)
    return float(np.degrees(heading[-1] - heading[0]))


def turned_to(joints: FloatArray, side: int, shown: Span | None = None) -> float:
    """Measure how far a motion turns to a side, degrees; see `turn_by`."""
    first, last = _ends(joints, shown)
    made = net_turn(joints[first : last + 1])
    return made * side if side else abs(made)


def has_heading(joints: FloatArray) -> bool:
    """Tell whether it is clear all the time where a body faces, as it is not while one falls or rolls on its side.

    The line through the hips is at least half as long over the floor as it is.
    """
    line = joints[:, JOINT_INDEX["left_hip"]] - joints[:, JOINT_INDEX["right_hip"]]
    over_floor = np.linalg.norm(line * HORIZONTAL, axis=1)
    return bool((over_floor > 0.5 * np.linalg.norm(line, axis=1)).all())


def turn_by(joints: FloatArray, fps: float, degrees: float, side: int, shown: Span | None = None) -> FloatArray:
    """Scale the turn of a motion to `degrees` exactly, if it turns that way by half of them at least.

    Args:
        joints: (frames, 22, 3) metres, from the origin on and facing +Z.
        fps: frames a second.
        degrees: above 0.
        side: 1 to the left, -1 to the right, 0 the way that it turns.
        shown: first frame and the one behind the last of those in which the turn is measured; None is all.
    """
    made = turned_to(joints, side, shown)
    is_meant = made * MOST_LONGER >= degrees and has_heading(joints)
    return scale_turn(joints, fps, degrees / made, shown) if is_meant else joints


def hold_back_turn(joints: FloatArray, fps: float, degrees: float, side: int, shown: Span | None = None) -> FloatArray:
    """Hold back the turn of a motion beyond `degrees`: it ends 40 % beyond them at most, and a larger one stays larger.

    Args:
        joints, fps, degrees, side, shown: see `turn_by`.
    """
    made = turned_to(joints, side, shown)
    if made <= degrees or not has_heading(joints):
        return joints
    further = BEYOND * (1.0 - np.exp(-(made / degrees - 1.0) / BEYOND_SCALE))
    return scale_turn(joints, fps, degrees * (1.0 + further) / made, shown)


def scale_turn(joints: FloatArray, fps: float, factor: float, shown: Span | None = None) -> FloatArray:
    """Turn `factor` times as far, at each moment in proportion to how fast the motion turns there.

    The sway of the body at each step, which is no turn, stays. A body that turns on its place stays there: steps along
    a small circle would lead away where they turn less.

    Args:
        joints, fps, shown: see `turn_by`.
        factor: of the change of heading from the first to the last frame that is shown.
    """
    heading = facing_angle(joints).astype(np.float64)
    first, last = _ends(joints, shown)
    made, turn = heading[last] - heading[first], smooth_with_ends(heading, SMOOTH_SECONDS * fps)
    if (turn[last] - turn[first]) / made < 0.5:  # most of it happens where the frames that are shown begin or end
        turn = heading
    share = (factor - 1.0) * made / (turn[last] - turn[first])
    bent = bend(joints, np.append(share * np.diff(turn), 0.0))
    if _reach(joints) < min(ON_THE_SPOT, _reach(bent)):
        bent += (joints[:, :1] - bent[:, :1]) * HORIZONTAL.astype(np.float32)
    return bent


def smooth_with_ends(values: DoubleArray, deviation: float) -> DoubleArray:
    """Average values (n,) under a Gaussian window of that deviation, and keep the first and the last."""
    reach = min(round(3 * deviation), len(values) - 1)
    window = np.exp(-0.5 * (np.arange(-reach, reach + 1) / deviation) ** 2)
    # mirrored through the end points, so that these stay where they are
    before, after = 2 * values[0] - values[reach:0:-1], 2 * values[-1] - values[-2 : -reach - 2 : -1]
    smoothed: DoubleArray = np.convolve(np.concatenate([before, values, after]), window / window.sum(), mode="valid")
    return smoothed


def _reach(joints: FloatArray) -> float:
    """Measure how far the pelvis gets from where it started, metres."""
    return float(np.linalg.norm((joints[:, 0] - joints[0, 0]) * HORIZONTAL, axis=1).max())


def _ends(joints: FloatArray, shown: Span | None) -> Span:
    return (0, len(joints) - 1) if shown is None else (shown[0], shown[1] - 1)
