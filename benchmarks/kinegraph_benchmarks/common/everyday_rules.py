"""Rules of everyday actions, by name: what prompts of `quality.everyday` must do to be right.

Rules extend `common.predicates` to jumps, kicks, punches, crouches, falls, getting up, reaching, circles and orders.
They take joints (frames, 22, 3) in metres at 20 frames per second, +Y up. Bodies differ in size by data set, so heights
are in legs: lengths of the body's own leg, thigh and shank. Directions are those that the body faces at each moment, so
that a walk which turns still goes forward. `quality.everyday_rules` prints how often captured clips meet each rule.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import FloatArray
from kinegraph.errors import InvalidInputError
from kinegraph.motion.skeleton import JOINT_INDEX, facing_angle
from kinegraph.validation import short_repr
from kinegraph_benchmarks.common import predicates as p
from kinegraph_benchmarks.common.caption_claims import count_steps
from kinegraph_benchmarks.common.two_action_set import happen_in_order

ORDER: Final = ">"
"""Joins two rules of which the second must come after the first: "jumps>forward"."""
STEPS: Final = "steps:"
"""Begins a rule of a number of steps, met to within one: "steps:4"."""

FLOOR: Final = (0, 2)
"""Axes of the floor."""
Series = NDArray[np.float64]
"""(frames,) of one quantity."""


# Quantities


def leg_length(joints: FloatArray) -> float:
    """Measure thigh and shank together, metres, mean of both sides."""
    bones = [
        np.linalg.norm(_joint(joints, f"{side}_{lower}") - _joint(joints, f"{side}_{upper}"), axis=1).mean()
        for side in p.SIDES
        for upper, lower in (("hip", "knee"), ("knee", "ankle"))
    ]
    return float(sum(bones)) / 2


def hip_height(joints: FloatArray) -> Series:
    """Measure the height of the pelvis over the floor, legs; about 1.1 of a body that stands."""
    return _joint(joints, "pelvis")[:, 1] / leg_length(joints)


def travel(joints: FloatArray) -> NDArray[np.float64]:
    """Measure metres (left, forward) that the pelvis goes, each step along what the body faces at that moment."""
    steps = np.diff(_joint(joints, "pelvis"), axis=0)
    heading = facing_angle(joints)[:-1].astype(np.float64)
    sin, cos = np.sin(heading), np.cos(heading)
    return np.array([(cos * steps[:, 0] - sin * steps[:, 2]).sum(), (sin * steps[:, 0] + cos * steps[:, 2]).sum()])


def floor_speed(joints: FloatArray, seconds: float) -> Series:
    """Measure the speed of the pelvis over the floor, m/s, over every stretch of that length."""
    frames = min(round(seconds * p.FPS), len(joints) - 1)
    place = _joint(joints, "pelvis")[:, [0, 2]]
    speed: Series = np.linalg.norm(place[frames:] - place[:-frames], axis=1) * p.FPS / frames
    return speed


def joint_speed(joints: FloatArray) -> float:
    """Measure the mean speed of the joint that moves most, m/s."""
    return float(np.linalg.norm(np.diff(joints.astype(np.float64), axis=0), axis=-1).mean(axis=0).max() * p.FPS)


def off_the_floor(joints: FloatArray) -> NDArray[np.bool_]:
    """Tell for each frame whether both feet are more than 0.09 legs above where the lower one stands."""
    lower = np.minimum(_joint(joints, "left_foot")[:, 1], _joint(joints, "right_foot")[:, 1])
    return lower > np.quantile(lower, 0.1) + 0.09 * leg_length(joints)


def lean(joints: FloatArray) -> Series:
    """Measure the angle of the trunk, from pelvis to neck, from the vertical, degrees."""
    trunk = _joint(joints, "neck") - _joint(joints, "pelvis")
    angle: Series = np.degrees(np.arccos((trunk[:, 1] / np.linalg.norm(trunk, axis=1)).clip(-1, 1)))
    return angle


def limb_speed(joints: FloatArray, end: str, axes: Sequence[int] = (0, 1, 2)) -> Series:
    """Measure the speed of a joint relative to the pelvis, m/s, to the frame from the one before; the first is 0."""
    offset = (_joint(joints, end) - _joint(joints, "pelvis"))[:, list(axes)]
    return np.insert(np.linalg.norm(np.diff(offset, axis=0), axis=1) * p.FPS, 0, 0.0)


def _pace(joints: FloatArray) -> Series:
    """Measure the speed of the pelvis over the floor at each frame, m/s, over the half second around it."""
    place = _joint(joints, "pelvis")[:, [0, 2]]
    frames = np.arange(len(joints))
    first, last = (frames - 5).clip(0), (frames + 5).clip(max=len(joints) - 1)
    pace: Series = np.linalg.norm(place[last] - place[first], axis=1) * p.FPS / (last - first)
    return pace


def _joint(joints: FloatArray, name: str) -> NDArray[np.float64]:
    return joints[:, JOINT_INDEX[name]].astype(np.float64)


def _longest(held: NDArray[np.bool_]) -> int:
    """Count the longest run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], held, [False]]).astype(np.int8)))
    return int((edges[1::2] - edges[::2]).max(initial=0))


# Rules of the whole body


def stays(joints: FloatArray) -> bool:
    """Tell whether the pelvis is never 0.5 m or more from where it started."""
    place = _joint(joints, "pelvis")[:, [0, 2]]
    return bool(np.linalg.norm(place - place[0], axis=1).max() < 0.5)


def is_still(joints: FloatArray) -> bool:
    """Tell whether no joint moves by 0.25 m/s or more in the mean."""
    return joint_speed(joints) < 0.25


def goes_forward(joints: FloatArray) -> bool:
    """Tell whether the body goes more than 0.5 m ahead, and more ahead than aside."""
    left, ahead = travel(joints)
    return bool(ahead > 0.5 and ahead > abs(left))


def goes_backward(joints: FloatArray) -> bool:
    """Tell whether the body goes more than 0.35 m backwards, and more so than aside."""
    left, ahead = travel(joints)
    return bool(-ahead > 0.35 and -ahead > abs(left))


def goes_aside(side: str) -> p.Predicate:
    """Make a predicate: the body goes more than 0.25 m to that side and ends facing as before, to 75 degrees.

    It goes at least half as far aside as ahead.
    """
    sign = 1.0 if side == "left" else -1.0

    def holds(joints: FloatArray) -> bool:
        left, ahead = travel(joints)
        return bool(sign * left > 0.25 and sign * left > 0.5 * abs(ahead) and abs(p.net_turn(joints)) < 75)

    return holds


def turns_around(joints: FloatArray) -> bool:
    """Tell whether the body turns by more than 130 degrees, and at most all the way round, to 40 degrees."""
    return 130 < abs(p.net_turn(joints)) < 400


def walks_a_circle(joints: FloatArray) -> bool:
    """Tell whether the body walks 1.5 m or more while turning by 190 degrees or more, evenly along its path.

    A walk that turns on the spot, as on a heel, is no circle: no second holds more than 0.7 of the turn.
    """
    heading = np.degrees(facing_angle(joints)).astype(np.float64)
    turn = abs(heading[-1] - heading[0])
    frames = min(p.FPS, len(joints) - 1)
    at_once = np.abs(heading[frames:] - heading[:-frames]).max()
    path = p.speed(joints) * (len(joints) - 1) / p.FPS
    return bool(turn > 190 and path > 1.5 and at_once < 0.7 * turn)


def comes_to_a_stop(joints: FloatArray) -> bool:
    """Tell whether a body that moved at 0.5 m/s or more for half a second ends at less than 0.3 m/s."""
    return bool(floor_speed(joints, 0.5).max() > 0.5 and floor_speed(joints, 0.35)[-1] < 0.3)


def goes_fast(joints: FloatArray) -> bool:
    """Tell whether the body runs for a second: at more than 1.7 m/s."""
    return bool(floor_speed(joints, 1.0).max() > 1.7)


def jumps(joints: FloatArray) -> bool:
    """Tell whether an upright body has both feet off the floor for 0.2 s or more; a runner has for 0.15 s at most."""
    upright = (lean(joints) < 60) & (hip_height(joints) > 0.9)
    return _longest(off_the_floor(joints) & upright) >= 0.2 * p.FPS


def crouches(joints: FloatArray) -> bool:
    """Tell whether the hips sink by more than 0.2 legs below where they are highest while a foot is down."""
    hips = hip_height(joints)
    return bool(hips[~off_the_floor(joints)].max() - hips.min() > 0.2)


def falls(joints: FloatArray) -> bool:
    """Tell whether a body that was up, hips over 0.8 legs, gets to the floor later, under 0.45 legs."""
    hips = hip_height(joints)
    low = np.flatnonzero(hips < 0.45)
    return bool(len(low) and hips[: low[0] + 1].max() > 0.8)


def gets_up(joints: FloatArray) -> bool:
    """Tell whether a body whose hips were under 0.65 legs ends with them 0.3 legs higher or more."""
    hips = hip_height(joints)
    end = hips[-5:].mean()
    return bool((hips[:-5] < min(0.65, end - 0.3)).any())


def sits(joints: FloatArray) -> bool:
    """Tell whether the hips rest at the height of a chair, 0.3 to 0.8 legs, for a second, with the trunk upright.

    They move at less than 0.25 m/s there. A high stool holds the hips as high as bent knees do, and is not told apart.
    """
    hips = hip_height(joints)
    return _longest((hips > 0.3) & (hips < 0.8) & (lean(joints) < 50) & (_pace(joints) < 0.25)) >= p.FPS


def bows(joints: FloatArray) -> bool:
    """Tell whether the trunk leans over by 16 degrees more than at first while the hips stay up, within 0.2 legs."""
    leaning, hips = lean(joints), hip_height(joints)
    return bool(leaning.max() - leaning[0] > 16 and hips.max() - hips.min() < 0.2)


# Rules of limbs


def kicks_with(side: str) -> p.Predicate:
    """Make a predicate: that leg swings up, nearly straight, while the body is upright.

    The ankle is more than 0.35 legs above the other one, 0.75 legs or more from its hip, and has moved at 2 m/s or more
    within the last 0.3 s. A runner's leg may get as high; therefore the hips go at less than 1.8 m/s.
    """
    other = "left" if side == "right" else "right"

    def holds(joints: FloatArray) -> bool:
        leg, ankle = leg_length(joints), _joint(joints, f"{side}_ankle")
        high = ankle[:, 1] - _joint(joints, f"{other}_ankle")[:, 1] > 0.35 * leg
        straight = np.linalg.norm(ankle - _joint(joints, f"{side}_hip"), axis=1) > 0.75 * leg
        upright = (hip_height(joints) > 0.7) & (lean(joints) < 60) & (_pace(joints) < 1.8)
        fast = limb_speed(joints, f"{side}_ankle") > 2.0
        recent = np.convolve(fast, np.ones(7), mode="full")[: len(fast)] > 0
        return bool((high & straight & upright & recent).any())

    return holds


def punches_with(side: str) -> p.Predicate:
    """Make a predicate: that fist moves at more than 3 m/s over the floor, as seen from the hips, at chest height.

    It is within 0.45 legs of the shoulder's height, gets 0.3 legs or more away from it over the floor within 0.2 s, and
    is faster than the other fist. The hips go at less than 1.5 m/s: a runner's arms swing as fast.
    """
    other = "left" if side == "right" else "right"

    def holds(joints: FloatArray) -> bool:
        leg, arm = leg_length(joints), _joint(joints, f"{side}_wrist") - _joint(joints, f"{side}_shoulder")
        level = np.abs(arm[:, 1]) < 0.45 * leg
        out = np.linalg.norm(arm[:, [0, 2]], axis=1) > 0.3 * leg
        near = np.convolve(out & level, np.ones(9), mode="same") > 0
        fist = limb_speed(joints, f"{side}_wrist", FLOOR)
        fast = (fist > 3.0) & (_pace(joints) < 1.5)
        return bool((near & level & fast).any() and fist.max() > limb_speed(joints, f"{other}_wrist", FLOOR).max())

    return holds


def reaches_down(joints: FloatArray) -> bool:
    """Tell whether a wrist gets below 0.6 legs over the floor: below the knee or beside it."""
    return bool(min(_joint(joints, f"{side}_wrist")[:, 1].min() for side in p.SIDES) < 0.6 * leg_length(joints))


def picks_up(joints: FloatArray) -> bool:
    """Tell whether a wrist gets down, see `reaches_down`, and the hips are up at the end, over 0.85 legs."""
    return reaches_down(joints) and bool(hip_height(joints)[-5:].mean() > 0.85)


def hand_up(side: str) -> p.Predicate:
    """Make a predicate: that wrist gets as high as the head joint, to 5 cm."""

    def holds(joints: FloatArray) -> bool:
        return bool((_joint(joints, f"{side}_wrist")[:, 1] - _joint(joints, "head")[:, 1]).max() > -0.05)

    return holds


def hands_down(joints: FloatArray) -> bool:
    """Tell whether no wrist ever gets 0.1 m below its shoulder or higher while above its elbow."""
    return not any(p.raised_hand_paths(joints, side) for side in p.SIDES)


def waves_with(side: str) -> p.Predicate:
    """Make a predicate: that hand waves by its reversals (`predicates.hand_waves`), and the other does not."""
    return lambda joints: all(p.hand_waves(joints, wrist) == (side in (wrist, "both")) for wrist in p.SIDES)


def walks_in(half: int) -> p.Predicate:
    """Make a predicate: the pelvis gets more than 0.5 m over the floor within the first (0) or second (1) half."""

    def holds(joints: FloatArray) -> bool:
        middle = len(joints) // 2
        part = _joint(joints[: middle + 1] if half == 0 else joints[middle:], "pelvis")[:, [0, 2]]
        return bool(np.linalg.norm(part[-1] - part[0]) > 0.5)

    return holds


def _either(make: Mapping[str, p.Predicate]) -> p.Predicate:
    """Make a predicate: it holds of the left or of the right."""
    return lambda joints: any(holds(joints) for holds in make.values())


def _only(make: Mapping[str, p.Predicate], side: str) -> p.Predicate:
    """Make a predicate: it holds of that side alone."""
    return lambda joints: all(holds(joints) == (name == side) for name, holds in make.items())


_UP = {side: hand_up(side) for side in p.SIDES}
_KICKS = {side: kicks_with(side) for side in p.SIDES}
_PUNCHES = {side: punches_with(side) for side in p.SIDES}

RULES: Final[Mapping[str, p.Predicate]] = {
    "forward": goes_forward,
    "backward": goes_backward,
    "leftward": goes_aside("left"),
    "rightward": goes_aside("right"),
    "stays": stays,
    "still": is_still,
    "turn_left": p.turns("left"),
    "turn_right": p.turns("right"),
    "no_turn": lambda joints: abs(p.net_turn(joints)) < 40,
    "around": turns_around,
    "circle": walks_a_circle,
    "stops": comes_to_a_stop,
    "fast": goes_fast,
    "slow": p.slower(1.0),
    "first_walks": walks_in(0),
    "last_walks": walks_in(1),
    "jumps": jumps,
    "crouches": crouches,
    "down": falls,
    "gets_up": gets_up,
    "sits": sits,
    "bows": bows,
    "kicks": _either(_KICKS),
    "kicks_left": _only(_KICKS, "left"),
    "kicks_right": _only(_KICKS, "right"),
    "punches": _either(_PUNCHES),
    "punches_left": _PUNCHES["left"],
    "punches_right": _PUNCHES["right"],
    "reaches_down": reaches_down,
    "picks_up": picks_up,
    "reaches_up": _either(_UP),
    "left_up": _only(_UP, "left"),
    "right_up": _only(_UP, "right"),
    "both_up": lambda joints: all(holds(joints) for holds in _UP.values()),
    "hands_down": hands_down,
    "waves_left": waves_with("left"),
    "waves_right": waves_with("right"),
    "waves_both": waves_with("both"),
    "waves_any": lambda joints: any(p.hand_waves(joints, side) for side in p.SIDES),
    "no_wave": lambda joints: not any(p.hand_waves(joints, side) for side in p.SIDES),
}
"""Rules by name; names that ../shared/prompts has mean the same there, in thresholds of its own."""


def find_rule(name: str) -> p.Predicate:
    """Return the predicate of a rule: a key of `RULES`, "steps:N", or two of these joined by `ORDER`.

    Raises:
        InvalidInputError: there is no such rule.
    """
    if ORDER in name:
        first, second = (find_rule(part) for part in name.split(ORDER, 1))
        return lambda joints: happen_in_order(joints, first, second)
    if name.startswith(STEPS) and name.removeprefix(STEPS).isdecimal():
        wanted = int(name.removeprefix(STEPS))
        return lambda joints: abs(count_steps(joints) - wanted) <= 1
    if name not in RULES:
        raise InvalidInputError(f"no rule is called {short_repr(name)}; rules: {', '.join(RULES)}, {STEPS}N, A{ORDER}B")
    return RULES[name]


def meets(joints: FloatArray, rules: Sequence[str]) -> bool:
    """Tell whether a motion meets all of some rules (`find_rule`)."""
    return all(find_rule(rule)(joints) for rule in rules)
