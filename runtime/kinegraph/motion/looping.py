"""A clip without a seam: its last frame is its first again, but for travel, which goes on from round to round."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.errors import InvalidInputError
from kinegraph.motion.feet import planted_feet
from kinegraph.motion.placement import placed
from kinegraph.motion.poses import OVER_FLOOR, smoothstep, states
from kinegraph.motion.quaternions import about_axis, conjugate, multiply, rotate, slerp
from kinegraph.motion.rotations import forward_kinematics, solve_rotations
from kinegraph.motion.skeleton import PELVIS, FloatArray, facing_angle

Floats = NDArray[np.floating[Any]]

SHORTEST: Final = 0.5
"""Share of a clip that a loop keeps at least."""
BLEND_SECONDS: Final = 0.5
"""In which the end of a loop turns into its beginning."""
COMPARED_FPS: Final = 20.0
"""Frames per second of which ends are looked for."""
STAYS: Final = 0.15
"""Metres: a body that has moved less than this in a round is meant to stay."""
STRAIGHT: Final = 0.35
"""Radians: a body that has turned less than this in a round is meant to go straight on."""


def looped(joints: FloatArray, fps: float, *, foot_fix: bool = True) -> FloatArray:
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
        held = planted_feet(np.concatenate(rounds).astype(np.float32), fps).astype(np.float64)[middle]
        whole = travel.back(held)
        whole = np.concatenate([whole, travel.on(whole[:1])])
    return placed(whole.astype(np.float32))


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
    motion = solve_rotations(joints, fps)
    window = max(2, min(len(joints) // 2, round(BLEND_SECONDS * fps)))
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
