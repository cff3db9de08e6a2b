"""Check constraints together: whether they fit the clip and one another, and whether a person can do them.

What cannot be meant is refused: a time outside the clip, two places for one joint at one moment. What no person can do
is told: the sampler comes as near as it goes, and the clip says by how much it missed.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from kinegraph.arrays import DoubleArray
from kinegraph.constraints import (
    KINDS,
    Constraint,
    EndPose,
    JointTarget,
    Keyframe,
    Loop,
    Path,
    StartPose,
    Waypoint,
    describe,
    latest_moment,
)
from kinegraph.errors import InvalidInputError
from kinegraph.limits import MAX_CONSTRAINTS, MAX_KEYFRAMES
from kinegraph.motion.skeleton import JOINTS, PELVIS
from kinegraph.validation import check_fps, short_repr, whole_number

FASTEST: Final = 4.0
"""Metres per second of the root: a run; the default bundle's people reach 3."""
REACH: Final = 1.2
"""Metres from the root, seen from above, within which a joint can be."""
HIGHEST: Final = 2.5
"""Metres above the floor that a hand reaches."""
SAME: Final = 0.1
"""Metres by which two places for one joint at one moment may differ, for times are rounded to frames."""
_MARGIN: Final = 0.01
"""Metres that a step from frame to frame may be longer, or a target under the floor."""


def check_constraints(
    constraints: object, frames: int, fps: float, *, strict: bool = False
) -> tuple[tuple[Constraint, ...], tuple[str, ...]]:
    """Check constraints of one clip together.

    Args:
        constraints: list or tuple of them, or None.
        frames: of the clip.
        fps: of the clip.
        strict: refuse what a person cannot do.

    Returns:
        The constraints, and a sentence for each thing that a person cannot do.

    Raises:
        InvalidInputError: no list of constraints, more than the limits, a time outside the clip, two that contradict
            each other, or, with `strict`, one that cannot be met. Messages name constraints by place in the list.
    """
    checked = as_constraints(constraints)
    count = whole_number(frames)
    if count is None or count < 1:
        raise InvalidInputError(f"frames must be a whole number from 1 on, not {short_repr(frames)}")
    check_fps(fps)
    for index, constraint in enumerate(checked):
        _check_times(index, constraint, count, fps)
    _check_once(checked)
    keys = [key for index, constraint in enumerate(checked) for key in _joint_keys(index, constraint, count, fps)]
    _check_contradictions(keys, checked)
    notes = (*_out_of_height(checked), *_too_far(keys, checked, fps))
    if strict and notes:
        raise InvalidInputError(f"{notes[0]}; change it, or leave out strict to come as near as it goes")
    return checked, notes


def frame_of(seconds: float, frames: int, fps: float) -> int:
    """Find the frame nearest to a moment of a clip; its end is the last frame."""
    return min(round(seconds * fps), frames - 1)


def as_constraints(constraints: object) -> tuple[Constraint, ...]:
    """Check the type and number of what a caller gives as constraints; None is none of them.

    Raises:
        InvalidInputError: naming what it is.
    """
    if constraints is None:
        return ()
    if isinstance(constraints, KINDS):
        raise InvalidInputError(f"constraints is a list; put the {type(constraints).__name__} into one")
    if not isinstance(constraints, list | tuple):
        raise InvalidInputError(f"constraints is a list of Path, Waypoint and others, not {short_repr(constraints)}")
    if len(constraints) > MAX_CONSTRAINTS:
        raise InvalidInputError(
            f"{len(constraints)} constraints; {MAX_CONSTRAINTS} at most for one clip: a Path stands for many waypoints"
        )
    for index, constraint in enumerate(constraints):
        if not isinstance(constraint, KINDS):
            allowed = ", ".join(kind.__name__ for kind in KINDS)
            raise InvalidInputError(f"constraints[{index}] is {short_repr(constraint)}; it must be one of {allowed}")
    keyframes = sum(isinstance(constraint, Keyframe) for constraint in constraints)
    if keyframes > MAX_KEYFRAMES:
        raise InvalidInputError(f"{keyframes} keyframes; {MAX_KEYFRAMES} at most for one clip")
    return tuple(constraints)


def _check_times(index: int, constraint: Constraint, frames: int, fps: float) -> None:
    """Refuse times after the end of the clip, paths between two frames, and poses longer than the clip.

    Raises:
        InvalidInputError: naming the constraint and the time.
    """
    if isinstance(constraint, StartPose | EndPose):
        length = len(constraint.joints) / (constraint.fps or fps)
        if length > frames / fps:
            raise InvalidInputError(
                f"constraints[{index}], {describe(constraint)}: it lasts {length:g} s, the clip {frames / fps:g} s"
            )
        return
    last = latest_moment(constraint)
    if last > frames / fps + 1e-6:
        raise InvalidInputError(
            f"constraints[{index}], {describe(constraint)}: {last:g} s is after the end of the clip, which has "
            f"{frames / fps:g} s; ask for a longer clip or an earlier time"
        )
    if isinstance(constraint, Path) and not constraint.covers(np.arange(frames) / fps, (frames - 1) / fps).any():
        raise InvalidInputError(
            f"constraints[{index}], {describe(constraint)}: no frame of the clip falls into its times; frames are "
            f"{1 / fps:g} s apart, and the last is at {(frames - 1) / fps:g} s"
        )


def _check_once(constraints: Sequence[Constraint]) -> None:
    """Refuse a second start pose, end pose or loop.

    Raises:
        InvalidInputError: naming the kind.
    """
    counts = Counter(
        type(constraint) for constraint in constraints if isinstance(constraint, StartPose | EndPose | Loop)
    )
    for kind, count in counts.items():
        if count > 1:
            raise InvalidInputError(f"{count} constraints are a {kind.__name__}; a clip has one")


@dataclass(frozen=True)
class _Key:
    """Place of a joint at a frame, NaN where an axis is free; `source` is the constraint's place in the list."""

    source: int
    joint: int
    frame: int
    place: tuple[float, float, float]


def _joint_keys(source: int, constraint: Constraint, frames: int, fps: float) -> list[_Key]:
    """List which joint a constraint wants where, at its first and last frame; a path at all its frames."""
    nan = float("nan")

    def key(joint: int, frame: int, place: DoubleArray | tuple[float, ...]) -> _Key:
        x, y, z = (float(value) for value in place)
        return _Key(source, joint, frame, (x, y, z))

    match constraint:
        case _ if constraint.weight == 0:
            return []
        case Waypoint():
            x, z = constraint.position
            return [key(PELVIS, frame_of(constraint.seconds, frames, fps), (x, nan, z))]
        case Path():
            times, duration = np.arange(frames) / fps, (frames - 1) / fps
            covered = np.flatnonzero(constraint.covers(times, duration))
            places = constraint.positions(times[covered], duration)
            return [key(PELVIS, int(frame), (x, nan, z)) for frame, (x, z) in zip(covered, places, strict=True)]
        case JointTarget():
            place = tuple(nan if value is None else value for value in constraint.position)
            begin, end = (frame_of(moment, frames, fps) for moment in constraint.interval)
            return [key(constraint.index, frame, place) for frame in range(begin, end + 1)]
        case Keyframe() if not constraint.anywhere:
            frame = frame_of(constraint.seconds, frames, fps)
            return [key(joint, frame, constraint.joints[joint]) for joint in range(JOINTS)]
    return []


def _check_contradictions(keys: Sequence[_Key], constraints: Sequence[Constraint]) -> None:
    """Refuse two places for one joint at one frame.

    Raises:
        InvalidInputError: naming both constraints and the distance.
    """
    first: dict[tuple[int, int, int], tuple[float, int]] = {}  # of joint, frame and axis: place and source
    for key in keys:
        for axis, value in enumerate(key.place):
            if math.isnan(value):
                continue
            other, source = first.setdefault((key.joint, key.frame, axis), (value, key.source))
            if source != key.source and abs(other - value) > SAME:
                raise InvalidInputError(
                    f"constraints[{source}], {describe(constraints[source])}, and constraints[{key.source}], "
                    f"{describe(constraints[key.source])}, want one joint at one moment {abs(other - value):.2g} m "
                    "apart; remove one, or give one the weight 0"
                )


def _out_of_height(constraints: Sequence[Constraint]) -> list[str]:
    """Tell which targets lie under the floor or above what a hand reaches."""
    notes = []
    for index, constraint in enumerate(constraints):
        if isinstance(constraint, JointTarget) and constraint.position[1] is not None and constraint.weight:
            height = constraint.position[1]
            if not -_MARGIN <= height <= HIGHEST:
                notes.append(
                    f"constraints[{index}], {describe(constraint)}: a height of {height:g} m is out of reach "
                    f"(0 to {HIGHEST:g} m)"
                )
    return notes


def _too_far(keys: Sequence[_Key], constraints: Sequence[Constraint], fps: float) -> list[str]:
    """Tell which targets are farther apart than a person runs in the time between, the start at the origin first.

    A target of the pelvis is where the root is; one of another joint is within `REACH` of it.
    """
    stops = [(0, SAME, (0.0, 0.0), -1)]
    for key in sorted(keys, key=lambda key: key.frame):
        x, _, z = key.place
        if not math.isnan(x + z):
            stops.append((key.frame, 0.0 if key.joint == PELVIS else REACH, (x, z), key.source))
    notes: dict[int, str] = {}
    for (before, slack, start, earlier), (after, reach, end, source) in pairwise(stops):
        distance, seconds = math.dist(start, end), (after - before) / fps
        if distance > slack + reach + FASTEST * seconds + _MARGIN:
            where = "the origin, where clips start," if earlier < 0 else "where the person has to be"
            notes.setdefault(
                source,
                f"constraints[{source}], {describe(constraints[source])}: it is {distance:.2g} m from {where} "
                f"{seconds:.2g} s earlier, and nobody is faster than {FASTEST:g} m/s",
            )
    return list(notes.values())
