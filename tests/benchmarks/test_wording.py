"""Clockwise, short orders and lengths in words: told on motions whose answers are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kinegraph_benchmarks.common.window_actions import ACTIONS
from kinegraph_benchmarks.quality import wording
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.synthetic.compositions import stitch_clips
from support.motions import stand, walk

BOW = stand(40, bow=1.2)
LEFT, RIGHT = walk(80, turning=0.03), walk(80, turning=-0.03)
ROUND_LEFT, ROUND_RIGHT = walk(200, turning=0.03), walk(200, turning=-0.03)
WALK = walk(100)


class Fake:
    """Turns left unless the sentence says clockwise, bows after walking, and lasts 4 s, or longest for a dance."""

    manifest = type("Manifest", (), {"seconds_limits": (0.8, 9.8)})

    def generate(self, text: str, *, seconds: float = 4.0, seed: int) -> Any:
        right = "clockwise" in text.lower() and not any(part in text.lower() for part in ("counter", "anti"))
        if "bow" in text:
            joints = stitch_clips(WALK[: round(10 * seconds)], BOW)
        else:
            circle = "circle" in text
            joints = (ROUND_RIGHT if circle else RIGHT) if right else (ROUND_LEFT if circle else LEFT)
        return type("Clip", (), {"joints": joints, "duration": 9.8 if "dance" in text else seconds})


def test_each_spelling_turns_to_its_side() -> None:
    pipe: Any = Fake()
    rows = wording.measure_turns(pipe, 2)
    assert len(rows) == len(wording.SPELLINGS) * len(wording.TURNS)
    assert all(row["rate"] == 1.0 for row in rows)
    assert {row["side"] for row in rows if "counter" in row["way"].lower() or "anti" in row["way"]} == {"left"}


def test_orders_are_told_from_the_other_order() -> None:
    pipe: Any = Fake()
    rates = {row["sentence"]: row["rates"] for row in wording.measure_orders(pipe, 1)}
    assert rates["a person walks forward, then bows"] == {"3": 1.0, "4": 1.0, "6": 1.0, "8": 1.0}
    assert rates["a person bows, then walks forward"] == {"3": 0.0, "4": 0.0, "6": 0.0, "8": 0.0}


def test_captured_clips_are_joined_to_the_lengths_asked() -> None:
    motions = {
        "bow": BOW,
        "walk": walk(100),
        "run": walk(80, speed=0.12),
        "raise-up-right-hand": stand(50, wave=2.4, rate=0.0),
    }
    motions["raise-up-both-hands"] = motions["raise-up-right-hand"].copy()
    motions["raise-up-both-hands"][:, [18, 20]] = motions["raise-up-right-hand"][:, [19, 21]] * np.array(
        [-1.0, 1.0, 1.0]
    )
    clips = [MotionClip(a, x.astype(np.float32), ("a person moves.",), (a,), "normal") for a, x in motions.items()]
    report = wording.check_orders(clips, count=1)
    assert report.keys() == {"3", "4", "6", "8"}
    assert all(row["right"] >= 0.8 and row["wrong"] == 0.0 for row in report.values())


def test_lengths_are_those_said_and_never_the_longest() -> None:
    pipe: Any = Fake()
    lengths = wording.measure_lengths(pipe)
    assert len(wording.EVERYDAY) == len(set(wording.EVERYDAY)) == 30
    assert lengths["at_longest"] == 1 and lengths["said_kept"] == pytest.approx(1 / 6)
    turns = wording.measure_turns(pipe, 1)
    orders = wording.measure_orders(pipe, 1)
    checked = {f"{seconds:g}": {"right": 1.0, "wrong": 0.0} for seconds in wording.ORDER_SECONDS}
    result = {"bundle": "edge", "seeds": 1, "turns": turns, "orders": orders, "captured_orders": checked}
    table = wording.markdown_table(result | {"lengths": lengths})
    assert "| anti-clockwise | left | 1.00 | 1.00 | 1.00 | 1.00 | 1.00 |" in table
    assert "| a person walks for four seconds | 4 | 4.00 |" in table and "1 of 30 everyday sentences" in table
    assert {name for _, *names in wording.ORDERS for name in names} <= ACTIONS.keys()
