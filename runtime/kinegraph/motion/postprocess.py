"""Post-processing of decoded joints: constant bone lengths and foot locking.

A decoder places every joint by itself, so bones change length by a millimetre or two and planted feet slide.
`enforce_bone_lengths` projects a motion onto a skeleton with rigid bones. `lock_feet` detects contacts from the joints
and holds planted toes with two-bone inverse kinematics. All positions are in metres in a world frame with Y up.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import FloatArray, Floats
from kinegraph.motion.quaternions import normalised, rotate, shortest_rotation
from kinegraph.motion.skeleton import HORIZONTAL, JOINT_INDEX, JOINTS, PARENTS, PELVIS, bone_lengths

LEGS: Final[tuple[tuple[int, int, int, int], ...]] = tuple(
    (JOINT_INDEX[f"{side}_hip"], JOINT_INDEX[f"{side}_knee"], JOINT_INDEX[f"{side}_ankle"], JOINT_INDEX[f"{side}_foot"])
    for side in ("left", "right")
)
"""Hip, knee, ankle and toe of both legs."""

CONTACT_SPEED: Final = 0.5
"""m/s over the floor: a toe that is low and slower than this is planted, or is meant to be."""
MAX_CONTACT_SPEED: Final = 1.2
"""m/s, however fast the body is (`sliding_speed`)."""
CONTACT_HEIGHT: Final = 0.07
"""Metres above the 10 % quantile of the toe's height."""
MIN_CONTACT_SECONDS: Final = 0.15
"""A shorter contact is a swinging foot that happens to be slow."""
RAMP_SECONDS: Final = 0.2
"""Time in which a correction comes and goes before and after a contact."""
METRES_PER_JERK: Final = 6e-5
"""Metres of correction beside a contact that cost as much as a jerk of 1 m/s^3."""
MAX_CORRECTION: Final = 0.08
"""Metres: a foot that is further from its locked position is meant to move."""
MAX_EXTENSION: Final = 0.98
"""Distance of hip and ankle as a share of the leg's length, unless the leg was straighter before.

Near a straight leg the knee moves far for a centimetre of the foot.
"""

ITERATIONS: Final = 5
"""Rounds of position-based dynamics before the exact pass."""
_TOE_INVERSE_MASS: Final = 0.1
"""How much a toe yields where other joints yield by 1: planted feet must not be pushed about."""
_MIN_LENGTH: Final = 1e-6
_PARENT: Final = np.array(PARENTS[1:])
_CHILD: Final = np.arange(1, JOINTS)


def enforce_bone_lengths(joints: FloatArray, lengths: FloatArray | None) -> FloatArray:
    """Project a motion onto the nearest one whose bones have exactly these lengths.

    Position-based dynamics (Müller et al., 2007): a few rounds in which both ends of a wrong bone yield, feet least,
    then one pass from the pelvis outwards that leaves no error. The pass alone would add up all errors of a leg at
    the toe, and planted feet would slide.

    Args:
        joints: (frames, 22, 3) metres.
        lengths: (21,) metres, of the bone from each joint but the pelvis to its parent; None takes each bone's
            median over the frames.

    Returns:
        (frames, 22, 3) float32 metres.
    """
    solved = joints.astype(np.float32)
    lengths = np.median(bone_lengths(solved), axis=0) if lengths is None else lengths
    target = lengths.astype(np.float32)[:, None]
    for _ in range(ITERATIONS):
        bones = solved[:, _CHILD] - solved[:, _PARENT]
        length = np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), _MIN_LENGTH)
        solved += _CORRECTION_SHARES @ (bones * (1.0 - target / length))
    return _set_lengths(solved, target)


def bend_to_lengths(joints: Floats, lengths: Floats, held: NDArray[np.bool_], iterations: int) -> Floats:
    """Project poses onto rigid bones as `enforce_bone_lengths` does, with some joints held where they are.

    The exact pass at the end may move these by what the iterations leave.

    Args:
        joints: (frames, 22, 3) metres.
        lengths: (21,) metres.
        held: (frames, 22, 3) axes of joints that do not yield.
        iterations: of position-based dynamics.

    Returns:
        (frames, 22, 3) metres.
    """
    solved, target = joints.copy(), lengths[:, None]
    for _ in range(iterations):
        bones = solved[:, _CHILD] - solved[:, _PARENT]
        length = np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), _MIN_LENGTH)
        solved += np.where(held, 0.0, _CORRECTION_SHARES @ (bones * (1.0 - target / length)))
    return _set_lengths(solved, target)


def _set_lengths(joints: Floats, target: Floats) -> Floats:
    """Keep the directions of bones, set their lengths (21, 1), and add up from the pelvis; changes the joints."""
    bones = joints[:, _CHILD] - joints[:, _PARENT]
    bones *= target / np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), _MIN_LENGTH)
    for child, parent in zip(_CHILD, _PARENT, strict=True):
        joints[:, child] = joints[:, parent] + bones[:, child - 1]
    return joints


def _correction_shares() -> FloatArray:
    """Compute the share (22, 21) of each bone's correction that each joint takes, averaged over its bones.

    A bone's correction is split between its ends by their inverse masses w: +w_p / (w_p + w_c) for the parent,
    -w_c / (w_p + w_c) for the child. The sum of a joint is divided by 0.7 times the number of its bones: an average
    with over-relaxation (as in Macklin et al., 2014).
    """
    inverse_mass = np.ones(JOINTS)
    inverse_mass[[JOINT_INDEX["left_foot"], JOINT_INDEX["right_foot"]]] = _TOE_INVERSE_MASS
    inverse_mass[[JOINT_INDEX["left_ankle"], JOINT_INDEX["right_ankle"]]] = _TOE_INVERSE_MASS**0.5
    shares, bones = np.zeros((JOINTS, JOINTS - 1)), np.arange(JOINTS - 1)
    total = inverse_mass[_PARENT] + inverse_mass[_CHILD]
    shares[_PARENT, bones] = inverse_mass[_PARENT] / total
    shares[_CHILD, bones] = -inverse_mass[_CHILD] / total
    bone_count = (shares != 0).sum(axis=1, keepdims=True)
    averaged: FloatArray = (shares / np.maximum(1.0, 0.7 * bone_count)).astype(np.float32)
    return averaged


_CORRECTION_SHARES: Final = _correction_shares()


def lock_feet(
    joints: FloatArray,
    fps: float,
    aims: Floats | None = None,
    contact_speed: float = CONTACT_SPEED,
    metres_per_jerk: float = METRES_PER_JERK,
) -> FloatArray:
    """Correct a motion so that planted toes do not slide.

    During a contact the toe is held at its median position, or at the mean of where it has to be then; beside it it
    takes the path of least jerk. The whole foot moves with its toe, the knee bends in its own plane, and all bones keep
    their length.

    Args:
        joints: (frames, 22, 3) metres, Y up.
        fps: frames per second.
        aims: (frames, 22, 3) metres where joints have to be, NaN where they need not; None is nowhere.
        contact_speed: see `find_contacts`.
        metres_per_jerk: see `ease_corrections`.

    Returns:
        (frames, 22, 3) float32 metres.
    """
    locked = joints.astype(np.float64)
    for hip, knee, ankle, toe in LEGS:
        contacts = find_contacts(locked[:, toe], fps, contact_speed)
        aim = None if aims is None else aims[:, toe]
        correction = ease_corrections(
            locked[:, toe], _toe_corrections(locked[:, toe], contacts, aim), contacts, fps, metres_per_jerk
        )
        if not correction.any():
            continue
        goal = locked[:, ankle] + correction
        new_knee, new_ankle = two_bone_ik(locked[:, hip], locked[:, knee], locked[:, ankle], goal)
        locked[:, toe] += new_ankle - locked[:, ankle]
        locked[:, knee], locked[:, ankle] = new_knee, new_ankle
    return locked.astype(np.float32)


def find_contacts(toe: Floats, fps: float, contact_speed: float = CONTACT_SPEED) -> list[tuple[int, int]]:
    """Find the spans of frames in which a toe is planted: slow, low and long enough.

    Args:
        toe: (frames, 3) metres, Y up.
        fps: frames per second.
        contact_speed: m/s over the floor below which a low toe is planted.

    Returns:
        Half-open spans (start, end) of frames.
    """
    if len(toe) < 3:
        return []
    speed = np.linalg.norm(np.gradient(toe[:, [0, 2]], axis=0), axis=-1) * fps
    planted = (speed < contact_speed) & (toe[:, 1] < np.quantile(toe[:, 1], 0.1) + CONTACT_HEIGHT)
    return [(start, end) for start, end in _true_spans(planted) if end - start >= MIN_CONTACT_SECONDS * fps]


def sliding_speed(joints: Floats, fps: float) -> float:
    """Tell below which speed, m/s, a low toe slides that is meant to be planted: the body's, on the mean.

    Constraints let a body go faster than its sentence alone does, and its planted feet slide with it; a swinging foot
    is twice as fast as the body.

    Args:
        joints: (frames, 22, 3) metres.
        fps: frames per second.
    """
    steps = np.linalg.norm(np.diff(joints[:, PELVIS][:, [0, 2]], axis=0), axis=1)
    return float(np.clip(fps * steps.mean(), CONTACT_SPEED, MAX_CONTACT_SPEED))


def median_place(points: Floats) -> Floats:
    """Compute the median of points (n, 3), axis by axis; numpy.median takes five times as long for so few."""
    ordered = np.sort(points, axis=0)
    return np.asarray((ordered[(len(points) - 1) // 2] + ordered[len(points) // 2]) / 2)


def two_bone_ik(hip: Floats, knee: Floats, ankle: Floats, goal: Floats) -> tuple[Floats, Floats]:
    """Solve two-bone inverse kinematics by the law of cosines, keeping the plane in which the leg bends.

    A goal out of reach is approached as far as the leg extends (`MAX_EXTENSION`).

    Args:
        hip, knee, ankle: (frames, 3) metres, the leg as it is.
        goal: (frames, 3) metres, where the ankle should be.

    Returns:
        New knee and ankle, (frames, 3) metres each.
    """
    upper, lower = np.linalg.norm(knee - hip, axis=-1), np.linalg.norm(ankle - knee, axis=-1)
    to_goal = goal - hip
    nearest, furthest = np.abs(upper - lower) + 1e-3, (upper + lower) * MAX_EXTENSION
    # a leg that was straighter before may stay so
    furthest = np.maximum(furthest, np.minimum(np.linalg.norm(ankle - hip, axis=-1), upper + lower))
    distance = np.clip(np.linalg.norm(to_goal, axis=-1), nearest, furthest)
    along, was = normalised(to_goal), normalised(ankle - hip)
    # direction of the bend: the part of hip -> knee that is perpendicular to hip -> goal, which moves the knee least.
    # Of a nearly straight leg that would be wherever the goal moves to: there it is the bend that was, turned with it.
    bend = (knee - hip) - ((knee - hip) * along).sum(-1, keepdims=True) * along
    bent = (knee - hip) - ((knee - hip) * was).sum(-1, keepdims=True) * was
    straight = np.clip((0.15 * upper - np.linalg.norm(bent, axis=-1)) / (0.1 * upper + 1e-9), 0.0, 1.0)[:, None]
    bend = (1.0 - straight) * bend + straight * rotate(shortest_rotation(was, along), bent)
    # foot and height of the triangle with sides upper, lower and distance
    reach = (upper**2 - lower**2 + distance**2) / (2 * np.maximum(distance, 1e-9))  # a leg without length is a point
    height = np.sqrt(np.maximum(upper**2 - reach**2, 0.0))
    new_knee = hip + reach[:, None] * along + height[:, None] * normalised(bend)
    return new_knee, hip + distance[:, None] * along


def _toe_corrections(toe: Floats, contacts: list[tuple[int, int]], aim: Floats | None) -> Floats:
    """Compute the horizontal displacement (frames, 3) that locks a toe (frames, 3) in its contacts; see `lock_feet`."""
    correction = np.zeros_like(toe)
    for start, end in contacts:
        place = median_place(toe[start:end])
        if aim is not None and (wanted := np.isfinite(aim[start:end, [0, 2]]).all(axis=1)).any():
            place = np.nan_to_num(aim[start:end][wanted].mean(axis=0))
        to_place = (place - toe[start:end]) * HORIZONTAL
        distance = np.maximum(np.linalg.norm(to_place, axis=-1), 1e-9)
        correction[start:end] = to_place * np.minimum(1.0, MAX_CORRECTION / distance)[:, None]
    return correction


def ease_corrections(
    toe: Floats,
    correction: Floats,
    contacts: list[tuple[int, int]],
    fps: float,
    metres_per_jerk: float = METRES_PER_JERK,
) -> Floats:
    """Let the corrections of contacts come and go smoothly beside them.

    Beside a contact the correction s minimises sum |D^3 (toe + s)|^2 + (s / metres_per_jerk)^2, with D^3 the third
    derivative: the path of least jerk (Flash & Hogan, 1985, Eq. 1), kept near the original one.

    Args:
        toe: (frames, 3) metres.
        correction: (frames, 3) metres, horizontal, set in the contacts.
        contacts: half-open spans of frames.
        fps: frames per second.
        metres_per_jerk: metres of correction that cost as much as a jerk of 1 m/s^3.

    Returns:
        (frames, 3) metres; in the contacts as it was.
    """
    correction, free = correction.copy(), np.zeros(len(toe), dtype=bool)
    ramp = max(1, round(RAMP_SECONDS * fps))
    for start, end in contacts:
        free[max(0, start - ramp) : end + ramp] = True
    for start, end in contacts:
        free[start:end] = False
    for start, end in _true_spans(free):
        # third derivatives couple each frame with three neighbours on either side
        first, last = max(0, start - 3), min(len(toe), end + 3)
        third, unknown, normal = _least_jerk(last - first, start - first, end - first, fps, metres_per_jerk)
        jerk = third @ (toe[first:last] * HORIZONTAL + correction[first:last])
        # normal equations: (U^T U + 1 / metres_per_jerk^2) s = -U^T jerk
        correction[start:end] = -np.linalg.solve(normal, unknown.T @ jerk)
    return correction


@lru_cache(maxsize=32)
def _least_jerk(frames: int, start: int, end: int, fps: float, metres_per_jerk: float) -> tuple[Floats, Floats, Floats]:
    """Build the third derivative D^3 of `frames` frames, its columns U of the free ones, and the normal matrix."""
    third = np.diff(np.eye(frames), n=3, axis=0) * fps**3
    unknown = third[:, start:end]
    normal = unknown.T @ unknown + np.eye(end - start) / metres_per_jerk**2
    for array in (third, unknown, normal):
        array.flags.writeable = False
    return third, unknown, normal


def _true_spans(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Find the half-open spans (start, end) of consecutive True values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
