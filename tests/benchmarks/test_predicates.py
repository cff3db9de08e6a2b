"""Predicates and metrics on motions made so that the answer is known."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import pytest

from kinegraph.motion.skeleton import JOINT_INDEX, bone_lengths, mirrored
from kinegraph_benchmarks.common import predicates as p
from kinegraph_benchmarks.common.behaviour_prompts import ACTIONS, BEHAVIOURS
from kinegraph_training import metrics
from kinegraph_training.data.clips import read_split
from support.motions import posed, t_pose, turn, walk
from support.shared import shared_path


def gesture(left: float, right: float, frames: int = 40, swing: float = 0.0) -> np.ndarray:
    """Stands; the arms end `left` and `right` radians above the horizontal and swing by `swing` around that."""
    rows = []
    for frame in range(frames):
        part = min(1.0, 2 * frame / frames)
        sway = swing * np.sin(frame)
        up = {16: turn("z", part * left + sway * (left > 0)), 17: turn("z", -part * right - sway * (right > 0))}
        rows.append(posed(np.array([0.0, 0.95, 0.0]), up))
    return np.stack(rows).astype(np.float32)


DOWN, UP = -1.4, 1.2


@pytest.mark.parametrize(("side", "other"), [("left", "right"), ("right", "left")])
def test_a_raised_hand_is_told_from_the_other(side: str, other: str) -> None:
    joints = gesture(UP, DOWN) if side == "left" else gesture(DOWN, UP)
    assert p.raises(side)(joints)
    assert not p.raises(other)(joints)
    assert not p.raises("both")(joints)


def test_both_hands_are_neither_the_left_nor_the_right() -> None:
    joints = gesture(UP, UP)
    assert p.raises("both")(joints)
    assert not p.raises("left")(joints)
    assert not p.raises("right")(joints)


def test_waving_needs_the_wrist_to_travel_and_the_body_to_stay() -> None:
    joints = gesture(UP, DOWN, swing=0.4)
    assert p.waves("left")(joints)
    assert not p.waves("right")(joints)
    assert not p.waves("left")(t_pose(40))
    carried = joints + np.linspace(0, 2, len(joints))[:, None, None] * np.array([0.0, 0.0, 1.0])
    assert not p.waves("left")(carried.astype(np.float32))
    assert p.waves("both")(gesture(UP, UP, swing=0.4))


def test_displacement_is_measured_from_the_first_facing() -> None:
    # The same walk, begun in another heading, is still a walk forward.
    for heading in (0.0, 0.7, -2.0):
        left, forward = p.displacement(walk(41, heading=heading))
        assert forward == pytest.approx(2.0, abs=0.02)
        assert left == pytest.approx(0.0, abs=0.05)
    assert p.goes(1, 1, 0.5)(walk(41))
    assert not p.goes(1, 1, 0.5)(walk(41, speed=-0.05))
    assert p.goes(1, -1, 0.3)(walk(41, speed=-0.05))


def test_sideways_is_left_at_plus_x() -> None:
    slide = t_pose(21) + np.linspace(0, 1, 21)[:, None, None] * np.array([1.0, 0.0, 0.0])
    assert p.goes(0, 1, 0.3)(slide)
    assert not p.goes(0, -1, 0.3)(slide)


def test_turns_have_a_side_and_a_mirror() -> None:
    pivot = np.stack([posed(np.zeros(3), {0: turn("y", angle)}) for angle in np.linspace(0, 4.0, 60)])
    assert p.net_turn(pivot.astype(np.float32)) == pytest.approx(np.degrees(4.0), abs=1e-3)
    joints = walk(61, turning=np.radians(80) / 60)
    assert p.turns("left")(joints)
    assert not p.turns("right")(joints)
    assert p.turns("right")(mirrored(joints))
    assert not p.turns("left")(walk(61, turning=np.radians(30) / 60))
    assert not p.turns("left")(walk(61, turning=np.radians(250) / 60))


def test_speed_is_metres_per_second() -> None:
    assert p.speed(walk(30, speed=0.06)) == pytest.approx(1.2, rel=1e-4)
    assert p.slower(1.3)(walk(30, speed=0.06))
    assert p.faster(1.1)(walk(30, speed=0.06))


def test_a_bow_lowers_the_head() -> None:
    bend = np.stack([posed(np.zeros(3), {0: turn("x", angle)}) for angle in np.linspace(0, 1.0, 20)])
    assert p.bows(bend)
    assert not p.bows(t_pose(20))


def test_standing_still_is_no_behaviour_that_moves() -> None:
    still = t_pose(60)
    holding = {behaviour.name for behaviour in BEHAVIOURS if behaviour.holds(still)}
    # The T-pose has its wrists far apart and that is all it has.
    assert holding == {"opens the arms wide, youthful"}


def test_no_two_contents_share_a_prompt() -> None:
    prompts = [prompt for behaviour in ACTIONS for prompt in behaviour.prompts]
    assert len(prompts) == len(set(prompts))


def test_jerk_of_a_cubic_is_its_third_derivative() -> None:
    seconds = np.arange(30) / 20
    joints = np.zeros((30, 22, 3))
    joints[..., 0] = (seconds**3)[:, None]
    assert metrics.jerk(joints) == pytest.approx(6.0, rel=1e-6)


def test_skating_counts_toes_on_the_floor_only() -> None:
    sliding = t_pose(21) + np.linspace(0, 1, 21)[:, None, None] * np.array([0.0, 0.0, 1.0])
    assert metrics.foot_skate(sliding) == pytest.approx(1.0, rel=1e-4)
    flying = sliding + np.array([0.0, 0.3, 0.0])
    assert np.isnan(metrics.foot_skate(flying))


def test_hand_speed_is_the_busier_hands_and_not_the_bodys() -> None:
    joints = np.repeat(t_pose(1), 21, axis=0) + np.linspace(0, 2, 21)[:, None, None] * np.array([0.0, 0.0, 1.0])
    assert metrics.hand_speed(joints) == pytest.approx(0.0, abs=1e-6)
    joints[1::2, JOINT_INDEX["left_wrist"], 1] += 0.1
    assert metrics.hand_speed(joints) == pytest.approx(2.0)


def test_bone_error_is_in_millimetres() -> None:
    joints = t_pose(3)
    lengths = bone_lengths(joints).mean(0)
    assert metrics.bone_error(joints, lengths) == pytest.approx(0.0, abs=1e-4)
    joints[:, JOINT_INDEX["head"], 1] += 0.021
    assert 0.5 < metrics.bone_error(joints, lengths) < 1.05


def raised_arm(swing: float, cycles: float, frames: int = 80, jitter: float = 0.0) -> np.ndarray:
    """Raise the right arm, swing the forearm by `swing` radians to each side while it is up, and lower the arm."""
    rows, rng = [], np.random.default_rng(0)
    for share in np.linspace(0, 1, frames):
        raised = min(1.0, 4 * np.sin(np.pi * share))
        up = (share - 0.2) / 0.6
        sway = swing * np.sin(2 * np.pi * cycles * up) if 0 < up < 1 else 0.0
        rows.append(
            posed(
                np.array([0.0, 0.95, 0.0]),
                {
                    16: turn("z", -1.4),
                    17: turn("z", 1.4 - 1.6 * raised),
                    19: turn("z", -1.2 * raised + sway + jitter * rng.uniform(-1, 1)),
                },
            )
        )
    return np.stack(rows).astype(np.float32)


def test_a_walkers_swinging_arms_are_no_wave() -> None:
    joints = walk(60)
    assert p.wrist_path(joints, "right") > 0.8
    assert not any(p.waves_beside(side)(joints) for side in ("left", "right", "both"))
    waving = raised_arm(0.4, 3.0, 60) + (joints[:, :1] - joints[:1, :1])
    assert p.waves_beside("right")(waving) and not p.waves("right")(waving)
    assert not p.waves_beside("left")(waving) and not p.waves_beside("both")(waving)


def test_raising_is_no_waving() -> None:
    joints = raised_arm(0.0, 0.0)
    assert p.raises("right")(joints) and p.raises_beside("right")(joints)
    assert p.wrist_path(joints, "right") > 0.8
    assert not p.hand_waves(joints, "right")


@pytest.mark.parametrize("cycles", [1.0, 2.0, 6.0])
@pytest.mark.parametrize("frames", [40, 80, 160])
def test_a_hand_that_goes_to_and_fro_twice_waves(cycles: float, frames: int) -> None:
    joints = raised_arm(0.4, cycles, frames)
    assert p.waves("right")(joints) and not p.waves("left")(joints) and not p.waves("both")(joints)
    assert p.waves("left")(mirrored(joints))
    assert not p.raises("right")(joints)
    # Beside another action, once to and fro may be a sway.
    assert p.raises_beside("right")(joints) == (cycles == 1.0) != p.waves_beside("right")(joints)
    assert p.wave_strokes(joints, "right").max() == pytest.approx(2 * 0.25 * np.sin(0.4), rel=0.2)


def test_a_hand_that_is_held_up_on_the_way_and_sways_is_raised() -> None:
    for swing, sways in ((0.2, True), (0.4, False)):
        joints = raised_arm(swing, 4.0) + (walk(80)[:, :1] - walk(1)[:, :1])
        assert p.raises_beside("right")(joints) == sways and p.waves_beside("right")(joints) != sways
        assert p.hand_waves(joints, "right")  # of somebody who stands, either is a wave


def test_a_raised_hand_that_trembles_does_not_wave() -> None:
    for joints in (raised_arm(0.0, 0.0, jitter=0.04), raised_arm(0.06, 4.0)):
        assert p.raises("right")(joints) and not p.hand_waves(joints, "right")


def test_a_hand_beside_the_shoulder_may_wave_in_quick_flicks() -> None:
    # the upper arm hangs, the forearm stands upright, and the wrist moves by 2 cm or by 4 mm, in 0.5 s or in 2 s
    def flick(angle: float, seconds: float) -> np.ndarray:
        angles = angle * np.sin(2 * np.pi * np.arange(60) / 20 / seconds)
        rows = [posed(np.zeros(3), {17: turn("z", 1.4), 19: turn("z", -2.9 + sway)}) for sway in angles]
        return np.stack(rows).astype(np.float32)

    assert p.hand_waves(flick(0.05, 0.5), "right")
    assert not p.hand_waves(flick(0.01, 0.5), "right") and not p.hand_waves(flick(0.05, 2.0), "right")


def test_turning_points_are_between_moves_of_a_stroke() -> None:
    values = np.array([0.0, 1.0, 0.5, 2.0, 0.9, 1.0, 0.0, 3.0])
    assert p.turning_points(values, 1.0) == [3, 6]
    assert p.turning_points(values, 0.5) == [1, 2, 3, 6]
    assert p.turning_points(-values, 1.0) == [3, 6]
    assert p.turning_points(values[:1], 1.0) == [] and p.turning_points(np.zeros(0), 1.0) == []


def windows(joints: np.ndarray, seconds: float) -> list[np.ndarray]:
    """Cut windows of that length, half a second apart; the whole clip where it is not longer, or for 0 seconds."""
    frames = round(seconds * p.FPS)
    if not frames or len(joints) <= frames:
        return [joints]
    return [joints[start : start + frames] for start in range(0, len(joints) - frames + 1, 10)]


def raised_part(joints: np.ndarray, side: str) -> np.ndarray:
    """Cut out the frames from the first to the last in which the hand is above its elbow."""
    high = joints[:, JOINT_INDEX[f"{side}_wrist"], 1] > joints[:, JOINT_INDEX[f"{side}_elbow"], 1]
    first, last = np.flatnonzero(high)[[0, -1]]
    return joints[first : last + 1]


def test_captured_waves_wave_and_nothing_else_does(figure: Callable[[str], None]) -> None:
    data = shared_path("data", "bandai")
    clips = [clip for split in ("train", "val", "dev_test", "dev_compositional") for clip in read_split(data, split)]
    rates: dict[tuple[str, float], list[bool]] = {}
    for clip, seconds in product(clips, (0.0, 2.0, 3.0, 4.0, 6.0)):
        name = clip.action[:4]
        if name == "wave":
            for side in [side for side in p.SIDES if side in clip.action or "both" in clip.action]:
                part = raised_part(clip.joints, side) if seconds else clip.joints
                held = [p.hand_waves(window, side) for window in windows(part, seconds)]
                rates.setdefault((f"waves, {clip.style}", seconds), []).extend(held)
        elif name in ("walk", "run", "rais"):
            moving = windows(clip.joints, seconds)
            held = [any(p.hand_waves(window, side) for side in p.SIDES) for window in moving]
            rates.setdefault((name, seconds), []).extend(held)
    for (name, seconds), held in rates.items():
        rate, least = float(np.mean(held)), 0.9 if (name, seconds) == ("waves, feminine", 2.0) else 0.95
        assert rate >= least if name.startswith("waves") else rate <= 0.02, (name, seconds, rate)
    for seconds in (0.0, 2.0, 3.0, 4.0, 6.0):
        held = [
            value
            for (name, length), values in rates.items()
            if "waves" in name and length == seconds
            for value in values
        ]
        assert np.mean(held) >= 0.95
        raises = float(np.mean(rates["rais", seconds]))
        what = f"{seconds:g} s of captured clips" if seconds else "whole captured clips"
        figure(f"waving hands: {what}: met by {np.mean(held):.3f} of waves, {raises:.4f} of raises")
