"""Whether holding feet pays: measured on motions whose sliding is known, and judged by all measures."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kinegraph.motion.postprocess import lock_feet
from kinegraph_benchmarks.quality import foot_fix
from support.motions import walk


def drifting(speed: float) -> np.ndarray:
    """A figure that stands and slides over the floor, `speed` m/s."""
    joints = np.repeat(walk(1), 40, axis=0)
    joints[..., 2] += (np.arange(40) * speed / 20)[:, None]
    return joints


@pytest.mark.parametrize("speed", [0.0, 0.1, 0.4])
def test_the_sliding_of_standing_toes_is_their_speed(speed: float) -> None:
    joints = drifting(speed)
    assert foot_fix.standing_toe_speed(joints, joints) == pytest.approx(speed, abs=1e-4)
    held = lock_feet(drifting(0.03), foot_fix.metrics.FPS)
    assert foot_fix.standing_toe_speed(held, drifting(0.03)) < 0.01


def test_a_toe_that_never_stands_has_no_sliding() -> None:
    assert np.isnan(foot_fix.standing_toe_speed(drifting(2.0), drifting(2.0)))


def rows(**ratios: float) -> list[dict[str, Any]]:
    """One gated behaviour, and one that does not count."""
    before = dict.fromkeys(foot_fix.METRICS, 2.0)
    after = {name: 2.0 * ratios.get(name, 1.0) for name in foot_fix.METRICS}
    found = {"behaviour": "walks", "clips": 3, "captured": before, "without": before, "with": after}
    bad = dict.fromkeys(foot_fix.METRICS, 99.0)
    return [{**found, "gated": True}, {**found, "gated": False, "with": bad}]


@pytest.mark.parametrize(
    ("ratios", "pays"),
    [
        ({"standing_m_s": 0.5}, True),
        ({"standing_m_s": 0.5, "jerk_m_s3": 0.9, "foot_skate_m_s": 0.9}, True),
        ({"standing_m_s": 0.5, "jerk_m_s3": 1.001}, False),
        ({"standing_m_s": 0.5, "leg_jerk_m_s3": 1.001}, False),
        ({"standing_m_s": 1.0, "jerk_m_s3": 0.5}, False),
    ],
)
def test_it_pays_if_toes_slide_less_and_nothing_jerks_more(ratios: dict[str, float], pays: bool) -> None:
    found = rows(**ratios)
    total = foot_fix.summarise(found)
    assert total["on_by_default"] is pays and total["clips"] == 3
    assert ("and is on by default" in foot_fix.markdown_table(found, total)) is pays
