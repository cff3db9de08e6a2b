"""Features that are known before a motion is: poses at some frames, steps between them, and where the root comes by.

A row of `features` is a pose in its own facing frame, and the step from there to the next frame. So poses that are
known say height and local positions, and two that follow one another say a step: velocities and contacts. Where a pose
is, no row says. With v_t the root velocity of row t and R_t the turn by its heading:

    heading_k = sum_{t<k} yaw_t        place_k = sum_{t<k} R_t v_t

A sum that is known is held by moving its free terms by the least that makes it come out (`lead_root`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import DoubleArray, FloatArray, Floats
from kinegraph.motion.features import (
    CONTACTS,
    HEIGHT,
    POSITIONS,
    ROOT_VELOCITY,
    VELOCITIES,
    WIDTH,
    YAW_VELOCITY,
    features_from_joints,
)
from kinegraph.motion.skeleton import FEET, JOINTS, PELVIS, facing_angle

WHOLE_BODY: Final = tuple(range(JOINTS))


@dataclass(frozen=True)
class Anchor:
    """Where the root is at a frame, in the frame of the clip's beginning."""

    frame: int
    position: tuple[float, float]
    """Metres, x and z."""
    heading: float | None
    """Radians from +Z towards +X; None is free."""

    @classmethod
    def of(cls, pose: Floats, frame: int) -> Anchor:
        """Take place and heading of a pose (22, 3) at a frame."""
        x, _, z = pose[PELVIS]
        return cls(frame, (float(x), float(z)), float(facing_angle(pose[None].astype(np.float32))[0]))


@dataclass(frozen=True)
class KnownFeatures:
    """What is known of the features of a motion, in the layout joints-137."""

    values: FloatArray
    """(frames, 137), not normalised; anything where nothing is known."""
    known: NDArray[np.bool_]
    """(frames, 137)."""
    anchors: tuple[Anchor, ...] = ()

    @classmethod
    def nothing(cls, frames: int) -> KnownFeatures:
        """Know nothing of a motion of so many frames."""
        return cls(np.zeros((frames, WIDTH), dtype=np.float32), np.zeros((frames, WIDTH), dtype=np.bool_))

    def with_poses(
        self, joints: Floats, first: int, of: Collection[int] = WHOLE_BODY, *, moving: bool = True
    ) -> KnownFeatures:
        """Know poses of consecutive frames besides; they go before what was known there.

        Args:
            joints: (n, 22, 3) metres; place and heading of the first count for nothing.
            first: frame of the first.
            of: joints that are known of them.
            moving: whether the n - 1 steps between them are known, too. Steps are those in the world: of an arm that
                comes along with a body nobody knows yet, they are not.
        """
        poses = np.asarray(joints, dtype=np.float32)
        rows = features_from_joints(poses if len(poses) > 1 else np.repeat(poses, 2, axis=0))[: len(poses)]
        span = slice(first, first + len(poses))
        said = np.repeat(columns_of_poses(of)[None], len(poses), axis=0)
        if moving:
            said[:-1] |= columns_of_steps(of)
        values, known = self.values.copy(), self.known.copy()
        values[span] = np.where(said, rows, values[span])
        known[span] |= said
        return replace(self, values=values, known=known)

    def with_anchor(self, anchor: Anchor) -> KnownFeatures:
        """Know besides where the root is at a frame, in place of what was known there."""
        others = [each for each in self.anchors if each.frame != anchor.frame]
        return replace(self, anchors=tuple(sorted([*others, anchor], key=lambda each: each.frame)))

    @property
    def free_steps(self) -> NDArray[np.bool_]:
        """Tell from which frames the step of the root is free: (frames,)."""
        return np.asarray(~self.known[:, ROOT_VELOCITY.start])


def columns_of_poses(joints: Collection[int]) -> NDArray[np.bool_]:
    """Mark the columns that say where joints are in the frame of their body: (137,); of the pelvis, its height."""
    row = np.zeros(WIDTH, dtype=np.bool_)
    row[HEIGHT] = PELVIS in joints
    for joint in joints:
        if joint != PELVIS:
            row[POSITIONS.start + 3 * (joint - 1) : POSITIONS.start + 3 * joint] = True
    return row


def columns_of_steps(joints: Collection[int]) -> NDArray[np.bool_]:
    """Mark the columns that say how joints go to the next frame: (137,); of the pelvis, the body's turn and way."""
    row = np.zeros(WIDTH, dtype=np.bool_)
    if PELVIS in joints:
        row[YAW_VELOCITY] = row[ROOT_VELOCITY] = True
    for joint in joints:
        row[VELOCITIES.start + 3 * joint : VELOCITIES.start + 3 * (joint + 1)] = True
    row[CONTACTS] = [foot in joints for foot in FEET]
    return row


def lead_root(features: Floats, free: NDArray[np.bool_], anchors: Sequence[Anchor]) -> DoubleArray:
    """Lead the root through anchors, by the least change of the steps that are free.

    From one anchor to the next, yaw velocities change alike, and then the root velocities by one vector of the world:
    both are the change of least sum of squares, so that a motion which comes by already stays as it is. An anchor
    behind no free step stays missed.

    Args:
        features: (frames, 137), not normalised.
        free: (frames,) whether the step from a frame may change.
        anchors: in the order of their frames.

    Returns:
        (frames, 137). The velocities of all joints change with that of the root.

    Source: the projection of DDNM (Wang et al., 2023, Alg. 1) on the sums above, headings first.
    """
    led = np.array(features, dtype=np.float64)
    start, heading, place = 0, 0.0, np.zeros(2)
    for anchor in anchors:
        steps = start + np.flatnonzero(free[start : anchor.frame])
        span, start = slice(start, anchor.frame), anchor.frame
        if len(steps) and anchor.heading is not None:
            turn = anchor.heading - heading - led[span, 0].sum()
            led[steps, YAW_VELOCITY] += ((turn + np.pi) % (2 * np.pi) - np.pi) / len(steps)
        headings = heading + np.concatenate([[0.0], np.cumsum(led[span, 0])])
        cos, sin = np.cos(headings[:-1]), np.sin(headings[:-1])
        left, forward = led[span, ROOT_VELOCITY].T
        reached = place + np.array([(cos * left + sin * forward).sum(), (cos * forward - sin * left).sum()])
        if len(steps):
            x, z = (np.array(anchor.position) - reached) / len(steps)
            change = np.stack([cos * x - sin * z, sin * x + cos * z], axis=-1)[steps - span.start]
            led[steps, ROOT_VELOCITY] += change
            for axis in (0, 1):
                led[steps, VELOCITIES.start + 2 * axis : VELOCITIES.stop : 3] += change[:, axis : axis + 1]
            reached = np.array(anchor.position)
        heading, place = float(headings[-1]), reached
    return led
