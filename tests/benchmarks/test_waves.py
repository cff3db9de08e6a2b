"""Width and reversals of waves, on motions whose waves are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kinegraph_benchmarks.common import predicates as p
from kinegraph_benchmarks.quality import waves
from kinegraph_training.data.clips import MotionClip
from support.motions import posed, stand, turn


def waving(radians: float, cycles: float, frames: int = 60) -> np.ndarray:
    """Stand with the right forearm upright and swing it to both sides, the left arm hanging."""
    angles = radians * np.sin(2 * np.pi * cycles * np.arange(frames) / frames)
    rows = [posed(np.zeros(3), {16: turn("z", -1.4), 19: turn("z", -np.pi / 2 + angle)}) for angle in angles]
    return np.stack(rows).astype(np.float32)


def test_width_is_that_of_a_stroke_and_reversals_are_counted_while_the_hand_is_up() -> None:
    joints = waving(0.4, 3)
    assert waves.wave_width(joints, "right") == pytest.approx(2 * 0.25 * np.sin(0.4), rel=0.05)
    assert waves.wide_reversals(joints, "right") == 6
    assert waves.wave_width(joints, "left") == waves.wide_reversals(joints, "left") == 0
    assert waves.wave_width(joints, "both") == 0.0


class Fake:
    """Waves the right hand where the sentence says so, whatever the length."""

    def generate(self, text: str, *, seconds: float, seed: int) -> Any:
        joints = waving(0.4, 3, round(20 * seconds)) if "wav" in text and "right" in text else stand(40)
        return type("Clip", (), {"joints": joints})


def test_rates_are_those_of_the_clips() -> None:
    clips = [
        MotionClip("a", waving(0.4, 6, 140), ("a person waves.",), ("wave-right-hand",), "normal"),
        MotionClip("b", stand(140), ("a person waves.",), ("wave-left-hand",), "sad"),
        MotionClip("c", stand(140), ("a person bows.",), ("bow",), "normal"),
    ]
    pipe: Any = Fake()
    row = waves.measure_length(pipe, clips, 3.0, 2)
    assert (row["captured"]["clips"], row["captured"]["rate"], row["captured_normal"]["rate"]) == (2, 0.5, 1.0)
    # right of left, right, both; three prompts of each
    assert row["waves"] | {"clips": 18, "rate": pytest.approx(1 / 3), "width_cm": 0.0, "reversals": 2.0} == row["waves"]
    assert row["walking"]["clips"] == 6 and row["raises"] == {"clips": 18, "wave": 0.0}
    table = waves.markdown_table("edge", [row])
    assert "| 3 s | 0.50, " in table and "1.00, 19 cm, 5.0" in table
    assert len(waves.captured_clips(clips, 3.0, None)[0][1]) == 3 * p.FPS
