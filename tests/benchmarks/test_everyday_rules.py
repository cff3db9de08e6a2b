"""Rules of everyday actions on motions made so that the answer is known, and on captured clips."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from kinegraph.errors import InvalidInputError
from kinegraph.motion.skeleton import JOINT_INDEX, mirrored
from kinegraph_benchmarks.common import everyday_rules as rules
from kinegraph_benchmarks.common.everyday_rules import RULES, find_rule, meets
from kinegraph_benchmarks.quality.everyday_rules import CHECKS, agreement, check_rule, has_label, read_judge
from kinegraph_training.data.clips import MotionClip, read_split
from support.motions import posed, t_pose, turn, walk
from support.shared import shared_path

DOWN = {16: turn("z", -1.3), 17: turn("z", 1.3)}
"""Turns of the shoulders of arms that hang."""
ARCH = np.sin(np.linspace(0, np.pi, 40)) ** 2
"""From nothing to all and back, over two seconds."""


def pose(turns: dict[int, np.ndarray] | None = None, lift: float = 0.0, ahead: float = 0.0) -> np.ndarray:
    """Stand with hanging arms over the floor, the toes `lift` metres above it; joints turned as said."""
    figure = posed(np.array([0.0, 0.95, ahead]), {**DOWN, **(turns or {})})
    figure[:, 1] += lift
    return figure


def clip(rows: list[np.ndarray]) -> np.ndarray:
    return np.stack(rows).astype(np.float32)


def standing(frames: int = 40) -> np.ndarray:
    return clip([pose()] * frames)


def squatting(depth: float, frames: int = 40) -> np.ndarray:
    """Sink by `depth` metres and come up again, feet on the floor and knees to the front."""
    rows = []
    for share in np.sin(np.linspace(0, np.pi, frames)) ** 2:
        figure = pose()
        feet = figure[[7, 8, 10, 11]].copy()
        figure[:, 1] -= depth * share
        figure[[7, 8, 10, 11]] = feet
        for hip, knee, ankle in ((1, 4, 7), (2, 5, 8)):
            figure[knee] = (figure[hip] + figure[ankle]) / 2
            figure[knee, 2] += np.sqrt(max(0.0, 0.405**2 - (np.linalg.norm(figure[hip] - figure[ankle]) / 2) ** 2))
        rows.append(figure)
    return clip(rows)


def jumping(height: float, *, ahead: float = 0.0) -> np.ndarray:
    """Stand, be in the air for 0.45 s, and stand again."""
    path = np.concatenate([np.zeros(15), 4 * height * np.linspace(0, 1, 10) * np.linspace(1, 0, 10), np.zeros(15)])
    return clip([pose(lift=lift, ahead=ahead * n / 39) for n, lift in enumerate(path)])


def falling() -> np.ndarray:
    """Stand for half a second, then tip over to the front and lie."""
    rows = []
    for share in np.concatenate([np.zeros(10), np.linspace(0, 1, 15), np.ones(15)]):
        figure = posed(np.array([0.0, 0.95, 0.0]), {**DOWN, 0: turn("x", share * np.pi / 2)})
        figure[:, 1] += 0.05 - figure[:, 1].min()
        rows.append(figure)
    return clip(rows)


def kicking(angle: float, knee: float = 0.0) -> np.ndarray:
    """Swing the right leg to the front by `angle` radians and back, in one second."""
    shares = np.concatenate([np.zeros(10), np.sin(np.linspace(0, np.pi, 20)), np.zeros(10)])
    return clip([pose({2: turn("x", -angle * share), 5: turn("x", knee * share)}) for share in shares])


def punching(seconds: float) -> np.ndarray:
    """Thrust the right fist from the chest straight ahead at the height of the shoulder, and pull it back."""
    half = max(2, round(seconds * rules.p.FPS / 2))
    shares = np.concatenate([np.zeros(10), np.linspace(0, 1, half), np.linspace(1, 0, half), np.zeros(10)])
    rows = []
    for share in shares:
        figure = pose()
        shoulder = figure[JOINT_INDEX["right_shoulder"]]
        figure[JOINT_INDEX["right_wrist"]] = shoulder + np.array([0.0, -0.05, 0.05 + 0.45 * share])
        rows.append(figure)
    return clip(rows)


def bending(angle: float) -> np.ndarray:
    """Bend the back to the front by `angle` radians and straighten it."""
    return clip([pose({3: turn("x", angle * share)}) for share in ARCH])


def holding(names: tuple[str, ...], joints: np.ndarray) -> list[str]:
    return [name for name in names if find_rule(name)(joints)]


def test_a_body_that_stands_does_nothing_else() -> None:
    met = {name for name, holds in RULES.items() if holds(standing())}
    assert met == {"stays", "still", "no_turn", "slow", "hands_down", "no_wave"}


def test_directions_are_those_of_the_body() -> None:
    ways = ("forward", "backward", "leftward", "rightward")
    assert holding(ways, walk(60)) == ["forward"]
    assert holding(ways, walk(60, heading=2.0)) == ["forward"]
    assert holding(ways, walk(60, speed=-0.05)) == ["backward"]
    aside = standing() + np.linspace(0, 1, 40)[:, None, None] * np.array([1.0, 0.0, 0.0])
    assert holding(ways, aside.astype(np.float32)) == ["leftward"]
    assert holding(ways, mirrored(aside.astype(np.float32))) == ["rightward"]
    # a loop ends where it began, and has gone forward all the way
    loop = walk(120, turning=2 * np.pi / 120)
    assert holding(ways, loop) == ["forward"] and rules.travel(loop)[1] > 4


def test_a_circle_is_walked_and_a_turn_on_the_heel_is_none() -> None:
    loop = walk(120, turning=np.radians(330) / 120)
    assert meets(loop, ["circle", "around"]) and not RULES["turn_left"](loop) and not RULES["no_turn"](loop)
    spin = clip([pose({0: turn("y", angle)}) for angle in np.linspace(0, 4.0, 40)])
    assert meets(spin, ["around", "stays"]) and not RULES["circle"](spin)
    ahead = walk(120)
    about = np.concatenate([ahead[:55], walk(10, turning=np.radians(220) / 10) + ahead[55, 0] * np.array([1, 0, 1])])
    assert not RULES["circle"](about)


def test_stopping_needs_a_walk_before_and_rest_after() -> None:
    moving = walk(40)
    stopped = np.concatenate([moving, np.repeat(moving[-1:], 20, axis=0)])
    assert meets(stopped, ["stops", "forward", "first_walks", "forward>stays"])
    assert not RULES["stops"](moving) and not RULES["stops"](standing())
    assert not RULES["last_walks"](np.concatenate([moving, np.repeat(moving[-1:], 40, axis=0)]))


def test_speed_is_of_one_second() -> None:
    run = walk(40, speed=0.12)
    assert RULES["fast"](np.concatenate([run, np.repeat(run[-1:], 60, axis=0)]))
    assert not RULES["fast"](walk(60, speed=0.06)) and RULES["slow"](walk(60, speed=0.03))


def test_a_jump_is_in_the_air_and_a_crouch_is_not() -> None:
    assert meets(jumping(0.3), ["jumps", "stays"]) and meets(jumping(0.3, ahead=1.0), ["jumps", "forward"])
    assert not RULES["jumps"](jumping(0.05)) and not RULES["jumps"](squatting(0.3)) and not RULES["jumps"](walk(60))
    assert RULES["crouches"](squatting(0.3)) and not RULES["crouches"](squatting(0.08))
    assert not RULES["crouches"](jumping(0.3)) and not RULES["down"](squatting(0.3))


def test_sitting_rests_on_the_height_of_a_chair() -> None:
    down = squatting(0.45)
    seated = np.concatenate([down[:20], np.repeat(down[19:20], 25, axis=0), down[20:]])
    assert RULES["sits"](seated) and RULES["crouches"](seated) and not RULES["sits"](down)
    assert not RULES["sits"](standing()) and not RULES["sits"](falling())


def test_falls_and_getting_up_are_each_other_backwards() -> None:
    fall = falling()
    assert RULES["down"](fall) and not RULES["gets_up"](fall)
    rise = fall[::-1].copy()
    assert RULES["gets_up"](rise) and not RULES["down"](rise)
    assert find_rule("down>gets_up")(np.concatenate([fall, rise])) and not find_rule("down>gets_up")(rise)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_kick_is_a_straight_leg_that_swings_up(side: str) -> None:
    other = "left" if side == "right" else "right"
    kick = kicking(1.4) if side == "right" else mirrored(kicking(1.4))
    assert holding(("kicks", f"kicks_{side}", f"kicks_{other}"), kick) == ["kicks", f"kicks_{side}"]


def test_a_bent_knee_and_a_small_swing_are_no_kick() -> None:
    assert not RULES["kicks"](kicking(0.4)) and not RULES["kicks"](kicking(1.4, knee=2.2))
    assert not RULES["kicks"](walk(60, swing=0.6)) and not RULES["kicks"](falling())


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_punch_is_quick_and_of_one_side(side: str) -> None:
    other = "left" if side == "right" else "right"
    punch = punching(0.3) if side == "right" else mirrored(punching(0.3))
    assert holding(("punches", f"punches_{side}", f"punches_{other}"), punch) == ["punches", f"punches_{side}"]
    assert not RULES["punches"](punching(2.0))


def test_a_bow_leans_and_leaves_the_hips_up() -> None:
    assert meets(bending(0.8), ["bows", "stays"]) and not RULES["bows"](bending(0.2))
    assert not RULES["bows"](squatting(0.3)) and not RULES["bows"](falling())


def test_reaching_down_and_picking_up() -> None:
    deep = squatting(0.5)
    assert RULES["reaches_down"](deep) and RULES["picks_up"](deep) and not RULES["reaches_down"](standing())
    assert RULES["reaches_down"](falling()) and not RULES["picks_up"](falling())


def test_hands_are_told_apart() -> None:
    up = clip([pose({16: turn("z", 1.2 * share - 1.3 * (1 - share))}) for share in ARCH])
    names = ("left_up", "right_up", "both_up", "reaches_up", "hands_down")
    assert holding(names, up) == ["left_up", "reaches_up"]
    assert holding(names, mirrored(up)) == ["right_up", "reaches_up"]
    both = clip([pose({16: turn("z", 1.2 * s - 1.3 * (1 - s)), 17: turn("z", 1.3 * (1 - s) - 1.2 * s)}) for s in ARCH])
    assert holding(names, both) == ["both_up", "reaches_up"]
    assert not RULES["waves_any"](up) and RULES["no_wave"](up)


def test_steps_and_orders_are_rules_too() -> None:
    assert find_rule("steps:6")(walk(60)) and not find_rule("steps:3")(walk(60))
    first, second = walk(40), jumping(0.3)
    joined = np.concatenate([first, second + (first[-1, :1] - second[0, :1]) * np.array([1, 0, 1])])
    assert find_rule("forward>jumps")(joined) and not find_rule("jumps>forward")(joined)


def test_a_rule_that_there_is_not_is_named() -> None:
    for name in ("flies", "steps:x", "forward>flies"):
        with pytest.raises(InvalidInputError, match=r"no rule is called .*forward"):
            find_rule(name)


def test_larger_bodies_are_judged_alike() -> None:
    for make in (lambda: squatting(0.3), lambda: jumping(0.3), falling, lambda: kicking(1.4), lambda: bending(0.8)):
        names = [name for name in ("jumps", "crouches", "down", "kicks", "bows", "reaches_down") if RULES[name](make())]
        for size in (0.9, 1.2):
            assert [name for name in RULES if name in names and RULES[name](make() * size)] == sorted(
                names, key=list(RULES).index
            )


def test_every_check_is_of_a_rule_and_says_both_sides() -> None:
    for name, (right, wrong) in CHECKS.items():
        find_rule(name)
        assert right and wrong and not set(right) & set(wrong)


def labelled(label: str, joints: np.ndarray) -> MotionClip:
    return MotionClip(label, joints, ("a person moves.",), (label,), "")


def test_shares_are_of_the_labels() -> None:
    clips = [labelled("jump-up", jumping(0.3)), labelled("jump-up", standing()), labelled("walk", walk(60))]
    assert has_label(clips[0], ("jump-*",)) and not has_label(clips[2], ("walk-*",))
    assert check_rule("jumps", clips) == {"right_clips": 2, "right": 0.5, "wrong_clips": 1, "wrong": 0.0}
    assert agreement(clips, {"jumps": lambda joints: True, "other": RULES["jumps"]}) == {"jumps": pytest.approx(1 / 3)}


def test_a_judge_is_a_table_of_rules(tmp_path) -> None:
    (tmp_path / "judge.py").write_text("RULES = {'forward': lambda joints: True}")
    assert read_judge(tmp_path / "judge.py")["forward"](t_pose()) is True
    (tmp_path / "empty.py").write_text("")
    with pytest.raises(InvalidInputError, match="no table RULES"):
        read_judge(tmp_path / "empty.py")


def test_captured_clips_meet_the_rules_of_their_labels(figure: Callable[[str], None]) -> None:
    clips = [clip for name in ("bandai", "open") for clip in read_split(shared_path("data", name), "dev_test")]
    rates: dict[str, list[float]] = {"right": [], "wrong": []}
    for name in CHECKS:
        row = check_rule(name, clips)
        for title, least in (("right", 3), ("wrong", 3)):
            if row[f"{title}_clips"] >= least:
                rates[title].append(row[title])
                assert row["right"] is None or row["right_clips"] < 3 or row["right"] >= 0.7, (name, row)
                assert row["wrong"] is None or row["wrong"] <= 0.15, (name, row)
    right, wrong = np.mean(rates["right"]), np.mean(rates["wrong"])
    assert right >= 0.93 and wrong <= 0.02
    figure(f"rules of everyday actions: met by {right:.3f} of captured clips of their labels, {wrong:.3f} of others")
