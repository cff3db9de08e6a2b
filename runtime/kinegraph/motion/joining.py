"""Clips one after another: joined where poses are alike, turned and moved to fit, blended, feet held."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.motion.bones import with_bone_lengths
from kinegraph.motion.feet import planted_feet
from kinegraph.motion.quaternions import about_axis, rotate
from kinegraph.motion.retiming import local_poses
from kinegraph.motion.skeleton import FloatArray, bone_lengths, facing_angle

Floats = NDArray[np.floating[Any]]

BLEND_SECONDS: Final = 0.5
"""Over which one clip becomes the next."""
KEPT: Final = 0.6
"""Share of a clip that no join may cut away at either end."""
VELOCITY_SECONDS: Final = 0.2
"""A difference in speed counts as the distance it makes in that time."""


def joined(clips: Sequence[FloatArray], fps: float) -> FloatArray:
    """One motion from several, each going on where the one before it leaves off.

    Args:
        clips: (frames, 22, 3) metres each, of one body; at least one.
        fps: frames per second of all of them.

    Returns:
        (frames, 22, 3); shorter than all clips together by the blends and what the joins cut away.
    """
    whole = clips[0]
    lengths = np.median(np.concatenate([bone_lengths(clip) for clip in clips]), axis=0).astype(np.float32)
    for clip in clips[1:]:
        whole = _joined_pair(whole, clip, fps)
    if len(clips) == 1:
        return whole
    return planted_feet(with_bone_lengths(whole, lengths), fps)


def best_join(first: FloatArray, second: FloatArray, window: int, fps: float) -> tuple[int, int]:
    """Frames (a, b) such that `first[a : a + window]` goes best with `second[b : b + window]`.

    Compared are poses, their speed, and the speed of the body over the floor, at both ends of the window.
    """
    ends = _states(first, fps), _states(second, fps)
    a = np.arange(min(len(first) - window, round(KEPT * len(first))), len(first) - window + 1)
    b = np.arange(0, max(1, min(len(second) - window, round((1 - KEPT) * len(second))) + 1))
    cost = np.zeros((len(a), len(b)))
    for shift in (0, window - 1):
        one, other = ends[0][a + shift], ends[1][b + shift]
        cost += np.linalg.norm(one[:, None] - other[None], axis=-1).mean(axis=-1)
    row, column = np.unravel_index(np.argmin(cost), cost.shape)
    return int(a[row]), int(b[column])


def _joined_pair(first: FloatArray, second: FloatArray, fps: float) -> FloatArray:
    window = max(2, min(round(BLEND_SECONDS * fps), len(first) // 2, len(second) // 2))
    a, b = best_join(first, second, window, fps)
    end, start = first[a : a + window].astype(np.float64), second[b:].astype(np.float64)
    middle = window // 2
    turn = facing_angle(first)[a + middle] - facing_angle(second)[b + middle]
    floor = np.array([1.0, 0.0, 1.0])
    pivot = start[middle, 0] * floor
    start = rotate(about_axis(1, np.array(float(turn))), start - pivot) + end[middle, 0] * floor
    part = (np.arange(window) + 1.0) / (window + 1.0)
    share = (part * part * (3 - 2 * part))[:, None, None]
    blend = (1 - share) * end + share * start[:window]
    return np.concatenate([first[:a], blend, start[window:]]).astype(np.float32)


def _states(joints: FloatArray, fps: float) -> Floats:
    """(frames, 45, 3): poses in the facing frame, their speed, and the speed over the floor, all as metres."""
    poses = local_poses(joints)
    speed = np.gradient(poses, axis=0) * fps * VELOCITY_SECONDS
    over_floor = np.gradient(joints[:, :1].astype(np.float64), axis=0) * fps * VELOCITY_SECONDS
    back = about_axis(1, -facing_angle(joints).astype(np.float64))
    return np.concatenate([poses, speed, rotate(back[:, None], over_floor)], axis=1)
