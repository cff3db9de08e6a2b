"""Metrics on cases whose answer is known beforehand."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinegraph_training.metrics import (
    bootstrap,
    distances,
    diversity,
    frechet_distance,
    gaussian_frechet,
    label_groups,
    matching_distance,
    multimodality,
    r_precision,
)

RNG = np.random.default_rng


def test_distances_are_pythagoras() -> None:
    a, b = np.array([[0.0, 0.0], [3.0, 0.0]]), np.array([[0.0, 4.0]])
    np.testing.assert_allclose(distances(a, b), [[4.0], [5.0]])


def test_identical_sets_are_retrieved_perfectly() -> None:
    x = RNG(0).standard_normal((32, 8))
    np.testing.assert_array_equal(r_precision(x, x), [1, 1, 1])
    assert matching_distance(x, x) == 0.0


def test_shuffled_sets_are_retrieved_by_chance() -> None:
    x = RNG(1).standard_normal((32, 8))
    hits = np.mean([r_precision(x, x[RNG(seed).permutation(32)]) for seed in range(800)], axis=0)
    np.testing.assert_allclose(hits, [1 / 32, 2 / 32, 3 / 32], atol=0.006)


def test_ranks_are_counted_by_hand() -> None:
    # Text 0 is nearest to motion 1, then 0; text 1 to its own; text 2 has both others before its own.
    texts = np.array([[0.0], [10.0], [3.0]])
    motions = np.array([[2.0], [9.0], [20.0]])
    table = distances(texts, motions)
    assert table.argsort(axis=1)[:, 0].tolist() == [0, 1, 0]
    np.testing.assert_allclose(r_precision(texts, motions), [2 / 3, 2 / 3, 1.0])


def test_a_model_that_answers_everything_alike_scores_nothing() -> None:
    texts = RNG(2).standard_normal((10, 4))
    np.testing.assert_array_equal(r_precision(texts, np.ones((10, 4))), [0, 0, 0])


@settings(max_examples=60)
@given(st.lists(st.integers(0, 9), min_size=1, max_size=60), st.integers(2, 12), st.integers(0, 5))
def test_groups_hold_each_label_once_and_each_row_at_most_once(numbers: list[int], size: int, seed: int) -> None:
    labels = [str(number) for number in numbers]
    groups = label_groups(labels, size, RNG(seed))
    expected = min(size, len(set(labels)))
    rows = [row for group in groups for row in group]
    assert len(set(rows)) == len(rows)
    for group in groups:
        assert len({labels[row] for row in group}) == len(group) == expected
    # Dealt out of the longest piles first, nothing is left that could make one more group.
    left = Counter(labels)
    left.subtract(labels[row] for row in rows)
    assert sum(count > 0 for count in left.values()) < expected


def test_frechet_of_gaussians_in_closed_form() -> None:
    # Diagonal covariances: sum of (m - m')^2 + (s - s')^2.
    mean_a, mean_b, std_a, std_b = RNG(3).uniform(0.5, 2.0, (4, 6))
    expected = ((mean_a - mean_b) ** 2 + (std_a - std_b) ** 2).sum()
    assert gaussian_frechet(mean_a, np.diag(std_a**2), mean_b, np.diag(std_b**2)) == pytest.approx(expected, rel=1e-9)
    # Turning both by the same rotation changes nothing.
    turn, _ = np.linalg.qr(RNG(4).standard_normal((6, 6)))
    turned = gaussian_frechet(
        turn @ mean_a, turn @ np.diag(std_a**2) @ turn.T, turn @ mean_b, turn @ np.diag(std_b**2) @ turn.T
    )
    assert turned == pytest.approx(expected, rel=1e-9)


def test_frechet_of_covariances_that_do_not_commute() -> None:
    # tr (A B)^1/2 from the eigenvalues of A B itself, which are real although A B is not symmetric.
    a, b = (part @ part.T for part in RNG(5).standard_normal((2, 4, 4)))
    root = np.sqrt(np.linalg.eigvals(a @ b).real).sum()
    expected = np.trace(a) + np.trace(b) - 2 * root
    assert gaussian_frechet(np.zeros(4), a, np.zeros(4), b) == pytest.approx(expected, rel=1e-6)


def test_frechet_distance_of_samples() -> None:
    x = RNG(6).standard_normal((500, 5))
    assert frechet_distance(x, x) == pytest.approx(0.0, abs=1e-8)
    assert frechet_distance(x, x + 2.0) == pytest.approx(5 * 4.0, rel=1e-6)
    # Fewer samples than dimensions: singular covariances are no error.
    assert np.isfinite(frechet_distance(x[:3], x[3:7]))


def test_diversity_of_two_points() -> None:
    assert diversity(np.zeros((10, 3)), RNG(0)) == 0.0
    x = np.array([[0.0], [1.0]] * 200)
    assert diversity(x, RNG(7)) == pytest.approx(0.5, abs=0.12)
    y = RNG(8).standard_normal((4000, 2))
    # Mean distance of two standard normal points in the plane: sqrt(pi).
    assert diversity(y, RNG(0), pairs=2000) == pytest.approx(np.sqrt(np.pi), rel=0.05)


def test_multimodality_looks_within_captions_only() -> None:
    alike = np.repeat(RNG(9).standard_normal((5, 1, 3)) * 100, 8, axis=1)
    assert multimodality(alike, RNG(0)) == 0.0
    spread = alike + RNG(10).standard_normal(alike.shape)
    assert 1.5 < multimodality(spread, RNG(0)) < 3.5


def test_the_bootstrap_interval_of_a_mean() -> None:
    values = RNG(11).standard_normal(400)
    low, high = bootstrap(lambda rows: float(values[rows].mean()), 400, RNG(0), draws=500)
    assert low < values.mean() < high
    assert high - low == pytest.approx(2 * 1.96 / np.sqrt(400), rel=0.2)
