"""Fitting the length of clips to their captions."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.conditions import GraphArrays
from kinegraph.duration import expected_frames
from kinegraph_training.duration import fit_duration


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
