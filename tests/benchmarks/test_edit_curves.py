"""Judging a curve: monotone, and further than the spread over seeds."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph import MotionPipeline
from kinegraph_benchmarks.quality import edit_curves
from support.motions import walk


def values(means: list[float], spread: float) -> np.ndarray:
    """(weights, seeds) with these means; the standard deviation over three seeds is `spread`."""
    return np.array(means)[:, None] + spread * np.array([-1.0, 0.0, 1.0])


@pytest.mark.parametrize(
    ("means", "spread", "sense", "met"),
    [
        ([0, 1, 2, 3, 4, 5, 6, 7, 8], 7.9, 1, True),
        ([0, 1, 2, 3, 4, 5, 6, 7, 8], 8.1, 1, False),
        ([8, 7, 6, 5, 4, 3, 2, 1, 0], 1.0, 1, False),
        ([8, 7, 6, 5, 4, 3, 2, 1, 0], 1.0, -1, True),
        ([0, 3, 6, 9, 8, 4, 5, 2, 1], 1.0, 1, False),
        ([1, 1, 1, 1, 1, 1, 1, 1, 1], 0.1, 1, False),
    ],
)
def test_a_curve_is_met_if_it_is_monotone_and_goes_far_enough(
    means: list[float], spread: float, sense: int, met: bool
) -> None:
    found = edit_curves.judge_curve(values(means, spread), sense)
    assert found["met"] is met and found["mean"] == pytest.approx(means)


def test_a_cliff_is_steep() -> None:
    assert edit_curves.judge_curve(values([0, 1, 2, 3, 4, 5, 6, 7, 8], 1), 1)["steepest"] == pytest.approx(1 / 8)
    assert edit_curves.judge_curve(values([0, 0, 0, 4, 4, 4, 4, 4, 4], 1), 1)["steepest"] == 1
    assert edit_curves.judge_curve(values([1] * 9, 1), 1)["steepest"] == 0


def test_rank_correlation_is_that_of_the_textbook() -> None:
    # 1 - 6 sum d^2 / (n (n^2 - 1)) where no values are equal
    first, second = np.array([86.0, 97, 99, 100, 101]), np.array([2.0, 20, 28, 27, 50])
    assert edit_curves.spearman(first, second) == pytest.approx(1 - 6 * 2 / (5 * 24))
    assert edit_curves.ranks(np.array([3.0, 1, 3, 0])).tolist() == [3.5, 2, 3.5, 1]


def test_quantities_measure_what_they_name() -> None:
    ahead, still = walk(60, speed=0.06), walk(60, speed=0.0)
    assert edit_curves.seconds_walking(ahead) == 59 / 20 and edit_curves.seconds_walking(still) == 0.0
    raised = still.copy()
    raised[:30, 21, 1] = 2.5
    assert edit_curves.seconds_raised(raised) == 1.5
    assert edit_curves.wrist_above_other("right")(raised) > 0.3 > abs(edit_curves.wrist_above_other("right")(still))
    assert edit_curves.turn_to(1)(walk(60, turning=0.01)) == -edit_curves.turn_to(-1)(walk(60, turning=0.01))


def test_every_edge_is_found_by_the_parser(pipe: MotionPipeline) -> None:
    from kinegraph.edits import number_of

    for curve in edit_curves.CURVES:
        assert number_of(pipe.parse(curve.caption), curve.node) >= 1
