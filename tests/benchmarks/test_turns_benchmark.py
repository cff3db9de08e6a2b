"""How far turns go, on motions whose turns are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinegraph import MotionPipeline
from kinegraph_benchmarks.quality import turns
from kinegraph_training.data.clips import MotionClip
from support.motions import walk
from support.toy import with_parser


def test_turns_are_measured_towards_their_side() -> None:
    joints = walk(61, turning=np.radians(90) / 60)
    assert turns.towards(joints, "left") == pytest.approx(90, abs=6)
    assert turns.towards(joints, "right") == pytest.approx(-90, abs=6)
    assert turns.towards(joints, "right", "a person turns around") == pytest.approx(90, abs=6)


def test_near_is_within_30_percent() -> None:
    row = turns.summarise([62, 64, 90, 116, 118], 90)
    assert (row["median"], row["near"]) == (90, 0.6)


def test_captured_clips_count_by_their_side() -> None:
    right = walk(61, turning=-np.radians(90) / 60)
    clips = [
        MotionClip("a", right, ("a person turns.",), ("walk-turn-right",), ""),
        MotionClip("b", right, ("a person turns.",), ("walk-turn-left",), ""),
        MotionClip("c", right, ("a person walks.",), ("walk",), ""),
    ]
    measured = turns.captured_turns(clips, turns.KINDS["turns while walking"])
    assert np.allclose(measured, [90, -90], atol=6)


def test_as_made_is_without_what_the_sentence_says(tmp_path: Path) -> None:
    pipe = MotionPipeline.load(with_parser(tmp_path / "toy"), threads=1)
    given, made = (
        way.generate("a person turns by 5 degrees", seconds=2, seed=0).joints for way in (pipe, turns.as_made(pipe))
    )
    assert turns.towards(given, "right") == pytest.approx(5, abs=0.1)
    assert turns.towards(made, "right") > 20


def test_every_kind_is_in_the_table() -> None:
    row = {run: turns.summarise([80.0, 90.0], 90.0) for run in ("made", "given")}
    result = {
        "seeds": 2,
        "captured": {name: [90.0] if kind.labels else [] for name, kind in turns.KINDS.items()},
        "bundles": {"toy 1": dict.fromkeys(turns.KINDS, row)},
    }
    table = turns.markdown_table(result)
    assert "| turns while walking | 90 (90 to 90), 1 clips | 85 (81 to 89), 1.00 | 85 (81 to 89), 1.00 |" in table
    assert all(f"| {name} |" in table for name in turns.KINDS)
