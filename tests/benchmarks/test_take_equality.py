"""Takes against the clips of their seeds."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph import MotionPipeline
from kinegraph_benchmarks.quality import take_equality
from support.motions import t_pose


def test_distances_are_in_millimetres() -> None:
    still = t_pose(10)
    moved = still.copy()
    moved[4, 3, 1] += 0.022
    distances = take_equality.joint_distances([still, moved], [still, still])
    assert distances["worst_mm"] == pytest.approx(22.0, rel=1e-4)
    assert distances["mean_mm"] == pytest.approx(22.0 / (22 * 10) / 2, rel=1e-4)


def test_takes_of_the_toy_are_compared_both_ways(toy: MotionPipeline) -> None:
    pytest.importorskip("spacy")
    rows = [take_equality.measure_sentence(toy, "a person walks forward", 2.0, count) for count in (2, 3)]
    assert all(row["default"]["worst_mm"] == 0.0 for row in rows)
    assert all(0 <= row["shared_run"]["mean_mm"] <= row["shared_run"]["worst_mm"] < 0.1 for row in rows)
    total = take_equality.summarise(rows)
    assert total["met"] and total["shared_run"]["worst_mm"] == max(row["shared_run"]["worst_mm"] for row in rows)
    table = take_equality.markdown_table("edge", rows, total)
    assert "| a person walks forward | 2 | 3 | 0.00 (0.00) |" in table and "0.1 mm at most, met" in table
    total["default"]["worst_mm"], total["met"] = np.inf, False
    assert "not met" in take_equality.markdown_table("edge", rows, total)
