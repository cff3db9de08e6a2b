"""Eq. 7-10 as rows of one run, against the equations written out on predictions and attention of loops."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.diffusion.composition import (
    AttentionRouting,
    CompositionWeights,
    RowPlan,
    agd_step_sizes,
    combine_rows,
    plan_rows,
)

TOKENS, WIDTH, KEYS = 3, 4, 5


def contexts(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    return tuple(np.random.default_rng(seed).standard_normal((2, count, KEYS, WIDTH)))  # type: ignore[return-value]


def attention(x: np.ndarray, key: np.ndarray, value: np.ndarray) -> np.ndarray:
    scores = np.exp(x @ key.T / np.sqrt(WIDTH))
    return scores / scores.sum(-1, keepdims=True) @ value


LAYERS = 3


def layer(x: np.ndarray, attended: np.ndarray, number: int) -> np.ndarray:
    """Nonlinear, so that averaging outputs is not averaging inside."""
    return np.tanh(x + attended + 0.1 * number)


def network(latent: np.ndarray, shares: dict[int, float], keys: np.ndarray, values: np.ndarray) -> np.ndarray:
    """One prediction whose attention is averaged over contexts, layer by layer: Eq. 9 by loops."""
    x = latent
    for number in range(LAYERS):
        attended = sum(share * attention(x, keys[k], values[k]) for k, share in shares.items())
        x = layer(x, attended, number)
    return x


def wired(latent: np.ndarray, plan: RowPlan, keys: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The step graph's way: attention rows from latent rows by `src`, mixed back by `combine`."""
    routing = plan.routing
    x = np.repeat(latent[None], len(plan.coefficients), axis=0)
    for number in range(LAYERS):
        rows = [
            attention(x[source], keys[context], values[context])
            for source, context in zip(routing.src, routing.context, strict=True)
        ]
        x = layer(x, np.tensordot(routing.combine, np.stack(rows), axes=1), number)
    return combine_rows(x.astype(np.float32), plan.coefficients)[0]


def equations(
    latent: np.ndarray,
    w: list[float],
    lambdas: tuple[float, float, float],
    s: float,
    k: np.ndarray,
    v: np.ndarray,
    coarse: bool,
) -> np.ndarray:
    """Eq. 7, 8, 9 and 10; what the concepts share, the coarser latent, is guided to once (`eps({1})`)."""

    def eps(shares: dict[int, float]) -> np.ndarray:
        return network(latent, shares, k, v)

    null = eps({0: 1.0})
    base = eps({1: 1.0}) if coarse else null
    added = sum(weight * (eps({i: 1.0}) - base) for i, weight in enumerate(w, start=2))
    by_latent = null + s * (base - null + added)
    by_meaning = null + s * (eps({i: weight / sum(w) for i, weight in enumerate(w, start=2)}) - null)
    by_text = null + s * (eps({len(w) + 2: 1.0}) - null)
    return lambdas[0] * by_latent + lambdas[1] * by_meaning + lambdas[2] * by_text


def mixture(weights: list[float], lambdas: tuple[float, float, float], *negated: float) -> CompositionWeights:
    """With one joint text."""
    return CompositionWeights(tuple(weights), (1.0,), negated, lambdas)


LAMBDAS = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.1, 0.7, 0.2), (0.5, 0.5, 0.0)]


@pytest.mark.parametrize("lambdas", LAMBDAS)
@pytest.mark.parametrize("weights", [[1.0], [0.8, 1.3], [1.0, 1.0, -0.5], [2.0, -0.3, 0.4, 0.1]])
@pytest.mark.parametrize("scale", [1.0, 2.5])
@pytest.mark.parametrize("coarse", [False, True])
def test_one_run_is_the_equations(
    lambdas: tuple[float, float, float], weights: list[float], scale: float, coarse: bool
) -> None:
    keys, values = contexts(len(weights) + 3, seed=len(weights))
    latent = np.random.default_rng(9).standard_normal((TOKENS, WIDTH))
    predicted = wired(latent, plan_rows(mixture(weights, lambdas), scale, coarse=coarse), keys, values)
    np.testing.assert_allclose(predicted, equations(latent, weights, lambdas, scale, keys, values, coarse), atol=2e-5)


@pytest.mark.parametrize("lambdas", LAMBDAS)
@pytest.mark.parametrize("coarse", [False, True])
def test_a_negation_beside_the_terms_is_eq_8_at_full_strength(
    lambdas: tuple[float, float, float], coarse: bool
) -> None:
    weights, negated, scale = [0.8, 1.3], (-1.0, -0.4), 2.5
    keys, values = contexts(7, seed=8)
    latent = np.random.default_rng(9).standard_normal((TOKENS, WIDTH))
    plan = plan_rows(mixture(weights, lambdas, *negated), scale, coarse=coarse)
    base = network(latent, {1 if coarse else 0: 1.0}, keys, values)
    # the concepts are contexts 2 and 3, the joint text 4 where it is used: wired() is told by the plan's own numbers
    first = 5 if lambdas[2] else 4
    if not lambdas[2]:
        plan = plan_rows(CompositionWeights(tuple(weights), (), negated, lambdas), scale, coarse=coarse)
    taken = sum(w * (network(latent, {first + j: 1.0}, keys, values) - base) for j, w in enumerate(negated))
    expected = equations(latent, weights, lambdas, scale, keys, values, coarse) + scale * taken
    np.testing.assert_allclose(wired(latent, plan, keys, values), expected, atol=3e-5)


def test_latent_aware_negation_is_the_same_inside_and_beside() -> None:
    keys, values = contexts(5, seed=2)
    latent = np.random.default_rng(3).standard_normal((TOKENS, WIDTH))
    plans = [
        plan_rows(weights, 2.0, coarse=True)
        for weights in (CompositionWeights((1.0, -0.7)), CompositionWeights((1.0,), (), (-0.7,)))
    ]
    inside, beside = (wired(latent, plan, keys, values) for plan in plans)
    np.testing.assert_allclose(inside, beside, atol=1e-5)


def test_step_sizes_are_those_of_text_rows() -> None:
    plan = plan_rows(mixture([1.0, 0.5], (0.2, 0.3, 0.5), -1.0), 2.0, coarse=True)
    gamma = agd_step_sizes(plan.routing, (4e-4, 1e-3))
    assert gamma.shape == (len(plan.routing.src), 2) and gamma.dtype == np.float32
    has_text = plan.routing.context >= 2
    assert 0 < has_text.sum() < len(has_text)
    np.testing.assert_allclose(gamma[has_text], [[4e-4, 1e-3]] * has_text.sum())
    assert not gamma[~has_text].any()


@given(
    st.lists(st.floats(-1, 3).filter(lambda w: abs(w) > 0.01), min_size=1, max_size=8).filter(lambda w: sum(w) > 0.1),
    st.sampled_from(LAMBDAS),
    st.floats(0, 10),
    st.booleans(),
)
def test_coefficients_sum_to_one(
    weights: list[float], lambdas: tuple[float, float, float], scale: float, coarse: bool
) -> None:
    # What all rows agree on is what comes out.
    plan = plan_rows(mixture(weights, lambdas), scale, coarse=coarse)
    assert plan.coefficients.sum() == pytest.approx(1.0, abs=1e-3 * float(1 + np.abs(plan.coefficients).sum()))
    routing = plan.routing
    rows = len(plan.coefficients)
    assert routing.combine.shape == (rows, len(routing.src)) == (rows, len(routing.context))
    np.testing.assert_allclose(routing.combine.sum(axis=1), 1.0, atol=1e-4)


@pytest.mark.parametrize("lambdas", LAMBDAS)
def test_one_concept_of_weight_one_is_plain_guidance(lambdas: tuple[float, float, float]) -> None:
    keys, values = contexts(4, seed=4)
    keys[3], values[3] = keys[2], values[2]  # the joint text of one concept is that concept
    latent = np.random.default_rng(5).standard_normal((TOKENS, WIDTH))
    predicted = wired(latent, plan_rows(mixture([1.0], lambdas), 2.5, coarse=True), keys, values)
    null, text = (network(latent, {k: 1.0}, keys, values) for k in (0, 2))
    np.testing.assert_allclose(predicted, null + 2.5 * (text - null), atol=1e-5)


def test_rows_that_count_for_nothing_are_not_run() -> None:
    rows = {
        lambdas: len(plan_rows(mixture([1.0, 1.0], lambdas), 2.0, coarse=False).coefficients) for lambdas in LAMBDAS
    }
    assert rows == dict(zip(LAMBDAS, [3, 2, 2, 5, 4], strict=True))
    # the shared coarser latent has a row of its own unless the weights sum to 1
    assert len(plan_rows(CompositionWeights((1.0, 1.0)), 2.0, coarse=True).coefficients) == 4
    assert len(plan_rows(CompositionWeights((0.3, 0.7)), 2.0, coarse=True).coefficients) == 3


def test_identity_routing_keeps_rows_apart() -> None:
    routing = AttentionRouting.identity(3)
    assert routing.src.tolist() == routing.context.tolist() == [0, 1, 2]
    np.testing.assert_array_equal(routing.combine, np.eye(3))
