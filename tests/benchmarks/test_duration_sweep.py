"""Whether sentences mean the same at any length: told on motions whose turns are known."""

from __future__ import annotations

import json

import pytest

from kinegraph_benchmarks.common.behaviour_prompts import ACTIONS
from kinegraph_benchmarks.quality import duration_sweep
from support.motions import walk

BY_NAME = {behaviour.name: behaviour for behaviour in ACTIONS}


@pytest.mark.parametrize(("turning", "walks", "left"), [(0.0, True, False), (0.03, False, True), (-0.03, False, False)])
def test_a_walk_that_turns_is_no_walk_forward_but_may_be_a_turn(turning: float, walks: bool, left: bool) -> None:
    joints = walk(60, turning=turning)
    assert duration_sweep.holds(BY_NAME["walks"], joints) is walks
    assert duration_sweep.holds(BY_NAME["turns left"], joints) is left


def test_every_behaviour_counts_the_same() -> None:
    rows = [
        {"behaviour": name, "captured": 1.0, "captured_seconds": [1.0, 2.0, 3.0], "clips": 30, "generated": rates}
        for name, rates in (("walks", {"2": 1.0, "4": 0.5}), ("bows", {"2": 0.0, "4": 0.5}))
    ]
    total = duration_sweep.summarise(rows)
    assert total == {"captured": 1.0, "generated": {"2": 0.5, "4": 0.5}}
    found = duration_sweep.markdown_table(rows, total)
    assert "| walks | 2.0 (1.0 to 3.0) | 1.00 | 1.00 | 0.50 |" in found and "30 generated clips a cell" in found
    json.dumps(total)
