"""What a body tells of the file it comes from: the axis that points up, whether left and right are exchanged, the unit.

Joints are (frames, 22, 3) in the units and axes of the file unless said otherwise. The axes are told as "y" or "-z".
"""

from __future__ import annotations

from typing import Final

import numpy as np

from kinegraph.arrays import Floats
from kinegraph.errors import InvalidInputError
from kinegraph.motion.skeleton import JOINT_INDEX, JOINT_NAMES, PARENTS, facing_angle
from kinegraph_training.data.retargeting import SHORTEST_BONE

UNITS: Final[dict[str, float]] = {
    "metres": 1.0,
    "feet": 0.3048,
    "CMU units of 1/0.45 inch": 0.0254 / 0.45,
    "inches": 0.0254,
    "centimetres": 0.01,
    "millimetres": 0.001,
}
"""Metres per unit, of the units that files come in."""
LEG_METRES: Final = (0.6, 1.2)
"""Range of thigh plus shank of an adult; at most one of `UNITS` brings a leg into it."""
UP_AXES: Final = ("x", "y", "z", "-x", "-y", "-z")

_LEGS: Final = (("left_hip", "left_knee", "left_ankle"), ("right_hip", "right_knee", "right_ankle"))
_RIGID: Final = tuple(
    f"{side}_{part}" for side in ("left", "right") for part in ("knee", "ankle", "foot", "elbow", "wrist")
)
"""Joints whose bone keeps its length in every skeleton: no other joint bends between its ends."""
_STRETCH: Final = 0.2
"""Change of such a length, as a share of its median."""
_CLEAR_UP: Final = 0.75
"""Component along an axis of the mean direction of a body that stands along it."""
_CLEAR_TOES: Final = 0.3
"""Mean component of the feet along the facing direction, from which on they tell forward from backward."""
_CLEAR_KNEES: Final = 0.02
"""Mean distance of the knees from the line hip - ankle along the facing direction, in lengths of a leg."""


class UnclearUpError(InvalidInputError):
    """The body does not tell which axis points up; other files of the same folder may."""


def guess_unit(positions: Floats) -> float:
    """Guess the metres per unit from the mean length of the legs.

    Raises:
        InvalidInputError: no unit of `UNITS` gives an adult.
    """
    leg = leg_length(positions)
    for unit in UNITS.values():
        if LEG_METRES[0] <= leg * unit <= LEG_METRES[1]:
            return unit
    raise InvalidInputError(
        f"a leg is {leg:.4g} units long, which fits a grown body in none of {', '.join(UNITS)}; "
        f"pass --scale with the metres per unit, for example --scale {0.85 / leg if leg > 0 else 1:.4g}"
    )


def leg_length(positions: Floats) -> float:
    """Measure the mean length of thigh plus shank."""
    return float(np.mean([_lengths(positions, a, b) + _lengths(positions, b, c) for a, b, c in _LEGS]))


def check_bones(positions: Floats, fps: float, taken_from: dict[str, str]) -> None:
    """Refuse bones of length zero and limbs that stretch.

    Args:
        positions: of the body.
        fps: frames per second, to tell when.
        taken_from: what each of the joints was taken from in the file, for the message; those in between are missing.

    Raises:
        InvalidInputError: the message names the joint.
    """

    def described(joint: str) -> str:
        return f"{joint} ({taken_from[joint]})" if joint in taken_from else joint

    lengths = {JOINT_NAMES[child]: _lengths(positions, JOINT_NAMES[PARENTS[child]], JOINT_NAMES[child])
               for child in range(1, len(PARENTS))}  # fmt: skip
    whole = sum(float(length.mean()) for length in lengths.values())
    for joint, length in lengths.items():
        parent = JOINT_NAMES[PARENTS[JOINT_INDEX[joint]]]
        if float(length.mean()) <= SHORTEST_BONE * whole:
            raise InvalidInputError(
                f"{described(joint)} lies on {described(parent)}: the bone between them has no length; take "
                f"{joint} from another joint or End Site with --map"
            )
    for joint in _RIGID:
        length, usual = lengths[joint], float(np.median(lengths[joint]))
        worst = int(np.abs(length - usual).argmax())
        if not abs(float(length[worst]) - usual) <= _STRETCH * usual:
            parent = JOINT_NAMES[PARENTS[JOINT_INDEX[joint]]]
            raise InvalidInputError(
                f"the bone from {described(parent)} to {described(joint)} stretches from {usual:.4g} to "
                f"{float(length[worst]):.4g} units at {worst / fps:.2f} s; a body's bones keep their length: "
                "repair the clip, or map other joints with --map"
            )


def find_up(positions: Floats, rest: Floats | None) -> tuple[str, str | None]:
    """Find the axis that points up: head over feet and neck over pelvis, in the motion and in the rest pose.

    Args:
        positions: of the motion.
        rest: (22, 3) rest pose, if there is one.

    Returns:
        The axis, and a warning where motion and rest pose differ.

    Raises:
        UnclearUpError: the body lies, or stands along no axis.
    """
    direction = _body_direction(positions).mean(axis=0)
    axis, share = _nearest_axis(direction)
    rest_axis, rest_share = axis, 0.0
    if rest is not None and _stands(rest):
        rest_axis, rest_share = _nearest_axis(_body_direction(rest[None])[0])
    if share >= _CLEAR_UP:
        if rest_share < _CLEAR_UP or rest_axis == axis:
            return axis, None
        if _travels_upright(positions, axis):
            return axis, f"the body walks upright along {axis}, while its rest pose stands along {rest_axis}"
        raise UnclearUpError(
            f"the body is stretched along {axis}, while its rest pose stands along {rest_axis}: it lies, or the file "
            f"was turned; pass --up={rest_axis} if it lies, --up={axis} if it stands"
        )
    if rest_share >= _CLEAR_UP and float(direction @ axis_vector(rest_axis)) > 0.25:
        return rest_axis, f"the body seldom stands: up is {rest_axis}, as in its rest pose"
    raise UnclearUpError(
        "neither head over feet nor the spine tells which axis points up; pass --up with it, for example --up=y"
    )


def axis_vector(axis: str) -> Floats:
    """Return the unit vector (3,) of an axis of `UP_AXES`."""
    vector = np.zeros(3)
    vector["xyz".index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return vector


def rotation_to_y_up(up: str) -> Floats:
    """Return the rotation (3, 3) that turns an axis of `UP_AXES` to +Y; it keeps the file's handedness."""
    vector = axis_vector(up)
    # the axis that follows it, x y z x, becomes Z, or where it is reversed X, so that the determinant is 1
    following = np.roll(np.abs(vector), 1)
    rows = [np.cross(vector, following), vector, following]
    return np.array(rows)


def sides_exchanged(joints: Floats) -> tuple[str | None, str | None]:
    """Find out whether left and right are exchanged: then toes point and knees bend against the facing direction.

    Args:
        joints: (frames, 22, 3) of any unit, Y up.

    Returns:
        What shows that they are, or None; and a warning where toes and knees disagree, or None.
    """
    toes, knees = toes_ahead(joints), knees_ahead(joints)
    if toes < -_CLEAR_TOES and knees <= _CLEAR_KNEES:
        bent = " and the knees bend" if knees < -_CLEAR_KNEES else ""
        return f"the toes point{bent} backwards{_against_travel(joints)}", None
    if abs(toes) <= _CLEAR_TOES and knees < -2 * _CLEAR_KNEES:
        return f"the knees bend backwards{_against_travel(joints)}", None
    if toes < -_CLEAR_TOES:
        return None, "the toes point backwards, while the knees bend forwards: check what the feet are taken from"
    if toes > _CLEAR_TOES and knees < -2 * _CLEAR_KNEES:
        return None, "the knees bend backwards"
    return None, None


def toes_ahead(joints: Floats) -> float:
    """Measure the mean component of the feet along the facing direction, in lengths of a foot."""
    ahead = _facing(joints)
    shares = []
    for side in ("left", "right"):
        foot = joints[:, JOINT_INDEX[f"{side}_foot"]] - joints[:, JOINT_INDEX[f"{side}_ankle"]]
        shares.append((foot * ahead).sum(-1) / np.maximum(np.linalg.norm(foot, axis=-1), 1e-12))
    return float(np.mean(shares))


def knees_ahead(joints: Floats) -> float:
    """Measure how far the knees lie ahead of the line from hip to ankle, in lengths of a leg."""
    ahead = _facing(joints)
    shares = []
    for hip, knee, ankle in _LEGS:
        thigh = joints[:, JOINT_INDEX[knee]] - joints[:, JOINT_INDEX[hip]]
        line = joints[:, JOINT_INDEX[ankle]] - joints[:, JOINT_INDEX[hip]]
        share = (thigh * line).sum(-1, keepdims=True) / np.maximum((line * line).sum(-1, keepdims=True), 1e-12)
        shares.append(((thigh - share * line) * ahead).sum(-1))
    return float(np.mean(shares)) / leg_length(joints)


def facing_axis(joints: Floats, up: str, mirrored: bool) -> str:
    """Name the axis of the file that the body faces in the first frame.

    Args:
        joints: (frames, 22, 3) after `rotation_to_y_up` and, if `mirrored`, negated X.
        up: axis that was up.
        mirrored: whether X was negated.
    """
    ahead = _facing(joints[:1])[0] * ([-1, 1, 1] if mirrored else [1, 1, 1])
    return _nearest_axis(rotation_to_y_up(up).T @ ahead)[0]


def _facing(joints: Floats) -> Floats:
    """Return the facing direction (frames, 3) of joints with Y up."""
    angle = facing_angle(joints)
    return np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=-1).astype(np.float64)


def _against_travel(joints: Floats) -> str:
    """Say so if the body also travels backwards."""
    step = np.diff(joints[:, 0], axis=0)
    along = float((step * _facing(joints)[:-1]).sum())
    return ", and it travels backwards" if along < -0.3 * leg_length(joints) else ""


def _travels_upright(positions: Floats, axis: str) -> bool:
    """Tell whether the pelvis travels more than a leg's length across `axis` without the body turning about it.

    Who lies stays, crawls along the body, or rolls.
    """
    level = 1 - np.abs(axis_vector(axis))
    travel = float(np.linalg.norm((positions[-1, 0] - positions[0, 0]) * level))
    heading = facing_angle(positions @ rotation_to_y_up(axis).T)
    return travel > leg_length(positions) and float(np.ptp(heading)) < 2 * np.pi


def _body_direction(positions: Floats) -> Floats:
    """Return the mean of two directions (frames, 3): ankles to head, pelvis to neck."""
    ankles = (positions[:, JOINT_INDEX["left_ankle"]] + positions[:, JOINT_INDEX["right_ankle"]]) / 2
    spans = (
        positions[:, JOINT_INDEX["head"]] - ankles,
        positions[:, JOINT_INDEX["neck"]] - positions[:, JOINT_INDEX["pelvis"]],
    )
    return sum(span / np.maximum(np.linalg.norm(span, axis=-1, keepdims=True), 1e-12) for span in spans) / 2.0


def _stands(rest: Floats) -> bool:
    """Tell whether a rest pose (22, 3) is that of a body at all: some files lay all bones along their own axes."""
    spine = rest[JOINT_INDEX["neck"]] - rest[JOINT_INDEX["pelvis"]]
    legs = [rest[JOINT_INDEX[ankle]] - rest[JOINT_INDEX[hip]] for hip, _, ankle in _LEGS]
    return all(float(leg @ spine) < -0.8 * np.linalg.norm(leg) * np.linalg.norm(spine) for leg in legs)


def _nearest_axis(direction: Floats) -> tuple[str, float]:
    """Return the axis of `UP_AXES` nearest to a direction (3,), and the component along it."""
    axis = max(UP_AXES, key=lambda name: float(direction @ axis_vector(name)))
    return axis, float(direction @ axis_vector(axis))


def _lengths(positions: Floats, start: str, end: str) -> Floats:
    bones = positions[:, JOINT_INDEX[end]] - positions[:, JOINT_INDEX[start]]
    return np.asarray(np.linalg.norm(bones, axis=-1))
