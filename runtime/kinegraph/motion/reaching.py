"""Close the last centimetres to where joints have to be: a smooth displacement, rigid bones, planted feet.

A latent comes within a centimetre or two of what constraints want. `reach` closes the rest in the joints themselves:

1. the whole body moves over the floor by a smoothing spline (Reinsch, 1967) through what the pelvis misses;
2. planted feet are locked where they now stand, or have to stand (`postprocess.lock_feet`);
3. pelvis, hips and the lowest vertebra move together by what the pelvis still misses, other joints by splines through
   what they miss; the body follows by position-based dynamics (Müller et al., 2007) with rigid bones, in rounds that
   aim past the target by what the round before missed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import DoubleArray, FloatArray, Floats
from kinegraph.motion.postprocess import bend_to_lengths, lock_feet, sliding_speed
from kinegraph.motion.skeleton import JOINT_INDEX, LEFT_HIP, PELVIS, RIGHT_HIP

METRES_PER_ACCELERATION: Final = 0.02
"""Metres of displacement that cost as much as an acceleration of 1 m/s^2: it comes and goes within about half a second.

Acceleration and not jerk: beyond the last frames of a start pose a displacement keeps its velocity, which fades. A path
of least jerk kept its acceleration, too; that of frames that are missed by millimetres is noise, and threw hips 6 cm.
"""
SLACK: Final = 0.01
"""Metres off its path that cost a body as much as an acceleration of 1 m/s^2: it cuts corners, not its pelvis."""
FOOT_METRES_PER_JERK: Final = 5e-4
"""Of feet beside their contacts, eight times that of clips without constraints: these feet slide further."""
PELVIC: Final = (PELVIS, LEFT_HIP, RIGHT_HIP, JOINT_INDEX["spine1"])
"""Joints that move as one when the pelvis has to be elsewhere: alone it would tilt, 6 degrees for each centimetre."""
ROUNDS: Final = 8
"""Rounds of aiming at what joints still miss."""
SWEEPS: Final = 10
"""Iterations of position-based dynamics in a round."""
NEGLIGIBLE: Final = 5e-4
"""Metres: a joint that is displaced by less is free."""
MAX_PAST: Final = 0.02
"""Metres by which a round aims further past a target: what is out of reach must not wind up."""
MAX_REACH: Final = 0.2
"""Metres by which a correction moves a joint at most along an axis: what is further off is missed, and told."""


@dataclass(frozen=True)
class Pins:
    """Places that joints have to be at."""

    target: DoubleArray
    """(frames, 22, 3) metres; anything where nothing is wanted."""
    wanted: NDArray[np.bool_]
    """(frames, 22, 3), for each axis."""
    certain: NDArray[np.bool_] | None = None
    """(frames, 22, 3), where a body is known to have been there, so that no distance is too far (`MAX_REACH`)."""

    def missed(self, joints: Floats) -> DoubleArray:
        """Measure what is left to each place, as far as it may be closed: (frames, 22, 3), 0 where none is wanted."""
        missed = np.where(self.wanted, self.target - joints, 0.0)
        bounded = np.clip(missed, -MAX_REACH, MAX_REACH)
        return np.asarray(bounded if self.certain is None else np.where(self.certain, missed, bounded))


def reach(joints: Floats, pins: Pins, lengths: FloatArray, fps: float, *, foot_fix: bool) -> FloatArray:
    """Move a motion so that its joints are where they have to be, as far as bones allow.

    Args:
        joints: (frames, 22, 3) metres, with rigid bones.
        pins: where joints have to be.
        lengths: (21,) metres of the bones (`skeleton.bone_lengths`).
        fps: frames per second.
        foot_fix: lock planted feet.

    Returns:
        (frames, 22, 3) float32 metres, with these bones.
    """
    moved = joints.astype(np.float64) + _root_displacement(joints, pins, fps)[:, None]
    if foot_fix:
        aims = np.where(pins.wanted, pins.target, np.nan)
        speed = sliding_speed(moved, fps)
        moved = lock_feet(moved.astype(np.float32), fps, aims, speed, FOOT_METRES_PER_JERK).astype(np.float64)
    displacement = _joint_displacements(moved, pins, fps)
    displaced = np.abs(displacement).max(axis=-1) > NEGLIGIBLE
    far = (np.abs(pins.missed(moved)) > NEGLIGIBLE).any(axis=-1)
    at = (displaced | far).any(axis=1)
    if at.any():
        wanted = pins.wanted[at]
        held = wanted | displaced[at, :, None]
        held[:, PELVIS, [0, 2]] = True  # a hand does not move the body over the floor
        held[:, PELVIC] |= wanted[:, [PELVIS]]
        moved[at] = _pull(moved[at], moved[at] + displacement[at], wanted, held, lengths)
    return moved.astype(np.float32)


def smooth_field(known: Floats, at: NDArray[np.bool_], fps: float, slack: float = 0.0) -> DoubleArray:
    """Fill in displacements between the frames where they are known, and let them fade away beside.

    s minimises sum |D^2 s|^2 + (s / `METRES_PER_ACCELERATION`)^2, with D^2 the second derivative and s as known at its
    frames: a natural cubic spline (Holladay, 1957) that fades. With a slack, ((s - known) / slack)^2 is added there
    instead: a smoothing spline (Reinsch, 1967).

    Args:
        known: (frames, n); only the rows at `at` count.
        at: (frames,) where it is known.
        fps: frames per second.
        slack: metres off a known displacement that cost as much as an acceleration of 1 m/s^2; 0 is none.

    Returns:
        (frames, n).
    """
    field = np.where(at[:, None], known, 0.0)
    free = ~at
    if not at.any() or not (free.any() or slack):
        return field
    second = np.diff(np.eye(len(at)), n=2, axis=0) * fps**2
    if slack:
        pull = np.where(at, slack**-2, METRES_PER_ACCELERATION**-2)
        return np.asarray(np.linalg.solve(second.T @ second + np.diag(pull), pull[:, None] * field))
    unknown = second[:, free]
    normal = unknown.T @ unknown + np.eye(int(free.sum())) / METRES_PER_ACCELERATION**2
    field[free] = -np.linalg.solve(normal, unknown.T @ (second[:, at] @ field[at]))
    return field


def _root_displacement(joints: Floats, pins: Pins, fps: float) -> DoubleArray:
    """Compute the displacement (frames, 3) of the body over the floor; the start of the clip stays at the origin."""
    displacement = np.zeros((len(joints), 3))
    for axis in (0, 2):
        at = pins.wanted[:, PELVIS, axis].copy()
        if not at.any():
            continue
        missed = pins.missed(joints)[:, PELVIS, axis]
        if not at[0]:
            at[0] = True
        displacement[:, axis] = smooth_field(missed[:, None], at, fps, SLACK)[:, 0]
    return displacement


def _joint_displacements(joints: Floats, pins: Pins, fps: float) -> DoubleArray:
    """Compute displacements (frames, 22, 3) through what each joint misses, `PELVIC` ones along with the pelvis."""
    missed = pins.missed(joints)
    along = np.zeros(joints.shape)
    along[:, PELVIC] = _spread(missed[:, [PELVIS]], pins.wanted[:, [PELVIS]], fps)
    return along + _spread(np.where(pins.wanted, missed - along, 0.0), pins.wanted, fps)


def _spread(missed: Floats, wanted: NDArray[np.bool_], fps: float) -> DoubleArray:
    """Spread what joints miss at the frames where they are wanted over the others; all are (frames, joints, 3)."""
    displacement = np.zeros(missed.shape)
    columns = wanted.reshape(len(missed), -1)
    flat, out = missed.reshape(len(missed), -1), displacement.reshape(len(missed), -1)
    # joints of the same frames together
    for pattern in {columns[:, index].tobytes() for index in np.flatnonzero(columns.any(axis=0))}:
        at = np.frombuffer(pattern, dtype=np.bool_)
        same = np.flatnonzero((columns == at[:, None]).all(axis=0))
        out[:, same] = smooth_field(flat[:, same], at, fps)
    return displacement


def _pull(
    joints: DoubleArray, aims: DoubleArray, wanted: NDArray[np.bool_], held: NDArray[np.bool_], lengths: FloatArray
) -> Floats:
    """Bring joints to their aims with rigid bones: those of wanted places in rounds, those on the way to them once."""
    solved: Floats = joints
    past = np.zeros_like(aims)
    for _ in range(ROUNDS):
        solved = bend_to_lengths(np.where(held, aims + past, solved), lengths, held, SWEEPS)
        past += np.clip(np.where(wanted, aims - solved, 0.0), -MAX_PAST, MAX_PAST)
    return solved
