"""Blending of motions: clips stitched one after another, and clips closed into loops.

Where to cut is found by comparing frames as in motion graphs (Kovar et al., 2002): pose, joint velocities and velocity
over the floor, each in the facing frame of its body, so that neither position nor heading counts. Blends mix joint
rotations, not positions: a mix of positions would shorten an arm that goes from below to above.

A loop is a clip whose last frame is its first one again, one round later. Travel and heading go on from round to round.

Joints are (frames, 22, 3) metres with Y up; a stitched motion stays in the world frame of its first clip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from kinegraph.arrays import FloatArray, Floats, IntArray
from kinegraph.errors import InvalidInputError
from kinegraph.motion.kinematics import forward_kinematics, rotations_from_positions
from kinegraph.motion.postprocess import enforce_bone_lengths, lock_feet
from kinegraph.motion.quaternions import IDENTITY, about_axis, conjugate, multiply, rotate, slerp
from kinegraph.motion.skeleton import HORIZONTAL, PELVIS, bone_lengths, canonicalise, facing_angle

VELOCITY_SECONDS: Final = 0.2
"""Turns velocities into metres: a difference in velocity counts as the distance it makes in this time."""

BLEND_SECONDS: Final = (0.5, 0.7, 0.9, 1.1)
"""Durations to try for a blend, shortest first; hands that have far to go need longer."""
CALM: Final = 1.6
"""Largest acceleration allowed in a blend, in 95 % quantiles of the accelerations of both clips."""
MAX_SHIFT: Final = 0.2
"""Seconds by which a blend may move away from where two parts meet, in either clip."""

MIN_LOOP: Final = 0.5
"""Share of a clip that a loop keeps at least."""
LOOP_BLEND_SECONDS: Final = 0.5
"""Duration over which the end of a loop is blended into its start."""
SEARCH_FPS: Final = 20.0
"""Frames per second at which the ends of a loop are searched."""
MOST_SEARCHED: Final = 2000
"""Frames among which they are searched at most."""
STAYS: Final = 0.15
"""Metres: a body that has travelled less than this in a round is meant to stay."""
STRAIGHT: Final = 0.35
"""Radians: a body that has turned less than this in a round is meant to go straight on."""


@dataclass(frozen=True)
class Blend:
    """Two clips blended into one motion."""

    joints: FloatArray
    """(frames, 22, 3) metres."""
    start: int
    """First frame of the blend."""
    frames: int
    """Length of the blend."""

    def peak_acceleration(self, fps: float) -> float:
        """Measure the largest acceleration of any joint in the frames that the blend has changed, m/s^2."""
        # entry k of peak_accelerations belongs to frame k + 1
        changed = peak_accelerations(self.joints, fps)[max(0, self.start - 2) : self.start + self.frames]
        return float(changed.max(initial=0.0))


def stitch(
    clips: Sequence[FloatArray],
    fps: float,
    *,
    leads: Sequence[int] | None = None,
    lengths: Sequence[int] | None = None,
    foot_fix: bool = True,
) -> FloatArray:
    """Join clips into one motion, each turned and moved to go on where the one before it leaves off.

    Part k lasts `lengths[k]` frames; a blend is centred where two parts meet, and moves by `MAX_SHIFT` seconds at most
    to where poses are alike. Clips that reach beyond their part by `blend_margins` lose nothing of it.

    Args:
        clips: (frames, 22, 3) metres each, of one body; at least one.
        fps: frames per second of all clips.
        leads: frames of each clip before its part begins; none unless given.
        lengths: frames of each part; all that follows the lead unless given.
        foot_fix: lock planted feet, also during the blends.

    Returns:
        (frames, 22, 3) metres: as long as all parts together if the clips reach beyond them, else shorter by what the
        blends need.
    """
    if len(clips) == 1:
        return clips[0]
    leads = [0] * len(clips) if leads is None else leads
    lengths = [len(clip) - lead for clip, lead in zip(clips, leads, strict=True)] if lengths is None else lengths
    bones = np.median(np.concatenate([bone_lengths(clip) for clip in clips]), axis=0).astype(np.float32)
    finished: list[FloatArray] = []
    current, offset, boundary = clips[0], 0, 0  # offset: frame of the whole motion at which `current` begins
    for clip, lead, length in zip(clips[1:], leads[1:], lengths, strict=False):
        boundary += length  # counted from the start, so that shifts do not add up
        blend = best_blend(current, clip, fps, end=boundary - offset, start=lead)
        finished.append(blend.joints[: blend.start])
        current, offset = blend.joints[blend.start :], offset + blend.start
    motion = np.concatenate([*finished, current])[: sum(lengths)]
    motion = enforce_bone_lengths(motion, bones)
    return lock_feet(motion, fps) if foot_fix else motion


def blend_margins(fps: float, *, first: bool, last: bool) -> tuple[int, int]:
    """Return the frames that a clip needs before and after its part, so that blends take nothing away from it.

    Args:
        fps: frames per second.
        first, last: whether it is the first or the last part. Nothing is blended before the first. The last reaches
            so far beyond its end that shifts of the blend before it do not shorten the whole.
    """
    shift = round(MAX_SHIFT * fps)
    margin = round((max(BLEND_SECONDS) / 2 + MAX_SHIFT) * fps)
    return 0 if first else margin, 2 * shift if last else margin


def make_loop(joints: FloatArray, fps: float, *, foot_fix: bool = True) -> FloatArray:
    """Cut a clip where its pose recurs and blend its end into its start.

    Pose, height and lean come back exactly in the last frame. Travel and heading go on from round to round unless they
    are small; small ones are removed evenly over the round.

    Args:
        joints: (frames, 22, 3) metres, Y up.
        fps: frames per second.
        foot_fix: lock planted feet, also over the seam.

    Returns:
        (frames', 22, 3) float32 metres, at least half of the frames; canonical (`skeleton.canonicalise`).

    Raises:
        InvalidInputError: fewer than 8 frames.
    """
    if len(joints) < 8:
        raise InvalidInputError(f"a loop needs 8 frames, this clip has {len(joints)}")
    start, end = best_loop(joints, fps)
    loop = _close_loop(_remove_drift(joints[start : end + 1]), fps)
    travel = _RoundTravel.of_loop(loop)
    if foot_fix:
        # lock the feet of three rounds and keep the middle one, whose contacts go on over both seams
        rounds = [loop[:-1], travel.advance(loop[:-1]), travel.advance(travel.advance(loop[:-1]))]
        middle = slice(len(loop) - 1, 2 * (len(loop) - 1))
        locked = lock_feet(np.concatenate(rounds).astype(np.float32), fps).astype(np.float64)[middle]
        loop = travel.rewind(locked)
        loop = np.concatenate([loop, travel.advance(loop[:1])])
    return canonicalise(loop.astype(np.float32))


def canonical_poses(joints: FloatArray) -> Floats:
    """Express every pose in its own facing frame: pelvis above the origin, body facing +Z.

    Args:
        joints: (frames, 22, 3) metres.

    Returns:
        (frames, 22, 3) metres.
    """
    centred = joints - joints[:, :1] * HORIZONTAL
    to_facing = about_axis(1, -facing_angle(joints).astype(np.float64))
    return rotate(to_facing[:, None], centred)


def matching_features(joints: FloatArray, fps: float) -> Floats:
    """Compute the features that two frames are compared by: pose, joint velocities, velocity over the floor.

    Args:
        joints: (frames, 22, 3) metres.
        fps: frames per second.

    Returns:
        (frames, 45, 3) metres in each frame's facing frame; velocities are scaled by `VELOCITY_SECONDS`.
    """
    poses = canonical_poses(joints)
    velocities = np.gradient(poses, axis=0) * fps * VELOCITY_SECONDS
    root_velocity = np.gradient(joints[:, :1].astype(np.float64), axis=0) * fps * VELOCITY_SECONDS
    to_facing = about_axis(1, -facing_angle(joints).astype(np.float64))
    return np.concatenate([poses, velocities, rotate(to_facing[:, None], root_velocity)], axis=1)


def peak_accelerations(joints: Floats, fps: float) -> Floats:
    """Measure the acceleration of the joint that is accelerated most, in each frame but the first and last.

    Args:
        joints: (frames, 22, 3) metres.
        fps: frames per second.

    Returns:
        (frames - 2,) m/s^2; entry k belongs to frame k + 1.
    """
    second = np.diff(np.asarray(joints, dtype=np.float64), n=2, axis=0)
    return np.asarray(np.linalg.norm(second, axis=-1).max(axis=1) * fps**2)


def smoothstep(share: Floats) -> Floats:
    """Ease a share from 0 to 1, with zero slope at both ends: 3 s^2 - 2 s^3."""
    return np.asarray(share * share * (3 - 2 * share))


def best_blend(first: FloatArray, second: FloatArray, fps: float, *, end: int | None = None, start: int = 0) -> Blend:
    """Blend two clips over the shortest of `BLEND_SECONDS` that is `CALM`, or else over the calmest.

    Args:
        first, second: (frames, 22, 3) metres each.
        fps: frames per second of both.
        end: frame of `first` at which its part ends; its last unless given.
        start: frame of `second` at which its part starts.

    Returns:
        The blended motion, in the world frame of `first`.
    """
    end = len(first) if end is None else end
    accelerations = np.concatenate([[0.0], *(peak_accelerations(clip, fps) for clip in (first, second))])
    limit = CALM * float(np.quantile(accelerations, 0.95))
    blends: list[Blend] = []
    for seconds in BLEND_SECONDS:
        window = max(2, min(round(seconds * fps), len(first) // 2, len(second) // 2))
        a, b = best_transition(first, second, window, fps, end=end, start=start)
        blends.append(_blend(first, second, a, b, window, fps))
        if blends[-1].peak_acceleration(fps) <= limit:
            return blends[-1]
    return min(blends, key=lambda blend: blend.peak_acceleration(fps))


def best_transition(
    first: FloatArray, second: FloatArray, window: int, fps: float, *, end: int, start: int
) -> tuple[int, int]:
    """Find frames (a, b) near a boundary: `first[a : a + window]` blends best into `second[b : b + window]`.

    The middle of the window lies within `MAX_SHIFT` seconds of the boundary in both clips, or as near to it as the
    clips reach. The cost is the distance of `matching_features` at both ends of the window.

    Args:
        first, second: (frames, 22, 3) metres each.
        window: frames of the blend.
        fps: frames per second of both.
        end: boundary in `first`.
        start: boundary in `second`.
    """
    first_features, second_features = matching_features(first, fps), matching_features(second, fps)
    shift = round(MAX_SHIFT * fps)
    a = _search_range(end - window // 2, shift, len(first) - window)
    b = _search_range(start - window // 2, shift, len(second) - window)
    cost = np.zeros((len(a), len(b)))
    for edge in (0, window - 1):
        difference = first_features[a + edge][:, None] - second_features[b + edge][None]
        cost += np.linalg.norm(difference, axis=-1).mean(axis=-1)
    row, column = np.unravel_index(np.argmin(cost), cost.shape)
    return int(a[row]), int(b[column])


def _search_range(target: int, shift: int, last: int) -> IntArray:
    """List the frames of 0 .. last that are within `shift` of `target`, or of the nearest frame that there is."""
    nearest = min(max(target, 0), last)
    return np.arange(max(nearest - shift, 0), min(nearest + shift, last) + 1)


def _blend(first: FloatArray, second: FloatArray, a: int, b: int, window: int, fps: float) -> Blend:
    """Blend `first[a : a + window]` into `second[b : b + window]`, with all that comes before and after."""
    end, start = first[a : a + window].astype(np.float64), second[b:].astype(np.float64)
    # align the second clip: same heading and same position over the floor in the middle of the window
    middle = window // 2
    angle = facing_angle(first)[a + middle] - facing_angle(second)[b + middle]
    pivot = start[middle, 0] * HORIZONTAL
    start = rotate(about_axis(1, np.array(float(angle))), start - pivot) + end[middle, 0] * HORIZONTAL
    share = smoothstep((np.arange(window) + 1.0) / (window + 1.0))
    blend = _mix(end, start[:window], share, fps)
    return Blend(np.concatenate([first[:a], blend, start[window:]]).astype(np.float32), a, window)


def _mix(first: Floats, second: Floats, share: Floats, fps: float) -> Floats:
    """Mix two motions (frames, 22, 3) by joint rotations, `share` (frames,) of it the second."""
    motions = rotations_from_positions(first, fps), rotations_from_positions(second, fps)
    offsets = (motions[0].rest_offsets + motions[1].rest_offsets) / 2
    residuals = [
        joints - forward_kinematics(offsets, motion.root, motion.rotations)
        for joints, motion in zip((first, second), motions, strict=True)
    ]
    rotations = slerp(motions[0].rotations, motions[1].rotations, share[:, None])
    share = share[:, None, None]
    root = motions[0].root + share[:, 0] * (motions[1].root - motions[0].root)
    # add back the residual that rigid bones cannot follow, so that nothing jumps where the blend begins and ends
    return forward_kinematics(offsets, root, rotations) + residuals[0] + share * (residuals[1] - residuals[0])


@dataclass(frozen=True)
class _RoundTravel:
    """Rigid transform from one round of a loop to the next: a rotation about Y and a translation over the floor."""

    rotation: Floats
    """(4,) quaternion."""
    start: Floats
    """(3,) metres: the pelvis on the floor plane at the start of the first round."""
    end: Floats
    """(3,) metres: the same at its end."""

    @classmethod
    def of_loop(cls, joints: Floats) -> _RoundTravel:
        """Measure the travel of a motion whose last frame is its first one round later."""
        heading = facing_angle(joints[[0, -1]].astype(np.float32)).astype(np.float64)
        start, end = joints[[0, -1], PELVIS] * HORIZONTAL
        return cls(about_axis(1, np.array(heading[1] - heading[0])), start, end)

    def advance(self, joints: Floats) -> Floats:
        """Move joints one round forward."""
        return rotate(self.rotation, joints - self.start) + self.end

    def rewind(self, joints: Floats) -> Floats:
        """Move joints one round back."""
        return rotate(conjugate(self.rotation), joints - self.end) + self.start


def best_loop(joints: FloatArray, fps: float) -> tuple[int, int]:
    """Find the two frames that match best, with at least `MIN_LOOP` of the clip between them."""
    stride = max(1, min(round(fps / SEARCH_FPS), (len(joints) - 1) // 5))  # six frames at least to choose from
    stride = max(stride, -(-len(joints) // MOST_SEARCHED))  # pairs of frames grow with the square of the length
    features = matching_features(joints, fps)[::stride]
    min_length = max(4, round(MIN_LOOP * len(features)))
    cost = np.full((len(features) - min_length, len(features)), np.inf)
    for start in range(len(cost)):
        difference = features[start + min_length :] - features[start]
        cost[start, start + min_length :] = np.linalg.norm(difference, axis=-1).mean(axis=-1)
    first, last = np.unravel_index(np.argmin(cost), cost.shape)
    return int(first) * stride, int(last) * stride


def _remove_drift(joints: FloatArray) -> Floats:
    """Remove residual drift from a round (frames, 22, 3).

    Subtract net travel below `STAYS` metres and net turn below `STRAIGHT` radians evenly over the loop.
    """
    heading = facing_angle(joints).astype(np.float64)
    progress = np.linspace(0.0, 1.0, len(joints))
    net_turn = heading[-1] - heading[0]
    correction = about_axis(1, -progress * net_turn if abs(net_turn) < STRAIGHT else 0.0 * progress)
    # rotate each step of the pelvis, then add them up to its path
    pelvis = joints[:, PELVIS].astype(np.float64)
    steps = rotate(correction[1:], np.diff(pelvis, axis=0))
    path = pelvis[0] + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    net_travel = (path[-1] - path[0]) * HORIZONTAL
    if np.linalg.norm(net_travel) < STAYS:
        path = path - progress[:, None] * net_travel
    return np.asarray(rotate(correction[:, None], joints - pelvis[:, None]) + path[:, None])


def _close_loop(joints: Floats, fps: float) -> Floats:
    """Lead the end of a round (frames, 22, 3) to its first pose, so that the last frame equals the first.

    What the last pose lacks to the first is added by and by, to a motion that goes on as it did: towards a pose that
    stands still, limbs would brake before the seam. Root rotations are those relative to the heading, so that the body
    keeps turning.
    """
    motion = rotations_from_positions(joints, fps)
    window = max(2, min(len(joints) // 2, round(LOOP_BLEND_SECONDS * fps)))
    share = np.zeros(len(joints))
    share[len(joints) - window :] = smoothstep((np.arange(window) + 1.0) / window)
    heading = about_axis(1, facing_angle(joints.astype(np.float32)).astype(np.float64))
    rotations = motion.rotations.copy()
    rotations[:, 0] = multiply(conjugate(heading), rotations[:, 0])
    lacking = np.broadcast_to(multiply(conjugate(rotations[-1]), rotations[0]), rotations.shape)
    nothing = np.broadcast_to(np.array(IDENTITY), rotations.shape)
    rotations = multiply(rotations, slerp(nothing, lacking, share[:, None]))
    rotations[:, 0] = multiply(heading, rotations[:, 0])
    root = motion.root.copy()
    root[:, 1] += share * (motion.root[0, 1] - motion.root[-1, 1])
    return forward_kinematics(motion.rest_offsets, root, rotations)
