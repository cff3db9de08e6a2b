"""The energy of constraints: one term for each, of the joints of a clip, in the sum of EnergyMoGen's Eq. 6-8.

Each term is 1/2 of the mean squared miss of its constraint, times its weight: a pose at one moment and a path of all
frames count alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

import numpy as np

from kinegraph.arrays import DoubleArray, Floats
from kinegraph.constraints import Constraint, EndPose, JointTarget, Keyframe, Loop, Path, StartPose, Waypoint
from kinegraph.feasibility import frame_of
from kinegraph.motion.body_frame import BodyFrame
from kinegraph.motion.energies import Energy, heading_energy, loop_energy, pose_energy, position_energy
from kinegraph.motion.skeleton import JOINTS, PELVIS

Term = Callable[[Floats], Energy]
"""Joints (frames, 22, 3) -> energy and gradient."""

HEADING_WEIGHT: Final = 0.1
"""m^2: an error of the heading of 0.1 rad (6 degrees) costs as much as 3 cm."""
VELOCITY_WEIGHT: Final = 4.0
"""Weight of the steps between the frames of a start or end pose, against that of the frames."""
SEAM_WEIGHT: Final = 2.0
"""Weight of the step between a start or end pose and the rest of the clip, against that of the frames of the pose."""
LEAD_SECONDS: Final = 0.25
"""Deviation of the Gaussian window in which the motion leads up to a joint's target and away from it."""
LEAD_WEIGHT: Final = 0.05
"""Weight of a frame in the middle of that window, against that of the moment itself."""


def constraint_terms(
    constraints: Sequence[Constraint], frames: int, fps: float, *, leading: bool = False
) -> tuple[Term, ...]:
    """Make the energy of each constraint whose weight is above 0.

    Args:
        constraints: checked by `feasibility.check_constraints`.
        frames: of the clip.
        fps: of the clip.
        leading: let joints be near their targets in a soft window around the moment, too: so the motion leads up to it.
    """
    return tuple(_term(constraint, frames, fps, leading) for constraint in constraints if constraint.weight > 0)


def seam_terms(constraints: Sequence[Constraint], frames: int, fps: float) -> tuple[Term, ...]:
    """Make the energies of the steps out of start poses and into end poses: the velocity of the pose goes on there.

    1/2 w |step of the clip - step of the pose beside it|^2. Few motions are without it, so it is no part of what is
    wanted (`constraint_terms`).

    Args:
        constraints, frames, fps: see `constraint_terms`.
    """
    terms: list[Term] = []
    for constraint in constraints:
        if not isinstance(constraint, StartPose | EndPose) or constraint.weight <= 0:
            continue
        poses = constraint.frames(fps).astype(np.float64)
        if not 1 < len(poses) < frames:
            continue
        if isinstance(constraint, StartPose):
            first, anchor, steps = len(poses) - 1, 0, np.stack([poses[-1], 2 * poses[-1] - poses[-2]])
        else:
            first, anchor, steps = frames - len(poses) - 1, frames - 1, np.stack([2 * poses[0] - poses[1], poses[0]])
        weight = np.full(1, SEAM_WEIGHT * constraint.weight / JOINTS)
        terms.append(partial(pose_energy, pose=steps, first=first, anchor=anchor, weight=np.zeros(2), steps=weight))
    return tuple(terms)


def total_energy(terms: Sequence[Term], joints: Floats) -> Energy:
    """Add up energies and gradients."""
    total, gradient = 0.0, np.zeros(joints.shape)
    for term in terms:
        energy, slope = term(joints)
        total += energy
        gradient += slope
    return total, gradient


def _term(constraint: Constraint, frames: int, fps: float, leading: bool) -> Term:
    weight = constraint.weight
    match constraint:
        case Path():
            return _path_term(constraint, frames, fps)
        case Waypoint():
            return _waypoint_term(constraint, frames, fps)
        case JointTarget():
            return _joint_term(constraint, frames, fps, leading)
        case Keyframe():
            frame = frame_of(constraint.seconds, frames, fps)
            pose = constraint.joints.astype(np.float64)
            if constraint.anywhere:
                placed = BodyFrame.of(pose).to_body(pose)[None]
                share = np.full(1, weight / JOINTS)
                return lambda joints: pose_energy(joints, placed, frame, frame, share, np.zeros(0))
            target, weights = np.zeros((frames, JOINTS, 3)), np.zeros((frames, JOINTS, 3))
            target[frame], weights[frame] = pose, weight / JOINTS
            return lambda joints: position_energy(joints, target, weights)
        case StartPose():
            poses = constraint.frames(fps).astype(np.float64)
            share = np.full(len(poses), weight / (JOINTS * len(poses)))
            return lambda joints: pose_energy(joints, poses, 0, 0, share, VELOCITY_WEIGHT * share[1:])
        case EndPose():
            poses = constraint.frames(fps).astype(np.float64)
            share = np.full(len(poses), weight / (JOINTS * len(poses)))
            steps = VELOCITY_WEIGHT * share[1:]
            return lambda joints: pose_energy(joints, poses, frames - len(poses), frames - 1, share, steps)
        case Loop():
            return lambda joints: loop_energy(joints, weight / JOINTS, VELOCITY_WEIGHT)


def _path_term(path: Path, frames: int, fps: float) -> Term:
    times, duration = np.arange(frames) / fps, (frames - 1) / fps
    covered = path.covers(times, duration)
    share = path.weight * covered / max(covered.sum(), 1.0)
    target, weights = np.zeros((frames, JOINTS, 3)), np.zeros((frames, JOINTS, 3))
    target[:, PELVIS, [0, 2]] = path.positions(times, duration)
    weights[:, PELVIS, [0, 2]] = share[:, None]
    return _with_heading(target, weights, path.headings(times, duration), share)


def _waypoint_term(waypoint: Waypoint, frames: int, fps: float) -> Term:
    frame = frame_of(waypoint.seconds, frames, fps)
    target, weights = np.zeros((frames, JOINTS, 3)), np.zeros((frames, JOINTS, 3))
    target[frame, PELVIS, [0, 2]] = waypoint.position
    weights[frame, PELVIS, [0, 2]] = waypoint.weight
    if waypoint.heading is None:
        return lambda joints: position_energy(joints, target, weights)
    share = np.zeros(frames)
    share[frame] = waypoint.weight
    return _with_heading(target, weights, np.full(frames, np.radians(waypoint.heading)), share)


def _with_heading(target: Floats, weights: Floats, angle: DoubleArray | None, share: Floats) -> Term:
    if angle is None:
        return lambda joints: position_energy(joints, target, weights)

    def term(joints: Floats) -> Energy:
        place, slope = position_energy(joints, target, weights)
        heading, turn = heading_energy(joints, angle, HEADING_WEIGHT * share)
        return place + heading, slope + turn

    return term


def _joint_term(wanted: JointTarget, frames: int, fps: float, leading: bool) -> Term:
    begin, end = (frame_of(moment, frames, fps) for moment in wanted.interval)
    axes = [axis for axis, value in enumerate(wanted.position) if value is not None]
    target, weights = np.zeros((frames, JOINTS, 3)), np.zeros((frames, JOINTS, 3))
    target[:, wanted.index, axes] = [wanted.position[axis] for axis in axes]
    share = np.zeros(frames)
    share[begin : end + 1] = wanted.weight / (end + 1 - begin)
    if leading:
        beside = np.maximum(np.maximum(begin - np.arange(frames), np.arange(frames) - end), 0) / (LEAD_SECONDS * fps)
        share = np.maximum(share, wanted.weight * LEAD_WEIGHT * np.exp(-0.5 * beside**2))
    weights[:, wanted.index, axes] = share[:, None]
    return lambda joints: position_energy(joints, target, weights)
