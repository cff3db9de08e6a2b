"""Arms kept out of a stout body: elbows, forearms and hands are pushed out of the trunk and the thighs.

A point q of an arm is taken back to the rest pose of the trunk (the mean of where pelvis and chest have it, by height,
as linear blend skinning does) or of a thigh. There, a point within a section of `BodyShape` is pushed away from the
middle of the section by

    push(s) = -s                                 for s <= -SOFT,
              (SOFT - s)^2 / (4 SOFT)            for s between,
              0                                  for s >= SOFT

with s the distance to the surface, negative inside: once continuously differentiable, so that what moves smoothly
stays smooth. Bones swing and keep their length: the upper arm for the elbow, the forearm for what is below.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from kinegraph.arrays import Floats
from kinegraph.motion.body_shape import BodyShape
from kinegraph.motion.quaternions import normalised, rotate, to_matrix

SOFT: Final = 0.015
"""Metres from the surface within which the push sets in."""
ROUNDS: Final = 3
"""Of pushing and restoring lengths."""
FADE: Final = 0.06
"""Metres of height over which the push of the trunk sets in at its ends."""
DEEP: Final = (0.1, 0.4)
"""Shares of a section's radius between which the push sets in: nearer the middle no side is nearer than the other."""
ALONG: Final = np.array([0.0, 0.5, 1.0])
"""Elbow, middle of the forearm and wrist; the palm comes after them."""

Push = Callable[[Floats], Floats]
"""Points (frames, n, 3) -> displacements, all relative to the pelvis."""


@dataclass(frozen=True, eq=False)
class Segment:
    """A part of the body that moves rigidly: x at rest is at `at` + turn (x - rest)."""

    rest: Floats
    """(3,) metres: a point of it at rest."""
    at: Floats
    """(frames, 3) metres: the same point in each frame."""
    turn: Floats
    """(frames, 4) quaternions."""

    @cached_property
    def matrices(self) -> Floats:
        """(frames, 3, 3) of `turn`."""
        return to_matrix(self.turn)

    def point(self, rest: Floats) -> Floats:
        """Locate a point (3,) of the segment in each frame: (frames, 3)."""
        return self.at + rotate(self.turn, rest - self.rest)

    def back(self, points: Floats) -> Floats:
        """Take points (frames, n, 3) to where they are at rest."""
        return np.asarray((points - self.at[:, None]) @ self.matrices + self.rest)

    def turned(self, vectors: Floats) -> Floats:
        """Turn vectors (frames, n, 3) at rest as the segment is turned."""
        return np.asarray(vectors @ self.matrices.transpose(0, 2, 1))


def push_of_trunk(shape: BodyShape, pelvis: Segment, chest: Segment) -> Push:
    """Build the push of the trunk, for arms of the shape's own radius."""
    heights, low, high = shape.heights, pelvis.rest[1], chest.rest[1]
    bottom, top = heights[0] - FADE, heights[-1] + FADE

    def push(points: Floats) -> Floats:
        lower, upper = pelvis.back(points), chest.back(points)
        share = _smooth(((lower[..., 1] + upper[..., 1]) / 2 - low) / max(high - low, 1e-6))[..., None]
        inside = (1.0 - share) * lower + share * upper
        y = inside[..., 1]
        radii = [np.interp(y, heights, half) + shape.forearm for half in (shape.half_widths, shape.half_depths)]
        from_middle = inside * (1.0, 0.0, 1.0)
        from_middle[..., 2] -= np.interp(y, heights, shape.depths)
        depth = np.hypot(from_middle[..., 0] / radii[0], from_middle[..., 2] / radii[1])
        window = _smooth((y - bottom) / FADE) * _smooth((top - y) / FADE)
        moved = _radial(from_middle, depth) * window[..., None]
        return pelvis.turned((1.0 - share) * moved) + chest.turned(share * moved)

    return push


def push_of_thigh(radii: Floats, forearm: float, thigh: Segment, knee: Floats) -> Push:
    """Build the push of a thigh.

    Args:
        radii: (n,) from hip to knee.
        forearm: radius of the arm.
        thigh: with the hip as its point.
        knee: (3,) at rest.
    """
    bone = knee - thigh.rest
    places = (np.arange(len(radii)) + 0.5) / len(radii)

    def push(points: Floats) -> Floats:
        from_hip = thigh.back(points) - thigh.rest
        along = from_hip @ bone / max(float(bone @ bone), 1e-12)
        from_middle = from_hip - along[..., None] * bone
        depth = np.linalg.norm(from_middle, axis=-1) / (np.interp(along, places, radii) + forearm)
        window = _smooth(along / 0.2) * _smooth((1.0 - along) / 0.2)
        return thigh.turned(_radial(from_middle, depth) * window[..., None])

    return push


def clear_arms(
    pushes: Sequence[Push], shoulders: Floats, elbows: Floats, wrists: Floats, palms: Floats
) -> tuple[Floats, Floats]:
    """Swing arms out of the body.

    Args:
        pushes: of the parts of the body.
        shoulders, elbows, wrists, palms: (frames, arms, 3) metres relative to the pelvis; palms move with forearms.

    Returns:
        New elbows and wrists, (frames, arms, 3) each; those of arms that are clear are as they were.
    """
    upper, lower = (np.linalg.norm(bone, axis=-1, keepdims=True) for bone in (elbows - shoulders, wrists - elbows))
    # palms count as points on the lines through the forearms, at multiples of their lengths
    beyond = np.linalg.norm(palms[0] - elbows[0], axis=-1) / np.maximum(lower[0, :, 0], 1e-9)
    shares = np.stack([*np.broadcast_to(ALONG[:, None], (len(ALONG), len(beyond))), np.maximum(beyond, 1.0)], axis=-1)
    shares = shares[..., None]
    for _ in range(ROUNDS):
        points = elbows[:, :, None] + shares * (wrists - elbows)[:, :, None]
        flat = points.reshape(len(points), -1, 3)
        moved = np.sum([push(flat) for push in pushes], axis=0).reshape(points.shape)
        if not moved.any():
            break
        of_forearm = moved[:, :, 1:] / shares[:, 1:]
        strongest = (of_forearm * of_forearm).sum(-1).argmax(axis=-1)
        of_wrist = np.take_along_axis(of_forearm, strongest[..., None, None], axis=2)[:, :, 0]
        out = shoulders + upper * normalised(elbows + moved[:, :, 0] - shoulders)
        # the forearm is carried along; only what that leaves is its own
        direction = normalised(of_wrist)
        left = np.maximum(((of_wrist - (out - elbows)) * direction).sum(-1, keepdims=True), 0.0)
        wrists = out + lower * normalised(wrists - elbows + left * direction)
        elbows = out
    return elbows, wrists


def _radial(from_middle: Floats, depth: Floats) -> Floats:
    """Push points away from the middle of their section.

    Args:
        from_middle: (..., 3) metres.
        depth: (...) distance in shares of the section's radius: 1 on the surface.
    """
    distance = np.sqrt((from_middle * from_middle).sum(-1))
    inside = np.maximum(depth, 1e-6)
    to_surface = distance * (1.0 - 1.0 / inside)
    push = np.where(to_surface <= -SOFT, -to_surface, np.maximum(SOFT - to_surface, 0.0) ** 2 / (4 * SOFT))
    push = push * _smooth((depth - DEEP[0]) / (DEEP[1] - DEEP[0]))
    return np.asarray(from_middle * (push / np.maximum(distance, 1e-9))[..., None])


def _smooth(share: Floats) -> Floats:
    """Rise from 0 at 0 to 1 at 1 (smoothstep)."""
    share = np.clip(share, 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))
