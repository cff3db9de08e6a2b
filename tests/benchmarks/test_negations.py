"""Negated actions: the sentences, and how it is told that an action is gone and the rest is there."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kinegraph_benchmarks.quality import negations
from kinegraph_benchmarks.quality.behaviour import SPLITS
from kinegraph_training.data.clips import read_split
from support.motions import stand, t_pose, walk
from support.shared import shared_path


def test_there_are_eight_forms_of_every_pair_that_has_words_for_them() -> None:
    assert len(negations.FORMS) == 8
    sentences = [negations.sentence_of(form, *pair) for form in negations.FORMS for pair in negations.PAIRS]
    written = [sentence for sentence in sentences if sentence is not None]
    assert len(written) == len(set(written)) == 74
    assert "a person walks forward but does not wave the right hand" in written
    assert "a person walks forward keeping both hands down" in written
    assert negations.sentence_of("keeping ... down", "walk", "turn") is None


def test_an_action_happens_or_it_does_not() -> None:
    straight, raised = walk(80), stand(60, wave=2.4, rate=0.0)
    holding = {
        name: [action.happens(joints) for joints in (straight, walk(80, turning=0.02), walk(60, speed=0.12), raised)]
        for name, action in negations.NEGATED.items()
    }
    assert holding["walk"] == [True, True, True, False]
    assert holding["turn"] == [False, True, False, False]
    assert holding["run"] == [False, False, True, False]
    assert holding["wave right"] == holding["wave both"] == holding["raise both"] == [False, False, False, True]
    assert not negations.NEGATED["bow"].happens(t_pose(60))
    assert negations.NEGATED["bow"].happens(stand(60, bow=1.2))


def test_what_stops_may_happen_at_first() -> None:
    joints = np.concatenate([stand(40, wave=2.4, rate=0.0), stand(40)])
    happens = negations.NEGATED["raise both"].happens
    assert happens(negations.last_half("never", joints)) and not happens(negations.last_half("stop ...ing", joints))


class Fake:
    """Walks, and raises the hand wherever a sentence names it, but for "without": then it does what it is told."""

    def generate(self, text: str, *, seconds: float, seed: int) -> Any:
        joints = walk(80)
        if "hand" in text and "without" not in text:
            joints[:, [18, 20]] = joints[:, [16]] + np.array([[0.0, 0.2, 0.0], [0.0, 0.4, 0.0]])
            joints[:, [19, 21]] = joints[:, [17]] + np.array([[0.0, 0.2, 0.0], [0.0, 0.4, 0.0]])
        return type("Clip", (), {"joints": joints})


def test_rates_are_those_of_the_clips() -> None:
    pipe: Any = Fake()
    rows = negations.measure_pair(pipe, "walk", "raise both", 2)
    assert [row["form"] for row in rows] == list(negations.FORMS)
    assert [row["gone"] for row in rows] == [1.0, *[0.0] * 7]
    assert all(row["rest"] == row["rest_without_negation"] == row["happens_if_asked"] == 1.0 for row in rows)
    total = negations.summarise(rows)
    assert total["by_form"]["without ...ing"]["met"] and not total["by_form"]["never"]["met"]
    assert total["all"]["gone"] == pytest.approx(1 / 8) and total["by_action"].keys() == {"raise both"}
    windows = {name: {"met": 1.0, "wrong": 0.0} for name in negations.NEGATED}
    table = negations.markdown_table(
        {"bundle": "edge", "seeds": 2, "summary": total, "rows": rows, "captured_windows": windows}
    )
    assert "| without ...ing | 1 | 1.000 | 1.000 | 1.000 | yes |" in table and "7 of 8 sentences miss a goal" in table


def test_predicates_hold_of_captured_windows_and_of_no_others() -> None:
    data = shared_path("data", "bandai")
    for row in negations.check_captured([clip for split in SPLITS for clip in read_split(data, split)]).values():
        assert row["met"] >= 0.98 and row["wrong"] <= 0.02
