"""Poses as they compare wherever the body is and whichever way it faces: to find where motions can be joined.

Clips one after another: joined where poses are alike, turned and moved to fit, blended, feet held.

A clip without a seam: its last frame is its first again, but for travel, which goes on from round to round."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from kinegraph.arrays import FloatArray, Floats
from kinegraph.errors import InvalidInputError
from kinegraph.motion.kinematics import forward_kinematics, rotations_from_positions
from kinegraph.motion.postprocess import enforce_bone_lengths, lock_feet
from kinegraph.motion.quaternions import about_axis, conjugate, multiply, rotate, slerp
from kinegraph.motion.skeleton import PELVIS, bone_lengths, canonicalise, facing_angle

OVER_FLOOR: Final = np.array([1.0, 0.0, 1.0])
"""What travel has of a place (x, y, z)."""
VELOCITY_SECONDS: Final = 0.2
"""A difference in speed counts as the distance it makes in that time."""


def local_poses(joints: FloatArray) -> Floats:
    """(frames, 22, 3) with the pelvis above the origin and the body facing +Z."""
    centred = joints - joints[:, :1] * OVER_FLOOR
    back = about_axis(1, -facing_angle(joints).astype(np.float64))
    return rotate(back[:, None], centred)


def states(joints: FloatArray, fps: float) -> Floats:
    """(frames, 45, 3): poses in the facing frame, their speed, and the speed over the floor, all as metres."""
    poses = local_poses(joints)
    speed = np.gradient(poses, axis=0) * fps * VELOCITY_SECONDS
    over_floor = np.gradient(joints[:, :1].astype(np.float64), axis=0) * fps * VELOCITY_SECONDS
    back = about_axis(1, -facing_angle(joints).astype(np.float64))
    return np.concatenate([poses, speed, rotate(back[:, None], over_floor)], axis=1)


def smoothstep(part: Floats) -> Floats:
    """0 to 1 -> 0 to 1, level at both ends: what the second of two motions counts, `part` of the way to it."""
    return np.asarray(part * part * (3 - 2 * part))


def accelerations(joints: Floats, fps: float) -> Floats:
    """(frames - 2,) m/s^2 of the joint that is accelerated most; number k is about frame k + 1."""
    second = np.diff(np.asarray(joints, dtype=np.float64), n=2, axis=0)
    return np.asarray(np.linalg.norm(second, axis=-1).max(axis=1) * fps**2)


BLEND_SECONDS: Final = (0.5, 0.7, 0.9, 1.1)
"""Over which one clip becomes the next: the first that is `CALM`. Hands that have far to go take longer."""
CALM: Final = 1.6
"""Largest acceleration in a blend, in 95th percentiles of those of the two clips."""
KEPT: Final = 0.6
"""Share of a clip that no join may cut away at either end."""


def stitch(clips: Sequence[FloatArray], fps: float, *, foot_fix: bool = True) -> FloatArray:
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
    whole = enforce_bone_lengths(whole, lengths)
    return lock_feet(whole, fps) if foot_fix else whole


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
    one, other = rotations_from_positions(first, fps), rotations_from_positions(second, fps)
    offsets = (one.rest_offsets + other.rest_offsets) / 2
    left = [
        joints - forward_kinematics(offsets, own.root, own.rotations) for joints, own in ((first, one), (second, other))
    ]
    turns = slerp(one.rotations, other.rotations, share[:, None])
    along = share[:, None, None]
    root = one.root + along[:, 0] * (other.root - one.root)
    # what fixed bones cannot follow is put back, so that nothing jumps where the blend begins and ends
    return forward_kinematics(offsets, root, turns) + left[0] + along * (left[1] - left[0])


SHORTEST: Final = 0.5
"""Share of a clip that a loop keeps at least."""
LOOP_BLEND_SECONDS: Final = 0.5
"""In which the end of a loop turns into its beginning."""
COMPARED_FPS: Final = 20.0
"""Frames per second of which ends are looked for."""
STAYS: Final = 0.15
"""Metres: a body that has moved less than this in a round is meant to stay."""
STRAIGHT: Final = 0.35
"""Radians: a body that has turned less than this in a round is meant to go straight on."""


def make_loop(joints: FloatArray, fps: float, *, foot_fix: bool = True) -> FloatArray:
    """Cut where the pose comes back, its end blended into its start; the last frame closes the round.

    Pose, height and lean come back exactly. Travel and heading go on from round to round, unless they are small:
    then they are taken away evenly over the round.

    Args:
        joints: (frames, 22, 3) metres, Y up.
        fps: frames per second.
        foot_fix: hold feet that stand, also over the seam.

    Returns:
        (frames', 22, 3), half of the frames at least; from the origin, facing +Z.

    Raises:
        InvalidInputError: fewer than 8 frames.
    """
    if len(joints) < 8:
        raise InvalidInputError(f"a loop needs 8 frames, this clip has {len(joints)}")
    start, end = _best_cut(joints, fps)
    whole = _blended(_evened(joints[start : end + 1]), fps)
    travel = _Travel.of(whole)
    if foot_fix:
        rounds = [whole[:-1], travel.on(whole[:-1]), travel.on(travel.on(whole[:-1]))]
        middle = slice(len(whole) - 1, 2 * (len(whole) - 1))
        held = lock_feet(np.concatenate(rounds).astype(np.float32), fps).astype(np.float64)[middle]
        whole = travel.back(held)
        whole = np.concatenate([whole, travel.on(whole[:1])])
    return canonicalise(whole.astype(np.float32))


@dataclass(frozen=True)
class _Travel:
    """What one round adds: a turn about Y, and a way over the floor."""

    turn: Floats
    """(4,) quaternion."""
    begin: Floats
    end: Floats
    """(3,) the pelvis over the floor, at both ends of the first round."""

    @classmethod
    def of(cls, joints: Floats) -> _Travel:
        """Of a motion whose last frame is its first one round later."""
        heading = facing_angle(joints[[0, -1]].astype(np.float32)).astype(np.float64)
        begin, end = joints[[0, -1], PELVIS] * OVER_FLOOR
        return cls(about_axis(1, np.array(heading[1] - heading[0])), begin, end)

    def on(self, joints: Floats) -> Floats:
        """The same one round later."""
        return rotate(self.turn, joints - self.begin) + self.end

    def back(self, joints: Floats) -> Floats:
        """The same one round earlier."""
        return rotate(conjugate(self.turn), joints - self.end) + self.begin


def _best_cut(joints: FloatArray, fps: float) -> tuple[int, int]:
    """Two frames that are most alike, in pose and in how they move, with at least `SHORTEST` of the clip between."""
    every = max(1, round(fps / COMPARED_FPS))
    seen = states(joints, fps)[::every]
    least = max(4, round(SHORTEST * len(seen)))
    cost = np.full((len(seen) - least, len(seen)), np.inf)
    for start in range(len(cost)):
        cost[start, start + least :] = np.linalg.norm(seen[start + least :] - seen[start], axis=-1).mean(axis=-1)
    first, last = np.unravel_index(np.argmin(cost), cost.shape)
    return int(first) * every, int(last) * every


def _evened(joints: FloatArray) -> Floats:
    """Without the little that a body which stays moves, and one that goes straight on turns, in a round."""
    heading = facing_angle(joints).astype(np.float64)
    part = np.linspace(0.0, 1.0, len(joints))
    turned = heading[-1] - heading[0]
    even = about_axis(1, -part * turned if abs(turned) < STRAIGHT else 0.0 * part)
    pelvis = joints[:, PELVIS].astype(np.float64)
    steps = rotate(even[1:], np.diff(pelvis, axis=0))
    path = pelvis[0] + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    moved = (path[-1] - path[0]) * OVER_FLOOR
    if np.linalg.norm(moved) < STAYS:
        path = path - part[:, None] * moved
    return np.asarray(rotate(even[:, None], joints - pelvis[:, None]) + path[:, None])


def _blended(joints: Floats, fps: float) -> Floats:
    """What is missing for the last frame to be the first again, spread over the frames before it, smoothly."""
    motion = rotations_from_positions(joints, fps)
    window = max(2, min(len(joints) // 2, round(LOOP_BLEND_SECONDS * fps)))
    share = np.zeros(len(joints))
    share[len(joints) - window :] = smoothstep((np.arange(window) + 1.0) / window)
    heading = about_axis(1, facing_angle(joints.astype(np.float32)).astype(np.float64))
    turns = motion.rotations.copy()
    turns[:, 0] = multiply(conjugate(heading), turns[:, 0])
    turns = slerp(turns, np.broadcast_to(turns[:1], turns.shape), share[:, None])
    turns[:, 0] = multiply(heading, turns[:, 0])
    root = motion.root.copy()
    root[:, 1] += share * (motion.root[0, 1] - root[:, 1])
    return forward_kinematics(motion.rest_offsets, root, turns)
