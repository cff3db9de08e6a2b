"""The table of composition: what is asked for, and rates, leaks and curves of clips whose answer is known."""

from __future__ import annotations

from itertools import combinations
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from kinegraph_benchmarks.common.two_action_set import BESIDE
from kinegraph_benchmarks.quality import composition
from kinegraph_benchmarks.quality.composition_settings import PAIRS, WORDS
from support.motions import t_pose, walk


class Fake:
    """Walks if it is told to; raises both hands by as much as that concept weighs, at most over the head."""

    def __init__(self) -> None:
        self.asked: list[tuple[Any, ...]] = []

    def generate(self, text: str, *, seconds: float, seed: int) -> Any:
        self.asked.append((text, seed))
        return self._clip("walks" in text, 1.0 if "raises both hands" in text else 0.0)

    def compose(self, concepts: list[Any], *, seed: int, seconds: float, **how: Any) -> Any:
        self.asked.append((*sorted(how.items()), seed))
        texts = [getattr(concept, "text", concept) for concept in concepts]
        weights = [getattr(concept, "weight", 1.0) for concept in concepts]
        raised = sum(w for text, w in zip(texts, weights, strict=True) if "raises both hands" in text)
        return self._clip(any("walks forward" in text for text in texts), raised + 0.01 * seed)

    @staticmethod
    def _clip(walks: bool, raised: float) -> Any:
        joints = walk(40).copy() if walks else t_pose(40)
        joints[:, [20, 21]] = joints[:, [16, 17]] + np.array([0.0, raised - 0.3, 0.0])
        return type("Clip", (), {"joints": joints.astype(np.float32)})


def test_triples_are_of_the_legs_and_both_hands_and_can_be_judged() -> None:
    assert len(set(composition.TRIPLES)) == 8
    for triple in composition.TRIPLES:
        assert set(triple) <= BESIDE.keys() & WORDS.keys()
        assert ("left" in triple[1]) != ("left" in triple[2])
    assert composition.sentence_for(composition.TRIPLES[0]) == (
        "a person walks forward while raising the left hand and waving the right hand"
    )
    assert composition.sentence_for(PAIRS[0]) == "a person walks forward while a person raises both hands"


def test_every_method_asks_for_something_else() -> None:
    asked = set()
    for method in (*composition.METHODS, composition.SENTENCE):
        pipe: Any = Fake()
        composition.generate_together(pipe, PAIRS[0], method, 2)
        assert len(pipe.asked) == 2
        asked.add(tuple(pipe.asked))
    assert len(asked) == 7


def test_rates_are_those_of_the_clips() -> None:
    pipe: Any = Fake()
    found = composition.measure_together(pipe, [("walk", "raise-up-both-hands"), ("walk", "wave-right-hand")], 3)
    assert found["latent"]["each"] == [1.0, 0.5] and found["latent"]["all"] == 0.5
    assert found["one sentence"]["by_set"] == {"walk + raise-up-both-hands": 1.0, "walk + wave-right-hand": 0.0}


def test_leaks_are_travels_of_gestures_and_hands_of_travels() -> None:
    pipe: Any = Fake()
    pipe._clip = lambda walks, raised: Fake._clip(True, raised)
    found = composition.measure_uncalled(pipe, 2)
    assert found["travel"] == 1.0 and found["gesture"] == 0.0
    pipe._clip = lambda walks, raised: Fake._clip(walks, 1.0)
    found = composition.measure_uncalled(pipe, 2)
    assert found["travel"] == 0.0 and found["gesture"] == 1.0


def test_a_curve_that_rises_with_the_weight_is_met(monkeypatch: pytest.MonkeyPatch) -> None:
    rising = composition.WeightCurve("walk", "raise-up-both-hands", composition.hand_over_head("left", "right"), "m")
    flat = composition.WeightCurve("walk", "raise-up-left-hand", composition.metres(1, 1.0), "m")
    monkeypatch.setattr(composition, "CURVES", (rising, flat))
    pipe: Any = Fake()
    found = composition.measure_curves(pipe, 3)
    assert [row["met"] for row in found["latent"]["curves"]] == [True, False] and found["fused"]["met"] == 1
    row = found["semantic"]["curves"][0]
    assert row["spearman"] == 1.0 and row["spread"] == pytest.approx(0.01, rel=1e-3)
    assert row["moved"] == pytest.approx(1.9 / 0.01, rel=1e-3)


def test_quantities_have_the_sign_that_the_words_say() -> None:
    assert composition.metres(1, 1.0)(walk(41)) == pytest.approx(2.0, abs=0.02)
    assert composition.metres(1, -1.0)(walk(41, speed=-0.05)) == pytest.approx(2.0, abs=0.02)
    raised = Fake._clip(False, 1.0).joints
    assert composition.hand_over_head("left")(raised) > 0.4 > composition.hand_over_head("left")(t_pose(3))


def test_the_table_has_a_column_for_each_bundle() -> None:
    pipe: Any = Fake()
    parts = {
        "pairs": composition.measure_together(pipe, PAIRS[:1], 2),
        "uncalled": composition.measure_uncalled(pipe, 2),
        "curves": composition.measure_curves(pipe, 2),
    }
    text = composition.markdown_table({"seeds": 2, "bundles": {"a": parts, "b": parts}})
    assert "| both, latent | 1.000 | 1.000 |" in text and "| gestures that travel | 0.000 | 0.000 |" in text
    assert text.count("curves met; goal 6") == 2 * len(composition.CURVE_METHODS)
    assert all(first != second for first, second in combinations(composition.CURVES, 2))


@pytest.mark.parametrize("part", composition.PARTS)
def test_a_space_is_that_of_every_clip(part: str, monkeypatch: pytest.MonkeyPatch) -> None:
    fake, spaces = Fake(), []

    def noted(call: Any) -> Any:
        return lambda *words, space, **how: spaces.append(space) or call(*words, **how)

    pipe: Any = SimpleNamespace(generate=noted(fake.generate), compose=noted(fake.compose))
    for name, value in (("PAIRS", PAIRS[:1]), ("TRIPLES", composition.TRIPLES[:1]), ("CURVES", composition.CURVES[:1])):
        monkeypatch.setattr(composition, name, value)
    composition.MEASURES[part](pipe, 2, space="frames")
    assert set(spaces) == {"frames"}
