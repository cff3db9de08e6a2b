"""Compose the noise predictions of one diffusion step (EnergyMoGen, Eq. 7-10).

n concepts with weights w_i, guidance scale s, and the predictions

    eps_0     unconditional, what guidance leads away from
    eps_c     no text, but the coarser latent that all concepts share; eps_0 itself at the coarsest level, and where
              the bundle's unconditional prediction keeps the coarser latent
    eps_i     concept i
    eps_text  the joint text

give

    latent-aware    eps^l = eps_0 + s (eps_c - eps_0 + sum_i w_i (eps_i - eps_c))  Eq. 7 (w_i > 0), Eq. 8 (w_i < 0)
    semantic-aware  eps^s = eps_0 + s (eps(z') - eps_0)
                    z' = sum_i w_i z'_i / sum_i w_i in every cross-attention        Eq. 9
    joint text      eps^m = eps_0 + s (eps_text - eps_0)
    fused           lambda_l eps^l + lambda_s eps^s + lambda_m eps^m                Eq. 10
                    + s sum_j w_j (eps_j - eps_c), w_j < 0                          Eq. 8

The paper's w_i of Eq. 7 and 8 is our s w_i. A concept counts by what it adds to eps_c: measured against eps_0, the
coarser latent would count once per concept. Every term is a guided prediction, so one concept of weight 1 is plain
guidance for any lambdas that sum to 1. Negated concepts j of a fusion stand beside its terms: inside the latent-aware
term a negation would only count lambda_l w_j, and Eq. 9 divides by a sum that negations bring to nothing.

All of this is linear in the predictions. One run of the step graph therefore predicts R rows, and a composition is a
`RowPlan`: what each row attends to, and the coefficient of its prediction.

    CompositionWeights --plan_rows--> RowPlan (AttentionRouting, coefficients) --combine_rows--> composed prediction
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from kinegraph.arrays import FloatArray, IntArray

UNCONDITIONAL, COARSE_ONLY, FIRST_CONCEPT = 0, 1, 2
"""Contexts of a level: eps_0, eps_c, then concepts, joint text and negated concepts in that order."""
_NEGLIGIBLE: Final = 1e-9
"""A row whose coefficient is smaller than this is left out."""


@dataclass(frozen=True)
class AttentionRouting:
    """How A attention rows serve R latent rows, given K contexts (inputs `src` and `combine` of the step graph)."""

    context: IntArray
    """(A,) index of the context that an attention row attends to."""
    src: IntArray
    """(A,) index of the latent row that it reads its queries from."""
    combine: FloatArray
    """(R, A) weights by which attention outputs go back into the latent rows; z' of Eq. 9."""

    @property
    def is_identity(self) -> bool:
        """Whether attention row k attends to context k, so that contexts need no copy."""
        return bool(np.array_equal(self.context, np.arange(len(self.context))))

    @staticmethod
    def identity(count: int) -> AttentionRouting:
        """Let latent row k attend to context k alone."""
        rows = np.arange(count, dtype=np.int64)
        return AttentionRouting(rows, rows, np.eye(count, dtype=np.float32))

    @staticmethod
    def from_shares(rows: Sequence[Sequence[tuple[int, float]]]) -> AttentionRouting:
        """Make one attention row for each (context, share) of each latent row."""
        entries = [(row, context, share) for row, parts in enumerate(rows) for context, share in parts]
        combine = np.zeros((len(rows), len(entries)), dtype=np.float32)
        for index, (row, _, share) in enumerate(entries):
            combine[row, index] = share
        context = np.array([context for _, context, _ in entries], dtype=np.int64)
        src = np.array([row for row, _, _ in entries], dtype=np.int64)
        return AttentionRouting(context, src, combine)


@dataclass(frozen=True)
class CompositionWeights:
    """Weights of all graphs of a composition, by the term in which they stand."""

    concepts: tuple[float, ...]
    """w_i of Eq. 7 to 9."""
    joint: tuple[float, ...] = ()
    """Of the graphs whose sum is the joint text: one of weight 1, unless its edges are weighted."""
    negated: tuple[float, ...] = ()
    """w_j < 0 of Eq. 8, beside the terms of a fusion."""
    lambdas: tuple[float, float, float] = (1.0, 0.0, 0.0)
    """Shares of the latent-aware, the semantic-aware and the joint-text term; lambda_l, lambda_s, lambda_m."""
    agd: tuple[float, float] = (0.0, 0.0)
    """Step sizes gamma_attn and gamma_reg of adaptive gradient descent (Eq. 3, 4); (0, 0) switches it off."""


@dataclass(frozen=True)
class RowPlan:
    """The R predictions of one level and how they add up."""

    routing: AttentionRouting
    coefficients: FloatArray
    """(R,); they sum to 1."""


def plan_rows(weights: CompositionWeights, scale: float, *, coarse: bool) -> RowPlan:
    """Lay out the rows of all terms whose lambda is not 0.

    Rows come in the order of the contexts, with the semantic-aware row before those of the joint text.

    Args:
        weights: of the composition.
        scale: guidance scale s of the level.
        coarse: whether eps_c differs from eps_0.
    """
    latent, semantic, joint = weights.lambdas
    w = np.asarray(weights.concepts, dtype=np.float64)
    concepts = range(FIRST_CONCEPT, FIRST_CONCEPT + len(w))
    texts = range(concepts.stop, concepts.stop + len(weights.joint))
    negations = range(texts.stop, texts.stop + len(weights.negated))

    rows: list[list[tuple[int, float]]] = [[(UNCONDITIONAL, 1.0)]]
    coefficients = [0.0]  # of eps_0: set last, so that all sum to 1

    def add(coefficient: float, *shares: tuple[int, float]) -> None:
        rows.append(list(shares))
        coefficients.append(coefficient)

    # eps_c: lambda_l (1 - sum_i w_i) of Eq. 7, and -sum_j w_j of Eq. 8
    shared = scale * (latent * (1.0 - w.sum()) - sum(weights.negated))
    if coarse and abs(shared) > _NEGLIGIBLE:
        add(shared, (COARSE_ONLY, 1.0))
    if latent:  # Eq. 7: one row for each concept
        for context, coefficient in zip(concepts, scale * latent * w, strict=True):
            add(coefficient, (context, 1.0))
    if semantic:  # Eq. 9: one row whose attention is the weighted mean over the concepts
        add(scale * semantic, *((context, float(share)) for context, share in zip(concepts, w / w.sum(), strict=True)))
    if joint:
        for context, weight in zip(texts, weights.joint, strict=True):
            add(scale * joint * weight, (context, 1.0))
    for context, weight in zip(negations, weights.negated, strict=True):  # Eq. 8
        add(scale * weight, (context, 1.0))
    coefficients[0] = 1.0 - sum(coefficients)
    return RowPlan(AttentionRouting.from_shares(rows), np.array(coefficients, dtype=np.float32))


def agd_step_sizes(routing: AttentionRouting, agd: tuple[float, float]) -> FloatArray:
    """Give every attention row its step sizes gamma_attn and gamma_reg (Eq. 3, 4): (A, 2), 0 where there is no text."""
    has_text = routing.context[:, None] >= FIRST_CONCEPT
    return np.where(has_text, np.array(agd, dtype=np.float32), np.float32(0.0))


def combine_rows(predictions: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Add up the predictions of a step: sum_r coefficient_r eps_r, (R, C, z), (R,) -> (1, C, z)."""
    return np.tensordot(coefficients, predictions, axes=1).astype(np.float32)[None]
