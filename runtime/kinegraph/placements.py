"""Where constraints want the joints of a given motion, and how far it is from that.

Constraints that hold wherever on the floor a person is (`EndPose`, `Loop`, `Keyframe(anywhere=True)`) are placed where
the motion is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import DoubleArray, Floats
from kinegraph.constraints import (
    Constraint,
    EndPose,
    JointTarget,
    Keyframe,
    Loop,
    Miss,
    Path,
    StartPose,
    Waypoint,
    describe,
)
from kinegraph.feasibility import frame_of
from kinegraph.motion.body_frame import BodyFrame
from kinegraph.motion.reaching import Pins
from kinegraph.motion.skeleton import PELVIS, facing_angle


def pins_of(constraints: Sequence[Constraint], joints: Floats, fps: float) -> Pins:
    """Collect the places that constraints of a weight above 0 want joints of a motion to be at.

    Args:
        constraints: checked by `feasibility.check_constraints`; where two want one joint, the later one counts.
        joints: (frames, 22, 3) metres.
        fps: frames per second.
    """
    target, wanted = np.zeros(joints.shape), np.zeros(joints.shape, dtype=np.bool_)
    certain = wanted.copy()
    for constraint in constraints:
        if constraint.weight > 0:
            places, axes = wanted_places(constraint, joints, fps)
            target[axes], wanted[axes] = places[axes], True
            certain[axes] = isinstance(constraint, StartPose)  # of a body above the origin, as every clip begins
    return Pins(target, wanted, certain)


def misses_of(constraints: Sequence[Constraint], joints: Floats, fps: float) -> tuple[Miss, ...]:
    """Measure how far a motion is from each constraint, in the order given."""
    return tuple(_miss(constraint, joints, fps) for constraint in constraints)


def wanted_places(constraint: Constraint, joints: Floats, fps: float) -> tuple[DoubleArray, NDArray[np.bool_]]:
    """Tell where one constraint wants joints of a motion: (frames, 22, 3) metres, and at which axes."""
    frames = len(joints)
    places, axes = np.zeros(joints.shape), np.zeros(joints.shape, dtype=np.bool_)
    match constraint:
        case Path():
            times, duration = np.arange(frames) / fps, (frames - 1) / fps
            places[:, PELVIS, [0, 2]] = constraint.positions(times, duration)
            axes[:, PELVIS, [0, 2]] = (constraint.covers(times, duration) > 0)[:, None]
        case Waypoint():
            frame = frame_of(constraint.seconds, frames, fps)
            places[frame, PELVIS, [0, 2]] = constraint.position
            axes[frame, PELVIS, [0, 2]] = True
        case JointTarget():
            begin, end = (frame_of(moment, frames, fps) for moment in constraint.interval)
            for axis, value in enumerate(constraint.position):
                if value is not None:
                    places[begin : end + 1, constraint.index, axis] = value
                    axes[begin : end + 1, constraint.index, axis] = True
        case Keyframe():
            frame = frame_of(constraint.seconds, frames, fps)
            pose = constraint.joints.astype(np.float64)
            if constraint.anywhere:
                pose = BodyFrame.of(joints[frame]).to_world(BodyFrame.of(pose).to_body(pose))
            places[frame] = pose
            axes[frame] = True
        case StartPose():
            poses = constraint.frames(fps).astype(np.float64)
            places[: len(poses)], axes[: len(poses)] = poses, True
        case EndPose():
            poses = constraint.frames(fps).astype(np.float64)
            places[-len(poses) :], axes[-len(poses) :] = BodyFrame.of(joints[-1]).to_world(poses), True
        case Loop():
            first = BodyFrame.of(joints[0]).to_body(joints[:2])
            steps = np.stack([2 * first[0] - first[1], first[0]])  # the step into the end is that out of the start
            places[-2:], axes[-2:] = BodyFrame.of(joints[-1]).to_world(steps), True
    return places, axes


def _miss(constraint: Constraint, joints: Floats, fps: float) -> Miss:
    places, axes = wanted_places(constraint, joints, fps)
    if isinstance(constraint, Loop):
        axes[-2] = False  # the step counts for the correction; the miss is that of the pose
    distance = np.linalg.norm(np.where(axes, joints - places, 0.0), axis=-1)[axes.any(axis=-1)]
    degrees = _missed_degrees(constraint, joints, fps)
    return Miss(describe(constraint), float(distance.mean()), float(distance.max()), degrees)


def _missed_degrees(constraint: Constraint, joints: Floats, fps: float) -> float | None:
    """Measure the mean error of the heading, if the constraint names one."""
    frames = len(joints)
    if isinstance(constraint, Waypoint) and constraint.heading is not None:
        at = np.zeros(frames, dtype=np.bool_)
        at[frame_of(constraint.seconds, frames, fps)] = True
        wanted: DoubleArray | None = np.full(frames, np.radians(constraint.heading))
    elif isinstance(constraint, Path):
        times, duration = np.arange(frames) / fps, (frames - 1) / fps
        at, wanted = constraint.covers(times, duration) > 0, constraint.headings(times, duration)
    else:
        return None
    if wanted is None:
        return None
    off = facing_angle(joints.astype(np.float32)) - wanted
    return float(np.degrees(np.abs((off + np.pi) % (2 * np.pi) - np.pi)[at].mean()))
