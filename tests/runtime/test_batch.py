"""Many sentences in one call: each clip is the one of its sentence and seed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kinegraph import InvalidInputError, MotionPipeline
from kinegraph.edits import with_weight
from kinegraph.limits import MAX_TAKES

pytest.importorskip("spacy")

FEW: dict[str, Any] = {"steps": (5, 5, 6)}
TEXTS = ["a person walks forward", "someone raises the left hand and bows", "runs"]


@pytest.mark.parametrize("shared", [False, True])
def test_a_clip_is_that_of_its_sentence_its_length_and_its_seed(toy: MotionPipeline, shared: bool) -> None:
    clips = toy.batch(TEXTS, takes=2, seconds=[1.5, 2, 1], seed=11, foot_fix=False, shared_run=shared, **FEW)
    assert [clip.text for clip in clips] == [text for text in TEXTS for _ in range(2)]
    assert [clip.seed for clip in clips] == [11, 12, 13, 14, 15, 16]
    assert [clip.frames for clip in clips] == [30, 30, 40, 40, 20, 20]
    for clip in clips:
        alone = toy.generate(clip.text, seed=clip.seed, seconds=clip.duration, foot_fix=False, **FEW)
        np.testing.assert_allclose(clip.joints, alone.joints, atol=1e-4 if shared else 0)


def test_without_seconds_every_sentence_decides_for_itself(toy: MotionPipeline) -> None:
    clips = toy.batch(TEXTS, seed=3, **FEW)
    alone = [toy.generate(text, seed=3 + index, **FEW) for index, text in enumerate(TEXTS)]
    assert [clip.frames for clip in clips] == [clip.frames for clip in alone]
    assert len({clip.frames for clip in clips}) > 1


def test_a_shared_batch_is_as_many_runs_as_one_clip(toy: MotionPipeline) -> None:
    seen: list[object] = []
    toy.batch(TEXTS, seconds=1, seed=1, shared_run=True, on_step=lambda info: seen.append(info), **FEW)
    assert len(seen) == 16


def test_graphs_and_sentences_mix(toy: MotionPipeline) -> None:
    clips = toy.batch([toy.parse(TEXTS[0]), TEXTS[0]], seconds=1, seed=1, **FEW)
    assert [clip.text for clip in clips] == [TEXTS[0]] * 2


@pytest.mark.parametrize(
    ("texts", "wishes", "message"),
    [
        ("a person walks", {}, "a batch takes a list"),
        ([], {}, f"1 to {MAX_TAKES} sentences"),
        (TEXTS, {"seconds": [1, 2]}, "2 lengths for 3 sentences"),
        (TEXTS, {"takes": 0}, "takes must be"),
        (TEXTS, {"takes": 22}, "3 sentences of 22 takes; 64 clips at most"),
        ([*TEXTS, " "], {}, "caption is empty"),
        (TEXTS, {"seed": 2**63 - 2}, "seed must be"),
    ],
)
def test_a_wrong_batch_is_refused(toy: MotionPipeline, texts: Any, wishes: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        toy.batch(texts, **wishes)


def test_weighted_graphs_are_refused_in_a_shared_run(toy: MotionPipeline) -> None:
    with pytest.raises(InvalidInputError, match="weigh"):
        toy.batch([TEXTS[0], with_weight(toy.parse(TEXTS[0]), "walks", 2.0)], shared_run=True)
