"""Parts of sequences: judged on their own windows, told on motions whose answers are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kinegraph import MotionPipeline
from kinegraph.motion import blending
from kinegraph_benchmarks.common.window_actions import ACTIONS, check_windows, middle_window
from kinegraph_benchmarks.quality import sequences
from kinegraph_training.data.clips import MotionClip
from support.motions import stand, t_pose, walk


def clip(label: str, joints: np.ndarray) -> MotionClip:
    return MotionClip(label, joints.astype(np.float32), ("a person moves.",), (label,), "normal")


def test_windows_of_an_action_meet_its_predicate_and_no_other() -> None:
    clips = [clip("walk", walk(100)), clip("run", walk(60, speed=0.12)), clip("bow", stand(60, bow=1.2))]
    clips += [
        clip("walk-turn-left", walk(80, turning=0.02)),
        clip("raise-up-right-hand", stand(50, wave=2.4, rate=0.0)),
    ]
    names = ["walk", "run", "bow", "turn left", "raise-up right"]
    for name, row in check_windows(clips, names).items():
        assert (row["clips"], row["met"], row["wrong"]) == (1, 1.0, 0.0), name
    assert check_windows(clips, names, style="sad")["walk"] == {"clips": 0, "met": None, "wrong": None}
    assert len(middle_window(t_pose(100), 2.0)) == 40 and len(middle_window(t_pose(20), 2.0)) == 20


def test_a_hand_that_comes_down_from_the_part_before_is_not_raised_in_this_one() -> None:
    raised, standing = stand(50, wave=2.4, rate=0.0), stand(50)
    left_comes_down = raised.copy()
    left_comes_down[:6, 20] = raised[:6, 15] + np.array([0.0, 0.1, 0.0])
    assert ACTIONS["raise-up right"].holds(left_comes_down)
    for joints in (standing, np.where(np.arange(50)[:, None, None] < 3, left_comes_down, standing)):
        assert not any(ACTIONS[f"raise-up {side}"].holds(joints) for side in ("left", "right", "both"))


def test_sequences_have_3_to_8_known_parts() -> None:
    assert len(sequences.SEQUENCES) == len(set(sequences.SEQUENCES)) == 20
    assert {len(names) for names in sequences.SEQUENCES} == set(range(3, 9))
    assert {name for names in sequences.SEQUENCES for name in names} == ACTIONS.keys()
    assert all(len(set(names)) > 1 for names in sequences.SEQUENCES)


def test_a_sequence_is_measured_part_by_part_and_join_by_join(toy: MotionPipeline) -> None:
    pytest.importorskip("spacy")
    limits = dict.fromkeys(ACTIONS, (1e9, 1e-9, 1e9))
    original = blending.best_blend
    row = sequences.measure_sequence(toy, ("walk", "bow", "walk"), 3, limits)
    assert blending.best_blend is original
    assert [part["name"] for part in row["parts"]] == ["walk", "bow", "walk"]
    assert all(0 <= part["length_error"] <= 0.5 for part in row["parts"]) and row["total_error"] <= 0.5
    assert row["parts"][0]["alone"] is True and row["parts"][0]["in_sequence"] is True
    assert row["parts"][0]["in_other_parts"] == 0.0
    assert [join["between"] for join in row["joins"]] == [["walk", "bow"], ["bow", "walk"]]
    assert all(join["of_captured"][0] < 1 < join["of_captured"][1] for join in row["joins"])


def test_parts_of_one_run_are_compared_with_clips_of_skeleton_space(
    toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("spacy")
    spaces: list[str] = []
    generate = type(toy).generate
    monkeypatch.setattr(
        type(toy), "generate", lambda pipe, *words, **how: spaces.append(how["space"]) or generate(pipe, *words, **how)
    )
    limits = dict.fromkeys(ACTIONS, (1e9, 1e9, 1e9))
    row = sequences.measure_sequence(toy, ("walk", "bow"), 3, limits, "energy")
    assert spaces == ["frames", "frames"] and row["total_error"] == 0.0
    assert row["parts"][0]["alone"] is True and row["parts"][0]["in_sequence"] is True


def test_rates_lengths_and_joins_are_summed_up() -> None:
    def part(name: str, alone: bool, within: bool, error: float = 0.1) -> dict[str, Any]:
        return {"name": name, "alone": alone, "in_sequence": within, "in_other_parts": 0.0, "length_error": error}

    runs = [
        {
            "parts": [part("walk", True, True), part("bow", True, False, 0.6), part("walk", False, False)],
            "joins": [{"of_captured": [0.5, 0.9, 0.9]}, {"of_captured": [1.5, 0.9, 0.9]}],
            "total_error": 0.2,
            "cpu": 3.0,
            "cpu_alone": 2.0,
        }
    ]
    total = sequences.summarise(runs)
    assert total["all"] | {"parts": 3} == total["all"]
    assert (total["all"]["alone"], total["all"]["ratio"], total["all"]["kept"]) == pytest.approx((2 / 3, 0.5, 0.5))
    assert total["by_action"]["walk"]["kept"] == 1.0 and total["by_action"].keys() == {"walk", "bow"}
    assert (total["length_error_s"], total["acceleration_within"], total["velocity_within"]) == (0.6, 0.5, 1.0)
    assert total["met"] == {"parts": False, "lengths": False, "joins": False}
    windows = {name: {"met": 1.0, "wrong": 0.0} for name in ACTIONS}
    memory = [{"parts": 4, "seconds": 16.0, "resident_mb": 400.0, "peak_mb": 401.0}]
    table = sequences.markdown_table(
        {
            "bundle": "edge",
            "method": "blend",
            "lengths": "3 to 8",
            "seeds": 1,
            "summary": total,
            "captured_windows": windows,
            "memory": memory,
        }
    )
    assert "| walk | 4 | 1.00, 0.000 | 2 | 0.500 | 0.500 | 1.000 | 1.000 | 0.000 |" in table
    assert "| 4 | 16 | 400 | 401 |" in table


def test_captured_limits_are_those_of_the_windows_of_each_action() -> None:
    clips = [clip(action.label, walk(60, speed=0.05)) for action in ACTIONS.values()]
    limits = sequences.captured_limits(clips)
    assert limits.keys() == ACTIONS.keys()
    assert limits["walk"][1] == pytest.approx(sequences.peak_motion(walk(60, speed=0.05))[1], rel=0.1)
    assert sequences.peak_motion(t_pose(10)) == (0.0, 0.0, 0.0)
