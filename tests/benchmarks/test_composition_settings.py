"""The table of composing: its pairs are those held out of training, its rows differ, its numbers are rates."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph_benchmarks.common.report_io import write_json
from kinegraph_benchmarks.common.two_action_set import BESIDE
from kinegraph_benchmarks.quality import composition_settings as settings
from support.motions import walk
from support.shared import shared_path


def test_pairs_are_held_out_of_training_and_can_be_judged() -> None:
    held_out = shared_path("data", "held_out_pairs.json")
    together = {frozenset(pair) for pair in json.loads(held_out.read_text())["together"]}
    assert len(set(settings.PAIRS)) == 12
    for pair in settings.PAIRS:
        assert frozenset(pair) in together and set(pair) <= BESIDE.keys() & settings.WORDS.keys()


class Fake:
    """Walks always, and raises both hands where the caption asks for it and the seed is even."""

    def __init__(self) -> None:
        self.asked: list[tuple[Any, ...]] = []

    def generate(self, text: str, *, seconds: float, seed: int) -> Any:
        self.asked.append((text, seed))
        return self._clip("raises both hands" in text and seed % 2 == 0)

    def compose(self, concepts: list[Any], *, seed: int, **how: Any) -> Any:
        self.asked.append((tuple(getattr(each, "weight", 1.0) for each in concepts), seed, *sorted(how.items())))
        return self._clip(False)

    @staticmethod
    def _clip(raised: bool) -> Any:
        joints = walk(40).copy()
        if raised:
            joints[:, [20, 21]] = joints[:, [16, 17]] + np.array([0.0, 1.0, 0.0])  # wrists above the shoulders
        return type("Clip", (), {"joints": joints})


class Judge:
    def embed_motions(self, clips: list[np.ndarray]) -> np.ndarray:
        return np.random.default_rng(0).normal(size=(len(clips), 4))


def test_rates_are_those_of_the_clips(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(settings, "PAIRS", (("walk", "raise-up-both-hands"), ("walk", "wave-right-hand")))
    pipe: Any = Fake()
    reference = np.random.default_rng(0).normal(size=(8, 4))
    found = settings.measure_setting(settings.list_settings()["joint text"], pipe, 4, reference, Judge())  # type: ignore[arg-type]
    assert found["first"] == 1.0 and found["both"] == 0.25
    assert found["per_pair"] == {"walk + raise-up-both-hands": 0.5, "walk + wave-right-hand": 0.0}
    less = settings.measure_negation(pipe, 4, -0.5)
    assert [one["pair"] for one in less["rows"]] == ["walk + raise-up-both-hands"]
    assert less["fallen_by"] == 1.0 and less["kept"] == 1.0 and less["both_met"] == 1
    alike = settings.measure_similar_negation(pipe, 2, -0.5)
    assert alike == {"walks": 1.0, "gesture": 0.0, "metres": pytest.approx(np.ptp(walk(40)[:, 0, 2]))}
    assert pipe.asked[-1][0] == (1.0, 1.0, -0.5)
    result = {"model": "m", "seeds": 4, "settings": {"joint text": found}}
    result |= {"negation": {"-0.5": less}, "alike": {"-0.5": alike}}
    text = settings.markdown_table(result)
    assert "| joint text | 0.250 | 1.000 | 0.250 |" in text
    assert f"| weight -0.5 | 1.00 | 0.00 | {alike['metres']:.2f} |" in text


def test_a_stopped_run_goes_on_with_rows_of_its_own_only(tmp_path: Path) -> None:
    path, how = tmp_path / "settings.json", {"model": "edge 0.2.0", "seeds": 10}
    new = settings.load_partial_result(path, how)
    assert new == {**how, "settings": {}, "negation": {}, "alike": {}}
    new["settings"]["latent"] = {"both": 0.5}
    write_json(path, new)
    assert settings.load_partial_result(path, how) == new
    assert settings.load_partial_result(path, {**how, "seeds": 3})["settings"] == {}


def test_every_setting_asks_for_something_else() -> None:
    asked = set()
    for setting in settings.list_settings().values():
        pipe: Any = Fake()
        setting(pipe, settings.PAIRS[0], 3)
        asked.add(tuple(pipe.asked))
    assert len(asked) == len(settings.list_settings())
