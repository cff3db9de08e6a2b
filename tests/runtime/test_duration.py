"""The length that a sentence asks for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinegraph.bundle.reader import read_bundle
from kinegraph.bundle.tables import EXTRA_INPUTS
from kinegraph.conditioning import ACTION, MOTION, SPECIFIC, GraphArrays, duration_inputs, expected_frames, with_words
from kinegraph.errors import BundleFormatError
from support.synthetic_bundle import TEXT_WIDTH, bundle_files, tables_npz, write_bundle

WIDTH = 3


def graph(sentence: list[float], actions: int = 1, specifics: int = 0) -> GraphArrays:
    count = 1 + actions + specifics
    nodes = np.zeros((count, WIDTH), dtype=np.float32)
    nodes[0] = sentence
    kind = np.array([MOTION] + [ACTION] * actions + [SPECIFIC] * specifics)
    zeros = np.zeros((count, count))
    return GraphArrays(
        nodes, zeros.astype(np.int64), zeros.astype(np.float32), kind, kind, np.ones(count), np.arange(count)
    )


def test_inputs_are_the_sentence_and_two_counts() -> None:
    np.testing.assert_array_equal(duration_inputs(graph([1, 2, 3], 2, 4)), [1, 2, 3, 2, 7, 1])


def test_words_are_no_nodes_of_the_graph() -> None:
    plain = graph([1, 2, 3], 2, 1)
    hidden = np.zeros((6, WIDTH), dtype=np.float32)
    with_them = with_words(plain, hidden, np.array([-1, 1, 3, 0, 2, -1]))
    assert len(with_them.kind) == 8 and with_them.node_count == 4
    np.testing.assert_array_equal(duration_inputs(with_them), duration_inputs(plain))


def test_frames_are_the_exponential_of_a_linear_form() -> None:
    weights = np.array([[0.5, 0.0, 0.0, 0.25, 0.0, 3.0]], dtype=np.float32)
    expected = round(np.exp(0.5 * 2 + 0.25 * 1 + 3.0))
    assert expected_frames(weights, [graph([2, 0, 0])], 16, 196) == expected
    # Of several sentences the longest decides.
    assert expected_frames(weights, [graph([0, 0, 0]), graph([2, 0, 0])], 16, 196) == expected


@pytest.mark.parametrize(("size", "frames"), [(1e6, 196), (-1e6, 16)])
def test_an_odd_sentence_stays_within_the_limits(size: float, frames: int) -> None:
    weights = np.array([[size, 0, 0, 0, 0, 0]], dtype=np.float32)
    assert expected_frames(weights, [graph([1, 0, 0])], 16, 196) == frames


def test_a_bundle_may_carry_it_or_not(tmp_path: Path) -> None:
    weights = np.ones((1, TEXT_WIDTH + EXTRA_INPUTS), dtype=np.float32)
    with_it = {**bundle_files(), "tables.npz": tables_npz(duration=weights)}
    np.testing.assert_array_equal(read_bundle(write_bundle(tmp_path / "a", with_it)).tables["duration"], weights)
    assert "duration" not in read_bundle(write_bundle(tmp_path / "b")).tables
    wrong = {**bundle_files(), "tables.npz": tables_npz(duration=weights[0])}
    with pytest.raises(BundleFormatError, match="duration"):
        read_bundle(write_bundle(tmp_path / "c", wrong))
