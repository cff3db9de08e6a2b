"""Descent of an energy: it finds the minimum of quadratics, keeps its limits, and reports its steps."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.diffusion.descent import EnergyOf, Evaluation, Limits, descend

RNG = np.random.default_rng(0)
MATRIX = RNG.normal(size=(6, 12))
TARGET = RNG.normal(size=6)
FREE = Limits(steps=60, hold=0.0, away=100.0)


def quadratic(latent: np.ndarray) -> Evaluation:
    residual = MATRIX @ latent.astype(np.float64) - TARGET
    return 0.5 * float(residual @ residual), lambda: (MATRIX.T @ residual).astype(np.float32)


def test_it_finds_the_minimum_of_a_quadratic() -> None:
    start = np.zeros(12, dtype=np.float32)
    found = descend(quadratic, start, FREE)
    assert found.dtype == np.float32 and quadratic(found)[0] < 1e-6 * quadratic(start)[0]
    # from 0 along gradients alone: the nearest of all minima
    np.testing.assert_allclose(found, np.linalg.pinv(MATRIX) @ TARGET, atol=1e-2)


def test_a_hold_is_ridge_regression() -> None:
    start = RNG.normal(size=12).astype(np.float32)
    found = descend(quadratic, start, Limits(steps=80, hold=6.0, away=100.0))
    expected = start + np.linalg.solve(MATRIX.T @ MATRIX + 0.5 * np.eye(12), MATRIX.T @ (TARGET - MATRIX @ start))
    np.testing.assert_allclose(found, expected, atol=5e-3)


@pytest.mark.parametrize("away", [0.05, 0.2])
def test_it_stops_where_it_is_told_to(away: float) -> None:
    start = np.zeros(12, dtype=np.float32)
    seen: list[int] = []
    free = descend(quadratic, start, FREE)
    assert np.sqrt((free**2).mean()) > 1.2 * away  # the minimum is further off
    found = descend(quadratic, start, Limits(steps=60, hold=0.0, away=away), lambda number: bool(seen.append(number)))
    assert np.sqrt((found**2).mean()) == pytest.approx(away, rel=1e-5)
    assert seen == list(range(1, len(seen) + 1)) and len(seen) < 60
    assert quadratic(found)[0] < quadratic(start)[0]
    calls: list[int] = []

    def third(number: int) -> bool:
        calls.append(number)
        return number == 3

    descend(quadratic, start, FREE, third)
    assert calls == [1, 2, 3]


def test_it_never_goes_up() -> None:
    def bumpy(latent: np.ndarray) -> Evaluation:
        wide = latent.astype(np.float64)
        value = float((1.0 - np.cos(3.0 * wide)).sum() + (wide**2).sum())
        return value, lambda: (3.0 * np.sin(3.0 * wide) + 2.0 * wide).astype(np.float32)

    energy: EnergyOf = bumpy
    for seed in range(5):
        start = np.random.default_rng(seed).normal(size=8).astype(np.float32)
        assert bumpy(descend(energy, start, FREE))[0] <= bumpy(start)[0]
