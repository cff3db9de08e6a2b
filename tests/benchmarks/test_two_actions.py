"""Captions of two actions, and how it is told whether both happen."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph_benchmarks.common import predicates as p
from kinegraph_benchmarks.common.two_action_scores import (
    as_motion_clips,
    rates_by_training,
    tmr_score,
    transition_distance,
)
from kinegraph_benchmarks.common.two_action_set import (
    ALONE,
    BESIDE,
    ONE_HAND,
    TwoActionClip,
    build_two_action_set,
    distinguishable_pairs,
    happen_in_order,
    join_clips,
)
from kinegraph_training.data.clips import MotionClip, read_split
from kinegraph_training.synthetic.compositions import BLEND, HeldOut, stitch_clips
from support.motions import posed, t_pose, turn, walk
from support.shared import shared_path

UP = {16: turn("z", 1.4)}
"""The left arm above the head."""
LIFT = np.stack(
    [posed(np.zeros(3), {16: turn("z", 1.4 * np.sin(np.pi * part))}) for part in np.linspace(0, 1, 30)]
).astype(np.float32)
WALK = walk(40).astype(np.float32)
HELD = HeldOut(frozenset({frozenset(("walk", "raise-up-left-hand"))}), frozenset({("walk", "raise-up-left-hand")}))


def clip(content: str, joints: np.ndarray, style: str = "normal") -> MotionClip:
    return MotionClip(content, joints, (f"a person does {content}.",), (content,), style)


CLIPS = [clip("walk", WALK), clip("raise-up-left-hand", LIFT)]


def test_order_is_told_from_the_other_order() -> None:
    walks, lifts = p.goes(1, 1, 0.5), p.raises("left")
    there, back = stitch_clips(WALK, LIFT), stitch_clips(LIFT, WALK)
    assert happen_in_order(there, walks, lifts) and not happen_in_order(back, walks, lifts)
    assert happen_in_order(back, lifts, walks) and not happen_in_order(there, lifts, walks)
    assert not happen_in_order(WALK, walks, lifts) and not happen_in_order(LIFT, walks, lifts)


def test_both_at_once_are_no_sequence_but_hold_together() -> None:
    (both,) = build_two_action_set(CLIPS, HELD, "together")
    assert both.actions == ("walk", "raise-up-left-hand") and both.held_out
    assert both.holds(both.joints) and not both.holds(WALK) and not both.holds(LIFT)


def test_a_set_holds_each_pair_in_each_order_and_marks_what_is_held_out() -> None:
    items = build_two_action_set(CLIPS, HELD, "in_order")
    assert {(item.actions, item.held_out) for item in items} == {
        (("walk", "raise-up-left-hand"), True),
        (("raise-up-left-hand", "walk"), False),
    }
    first = items[0]
    assert first.joints.shape == (40 + 30 - BLEND, 22, 3) and first.cut == 40 - BLEND // 2
    assert [len(part) for part in first.crops(first.joints)] == [36, 26]
    assert first.holds(first.joints) and not first.holds(first.joints[::-1])
    assert [clip.captions for clip in as_motion_clips(items)] == [(item.caption,) for item in items]


def test_styles_are_not_mixed_and_long_motions_are_left_out() -> None:
    assert build_two_action_set([clip("walk", WALK, "sad"), clip("raise-up-left-hand", LIFT)], HELD, "in_order") == []
    long = clip("walk", walk(190).astype(np.float32))
    assert join_clips("in_order", long, CLIPS[1], HELD, np.random.default_rng(0)) is None


def test_pairs_can_be_told_apart() -> None:
    for kind, judged in (("in_order", ALONE), ("together", BESIDE)):
        pairs = distinguishable_pairs(kind)  # type: ignore[arg-type]
        assert len(pairs) == len(set(pairs)) and all(set(pair) <= set(judged) for pair in pairs)
        assert not any(("left" in a and "left" in b and "walk" not in a + b) for a, b in pairs)


def test_a_hand_may_swing_while_the_body_travels() -> None:
    wave = np.stack([posed(np.zeros(3), {16: turn("z", 0.8 * np.sin(step))}) for step in range(40)])
    moving = wave + np.linspace(0, 2, 40)[:, None, None] * np.array([0, 0, 1.0])
    assert p.swings("left")(moving) and not p.waves("left")(moving) and not p.swings("right")(moving)


def test_scores_with_known_answers() -> None:
    unit = np.eye(3, dtype=np.float32)
    assert (tmr_score(unit, unit), tmr_score(unit, -unit), tmr_score(unit, np.roll(unit, 1, 0))) == (1.0, 0.0, 0.5)
    assert transition_distance(t_pose(30).astype(np.float32), None) == pytest.approx(0.0, abs=1e-7)
    # one joint of 22 jumps 0.22 m once: over 2 x BLEND changes that is 0.01 m / (2 BLEND)
    jump = t_pose(40).astype(np.float32)
    jump[20:, 20, 1] += 0.22
    assert transition_distance(jump, 20) == pytest.approx(0.01 / (2 * BLEND), rel=1e-4)
    # travelling and turning as a whole is no jump
    turned = walk(30, turning=0.1).astype(np.float32)
    straight = walk(30).astype(np.float32)
    assert transition_distance(turned, None) == pytest.approx(transition_distance(straight, None), rel=1e-3)


def test_held_out_pairs_are_counted_apart() -> None:
    items: list[TwoActionClip] = build_two_action_set(CLIPS, HELD, "in_order")
    rates = rates_by_training(items, [items[0].joints, WALK])
    assert rates == {"joined_in_training": {"clips": 1, "both_hold": 0.0}, "held_out": {"clips": 1, "both_hold": 1.0}}


def test_captured_raises_and_waves_are_told_apart_beside_other_actions() -> None:
    clips = read_split(shared_path("data", "bandai"), "train")
    items = build_two_action_set(clips, HELD, "together")
    held: dict[str, list[bool]] = {"raise": [], "wave": [], "raise taken for wave": [], "wave taken for raise": []}
    for item in items:
        for action in item.actions:
            if action not in ONE_HAND or item.style == "feminine":  # those raise no hand above the head
                continue
            kind = action.partition("-")[0]
            other = action.replace("raise-up", "wave") if kind == "raise" else action.replace("wave", "raise-up")
            held[kind].append(BESIDE[action](item.joints))
            held[f"{kind} taken for {'wave' if kind == 'raise' else 'raise'}"].append(BESIDE[other](item.joints))
    rates = {name: float(np.mean(values)) for name, values in held.items()}
    print("beside another action, captured:", {name: round(rate, 3) for name, rate in rates.items()}, len(items))
    assert rates["raise"] >= 0.97 and rates["wave"] >= 0.95
    assert rates["raise taken for wave"] <= 0.02 and rates["wave taken for raise"] <= 0.02
