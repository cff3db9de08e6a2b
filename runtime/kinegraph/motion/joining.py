"""Clips one after another: joined where poses are alike, turned and moved to fit, blended, feet held."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.motion.bones import with_bone_lengths
from kinegraph.motion.feet import planted_feet
from kinegraph.motion.poses import OVER_FLOOR, accelerations, smoothstep, states
from kinegraph.motion.quaternions import about_axis, rotate, slerp
from kinegraph.motion.rotations import forward_kinematics, solve_rotations
from kinegraph.motion.skeleton import FloatArray, bone_lengths, facing_angle

Floats = NDArray[np.floating[Any]]

BLEND_SECONDS: Final = (0.5, 0.7, 0.9, 1.1)
"""Over which one clip becomes the next: the first that is `CALM`. Hands that have far to go take longer."""
CALM: Final = 1.6
"""Largest acceleration in a blend, in 95th percentiles of those of the two clips."""
KEPT: Final = 0.6
"""Share of a clip that no join may cut away at either end."""


def joined(clips: Sequence[FloatArray], fps: float, *, foot_fix: bool = True) -> FloatArray:
    """One motion from several, each going on where the one before it leaves off.

    Args:
        clips: (frames, 22, 3) metres each, of one body; at least one.
        fps: frames per second of all of them.
        foot_fix: hold feet that stand, also while one clip becomes the next.

    Returns:
        (frames, 22, 3); shorter than all clips together by the blends and what the joins cut away.
    """
    whole = clips[0]
    if len(clips) == 1:
        return whole
    lengths = np.median(np.concatenate([bone_lengths(clip) for clip in clips]), axis=0).astype(np.float32)
    for clip in clips[1:]:
        whole = best_blend(whole, clip, fps).joints
    whole = with_bone_lengths(whole, lengths)
    return planted_feet(whole, fps) if foot_fix else whole


@dataclass(frozen=True)
class Blend:
    """Two clips as one motion."""

    joints: FloatArray
    """(frames, 22, 3) metres."""
    start: int
    """The first frame in which both have a say."""
    frames: int
    """How many there are."""

    def acceleration(self, fps: float) -> float:
        """Largest of a joint in any frame that the blend has changed, m/s^2."""
        # number k of accelerations is about frame k + 1
        own = accelerations(self.joints, fps)[max(0, self.start - 2) : self.start + self.frames]
        return float(own.max(initial=0.0))


def best_blend(first: FloatArray, second: FloatArray, fps: float) -> Blend:
    """The shortest of `BLEND_SECONDS` that is `CALM`, or else the calmest."""
    own = np.concatenate([[0.0], *(accelerations(clip, fps) for clip in (first, second))])
    calm = CALM * float(np.quantile(own, 0.95))
    found: list[Blend] = []
    for seconds in BLEND_SECONDS:
        window = max(2, min(round(seconds * fps), len(first) // 2, len(second) // 2))
        found.append(_blend(first, second, window, fps))
        if found[-1].acceleration(fps) <= calm:
            return found[-1]
    return min(found, key=lambda blend: blend.acceleration(fps))


def best_join(first: FloatArray, second: FloatArray, window: int, fps: float) -> tuple[int, int]:
    """Frames (a, b) such that `first[a : a + window]` goes best with `second[b : b + window]`.

    Compared are poses, their speed, and the speed of the body over the floor, at both ends of the window.
    """
    ends = states(first, fps), states(second, fps)
    a = np.arange(min(len(first) - window, round(KEPT * len(first))), len(first) - window + 1)
    b = np.arange(0, max(1, min(len(second) - window, round((1 - KEPT) * len(second))) + 1))
    cost = np.zeros((len(a), len(b)))
    for shift in (0, window - 1):
        one, other = ends[0][a + shift], ends[1][b + shift]
        cost += np.linalg.norm(one[:, None] - other[None], axis=-1).mean(axis=-1)
    row, column = np.unravel_index(np.argmin(cost), cost.shape)
    return int(a[row]), int(b[column])


def _blend(first: FloatArray, second: FloatArray, window: int, fps: float) -> Blend:
    a, b = best_join(first, second, window, fps)
    end, start = first[a : a + window].astype(np.float64), second[b:].astype(np.float64)
    middle = window // 2
    turn = facing_angle(first)[a + middle] - facing_angle(second)[b + middle]
    pivot = start[middle, 0] * OVER_FLOOR
    start = rotate(about_axis(1, np.array(float(turn))), start - pivot) + end[middle, 0] * OVER_FLOOR
    blend = _between(end, start[:window], smoothstep((np.arange(window) + 1.0) / (window + 1.0)), fps)
    return Blend(np.concatenate([first[:a], blend, start[window:]]).astype(np.float32), a, window)


def _between(first: Floats, second: Floats, share: Floats, fps: float) -> Floats:
    """Both motions (frames, 22, 3) as one, `share` (frames,) of it the second.

    Turns are mixed along the shorter way: a mix of positions would shorten an arm that goes from below to above.
    """
    one, other = solve_rotations(first, fps), solve_rotations(second, fps)
    offsets = (one.rest_offsets + other.rest_offsets) / 2
    left = [
        joints - forward_kinematics(offsets, own.root, own.rotations) for joints, own in ((first, one), (second, other))
    ]
    turns = slerp(one.rotations, other.rotations, share[:, None])
    along = share[:, None, None]
    root = one.root + along[:, 0] * (other.root - one.root)
    # what fixed bones cannot follow is put back, so that nothing jumps where the blend begins and ends
    return forward_kinematics(offsets, root, turns) + left[0] + along * (left[1] - left[0])
