"""Edits and streams are measured on their own: what is kept, what changed, and what memory a stream takes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kinegraph import MotionPipeline
from kinegraph.motion.skeleton import JOINT_INDEX, start_at_origin
from kinegraph_benchmarks.common.everyday_rules import RULES
from kinegraph_benchmarks.quality import edits
from support.motions import walk


def test_there_are_24_edits_of_known_parts_and_rules() -> None:
    assert 3 * len(edits.EDITS) >= 20 and len(set(edits.EDITS)) == len(edits.EDITS)
    assert {rule for *_, rules in edits.EDITS for rule in rules} <= RULES.keys()


def test_what_is_kept_is_compared_where_it_counts() -> None:
    before = walk(40)
    after = start_at_origin(before)
    before = before + np.array([0.0, 0.0, 1.0], dtype=np.float32)  # the same clip elsewhere
    assert edits.kept_distance(before, after, "legs") == pytest.approx(0, abs=1e-5)
    after[:, JOINT_INDEX["left_foot"], 1] += 0.09
    assert edits.kept_distance(before, after, "legs") == pytest.approx(0.01, abs=1e-4)  # one of nine joints
    assert edits.kept_distance(before, after, "right arm") == pytest.approx(0, abs=1e-5)
    assert edits.kept_distance(before, after, (0.0, 1.0)) == pytest.approx(0.09 / 22, abs=1e-4)


def test_an_edit_is_run_and_summed_up(toy: MotionPipeline) -> None:
    pytest.importorskip("spacy")
    row = edits.run_edit(toy, edits.EDITS[0], 3)
    assert row["kept"] < 0.01 and row["kept"] < row["changed"] and row["keep"] == "legs"
    stream = [
        {"seconds": 30.0, "resident_mb": 200.0, "away_m": 5.0},
        {"seconds": 60.0, "resident_mb": 203.0, "away_m": 9.0},
    ]
    rows: list[dict[str, Any]] = [
        {"text": text, "new_text": new_text, "kept": 0.004, "held_before": False, "holds": True}
        for text, new_text, *_ in edits.EDITS
    ]
    summary = edits.summarise(rows, stream)
    assert summary["met"] == {"kept": True, "text": True, "memory": True} and summary["growth"] == pytest.approx(1.015)
    worse = edits.summarise([rows[0] | {"kept": 0.02, "holds": False}], [*stream, {"resident_mb": 250.0}])
    assert not any(worse["met"].values())
    table = edits.markdown_table({"bundle": "toy 1", "summary": summary, "rows": rows, "stream": stream})
    assert "| 60 | 203.0 | 9 |" in table and "| 0 to 1.5 s | 4.0 | 0.00 | 1.00 |" in table
