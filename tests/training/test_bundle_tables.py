"""Tables that a run measures on its clips for the bundle: bone lengths, and the fit of the duration model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinegraph.bundle.tables import DURATION
from kinegraph.conditioning import GraphArrays, expected_frames
from kinegraph.motion.skeleton import PARENTS, bone_lengths
from kinegraph_training.bundle_tables import common_bone_lengths, fit_duration, read_tables, write_tables


def body(size: float) -> np.ndarray:
    """Two frames of a straight chain."""
    depth = [0] * 22
    for child, parent in enumerate(PARENTS):
        depth[child] = depth[parent] + 1 if parent >= 0 else 0
    joints = np.zeros((2, 22, 3), np.float32)
    joints[:, :, 1] = size * np.array(depth)
    return joints


def test_bones_of_one_body_and_of_two() -> None:
    lengths = common_bone_lengths([body(0.2), body(0.2)])
    assert lengths is not None and lengths.shape == (1, 21) and lengths.dtype == np.float32
    np.testing.assert_allclose(lengths[0], bone_lengths(body(0.2))[0], rtol=1e-6)
    assert common_bone_lengths([body(0.2), body(0.25)]) is None


def test_tables_come_back_and_a_run_without_them_has_none(tmp_path: Path) -> None:
    assert read_tables(tmp_path) == {}
    write_tables(tmp_path / "run", {"a": np.ones((1, 3), np.float32)})
    assert read_tables(tmp_path / "run")["a"].tolist() == [[1, 1, 1]]


def graph(sentence: np.ndarray) -> GraphArrays:
    kind, ones = np.array([0, 1]), np.ones((2, 2))
    return GraphArrays(
        np.stack([sentence, sentence]).astype(np.float32),
        kind[None],
        ones.astype(np.float32),
        kind,
        kind,
        ones[0],
        np.arange(2),
    )


def test_a_linear_law_is_found_again() -> None:
    rng = np.random.default_rng(0)
    law = np.array([0.4, -0.3, 0.2])
    sentences = rng.standard_normal((2000, 3))
    samples = [(graph(sentence), round(np.exp(sentence @ law + 4.0))) for sentence in sentences]
    weights = fit_duration(samples)
    assert weights.dtype == np.float32
    for arrays, frames in samples[:50]:
        assert expected_frames(weights, [arrays], 1, 10_000) == pytest.approx(frames, rel=0.06, abs=1)


def test_clips_made_to_any_length_say_nothing_of_it() -> None:
    pytest.importorskip("lightning")
    from kinegraph_training.data.caption_cache import CaptionGraphs
    from kinegraph_training.data.clips import MotionClip
    from kinegraph_training.dataset import Dataset
    from kinegraph_training.train_denoisers import measure_tables

    sentences = np.random.default_rng(1).standard_normal((60, 3))
    graphs = {f"caption {number}": graph(sentence) for number, sentence in enumerate(sentences)}
    captions = CaptionGraphs({}, np.zeros(1), np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0), [])
    object.__setattr__(captions, "get", graphs.get)

    def clips(frames: int, *, any_length: bool) -> list[MotionClip]:
        joints = np.tile(np.arange(66, dtype=np.float32).reshape(22, 3), (frames, 1, 1))
        return [MotionClip("id", joints, (name,), ("walk",), "normal", any_length=any_length) for name in graphs]

    def fit(train: list[MotionClip]) -> np.ndarray:
        return measure_tables(Dataset(train, [], np.zeros(137), np.ones(137)), captions)[DURATION]

    usual = clips(80, any_length=False)
    np.testing.assert_array_equal(fit(usual + clips(30, any_length=True)), fit(usual))
    assert np.abs(fit(usual + clips(30, any_length=False)) - fit(usual)).max() > 0.1
