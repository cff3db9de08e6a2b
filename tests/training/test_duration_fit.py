"""Fitting the length of clips to their captions."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.bundle.tables import DURATION
from kinegraph.conditioning import GraphArrays, expected_frames
from kinegraph_training.bundle_tables import fit_duration


def graph(sentence: np.ndarray) -> GraphArrays:
    kind, one = np.array([0, 1]), np.ones((2, 2))
    return GraphArrays(
        np.stack([sentence, sentence]).astype(np.float32), kind[None], one.astype(np.float32), kind, kind, one[0]
    )


def test_a_linear_law_is_found_again() -> None:
    rng = np.random.default_rng(0)
    law = np.array([0.4, -0.3, 0.2])
    sentences = rng.standard_normal((2000, 3))
    pairs = [(graph(one), round(np.exp(one @ law + 4.0))) for one in sentences]
    weights = fit_duration(pairs)
    assert weights.dtype == np.float32
    for one, frames in pairs[:50]:
        assert expected_frames(weights, [one], 1, 10_000) == pytest.approx(frames, rel=0.06, abs=1)


def test_clips_made_to_any_length_say_nothing_of_it() -> None:
    pytest.importorskip("lightning")
    from kinegraph_training.data.caption_cache import CaptionGraphs
    from kinegraph_training.data.clips import MotionClip
    from kinegraph_training.dataset import Dataset
    from kinegraph_training.train_denoisers import measured

    sentences = np.random.default_rng(1).standard_normal((60, 3))
    graphs = {f"caption {number}": graph(one) for number, one in enumerate(sentences)}
    known = CaptionGraphs({}, np.zeros(1), np.zeros(0), np.zeros(0), np.zeros(0), [])
    object.__setattr__(known, "get", graphs.get)

    def clips(frames: int, *, any_length: bool) -> list[MotionClip]:
        joints = np.tile(np.arange(66, dtype=np.float32).reshape(22, 3), (frames, 1, 1))
        return [MotionClip("id", joints, (name,), "walk", "normal", any_length=any_length) for name in graphs]

    def fitted(found: list[MotionClip]) -> np.ndarray:
        return measured(Dataset(found, [], np.zeros(137), np.ones(137)), known)[DURATION]

    usual = clips(80, any_length=False)
    np.testing.assert_array_equal(fitted(usual + clips(30, any_length=True)), fitted(usual))
    assert np.abs(fitted(usual + clips(30, any_length=False)) - fitted(usual)).max() > 0.1
