"""Composing predictions of one step (EnergyMoGen, Eq. 7-10) around the step graph's `src` and `combine`.

n concepts with weights w_i, guidance scale s, predictions eps_0 (what guidance leads away from) and eps_c (no text, but
the coarser latent, which all concepts share; eps_0 itself at the coarsest level, and where a bundle leads away from
it):

    latent-aware    eps^l = eps_0 + s (eps_c - eps_0 + sum_i w_i (eps_i - eps_c))  Eq. 7 (w_i > 0), Eq. 8 (w_i < 0)
    semantic-aware  eps^s = eps_0 + s (eps(z') - eps_0)
                    z' = sum_i w_i z'_i / sum_i w_i in every cross-attention        Eq. 9
    joint text      eps^m = eps_0 + s (eps_text - eps_0)
    fused           lambda_l eps^l + lambda_s eps^s + lambda_m eps^m                Eq. 10
                    + s sum_j w_j (eps_j - eps_c), w_j < 0                          Eq. 8

The paper's w_i of Eq. 7 and 8 is our s w_i. Concepts are told apart by what they add to eps_c: against eps_0, the
coarser latent would count once per concept. Every term is a guided prediction, so that one concept of weight 1 is plain
guidance for any lambdas that sum to 1. Negated concepts j of a fusion stand beside its terms: inside the latent-aware
one a negation would count lambda_l w_j only, and Eq. 9 divides by a sum that negations bring to nothing.

All of it is linear in the rows of one run: a row is a prediction, and `mix` holds the coefficient of each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinegraph.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class AttentionRouting:
    """How A attention rows serve R rows of latents, given K contexts."""

    context: IntArray
    """(A,) which of the K contexts an attention row attends to."""
    src: IntArray
    """(A,) which latent row it reads."""
    combine: FloatArray
    """(R, A) how what is attended to goes back into the rows."""

    @staticmethod
    def straight(count: int) -> AttentionRouting:
        """Row k attends to context k."""
        rows = np.arange(count, dtype=np.int64)
        return AttentionRouting(rows, rows, np.eye(count, dtype=np.float32))


@dataclass(frozen=True)
class CompositionWeights:
    """What is composed: the weights of graphs by their part in it, and how."""

    weights: tuple[float, ...]
    """w_i of Eq. 7 to 9."""
    joint: tuple[float, ...] = ()
    """Of the graphs whose sum is the joint text: one of weight 1, unless its edges were edited."""
    negated: tuple[float, ...] = ()
    """w_j < 0 of Eq. 8, beside the terms of a fusion."""
    lambdas: tuple[float, float, float] = (1.0, 0.0, 0.0)
    """Of the latent-aware, the semantic-aware and the joint-text term."""
    agd: tuple[float, float] = (0.0, 0.0)
    """Step sizes gamma_attn and gamma_reg of adaptive gradient descent (Eq. 3, 4); 0, 0 is without it."""


@dataclass(frozen=True)
class RowPlan:
    """One level's rows and how their predictions add up."""

    wiring: AttentionRouting
    mix: FloatArray
    """(R,) coefficients; they sum to 1."""


def plan_rows(mixture: CompositionWeights, scale: float, *, coarse: bool) -> RowPlan:
    """Rows for the terms whose lambda is not 0.

    Contexts are numbered 0 for nothing, 1 for no text beside the coarser latent, 2 .. n + 1 for the concepts, and from
    n + 2 on for the joint text, then the negated concepts. Rows come in the same order, with the semantic row before
    those of the joint text.

    Args:
        mixture: what is composed.
        scale: guidance s of the level.
        coarse: whether eps_c differs from eps_0.
    """
    latent, semantic, joint = mixture.lambdas
    w = np.asarray(mixture.weights, dtype=np.float64)
    concepts = np.arange(2, len(w) + 2)
    rows: list[list[tuple[int, float]]] = [[(0, 1.0)]]
    mix = [0.0]
    shared = scale * (latent * (1.0 - w.sum()) - sum(mixture.negated))
    if coarse and abs(shared) > 1e-9:
        rows.append([(1, 1.0)])
        mix.append(shared)
    if latent:
        rows += [[(int(concept), 1.0)] for concept in concepts]
        mix += list(scale * latent * w)
    if semantic:
        shares = w / w.sum()
        rows.append([(int(concept), float(share)) for concept, share in zip(concepts, shares, strict=True)])
        mix.append(scale * semantic)
    if joint:
        rows += [[(len(w) + 2 + place, 1.0)] for place in range(len(mixture.joint))]
        mix += [scale * joint * weight for weight in mixture.joint]
    rows += [[(len(w) + len(mixture.joint) + 2 + place, 1.0)] for place in range(len(mixture.negated))]
    mix += [scale * weight for weight in mixture.negated]
    mix[0] = 1.0 - sum(mix)
    return RowPlan(_wiring(rows), np.array(mix, dtype=np.float32))


def _wiring(rows: Sequence[Sequence[tuple[int, float]]]) -> AttentionRouting:
    """One attention row per (context, share) of each latent row."""
    pairs = [(row, context, share) for row, parts in enumerate(rows) for context, share in parts]
    combine = np.zeros((len(rows), len(pairs)), dtype=np.float32)
    for place, (row, _, share) in enumerate(pairs):
        combine[row, place] = share
    context, src = (np.array([pair[which] for pair in pairs], dtype=np.int64) for which in (1, 0))
    return AttentionRouting(context, src, combine)


def step_sizes(wiring: AttentionRouting, agd: tuple[float, float]) -> FloatArray:
    """(A, 2) gamma_attn and gamma_reg of every attention row: 0 where there is no text to move."""
    return np.where(wiring.context[:, None] >= 2, np.array(agd, dtype=np.float32), np.float32(0.0))


def combine_rows(predictions: FloatArray, mix: FloatArray) -> FloatArray:
    """sum_r mix_r eps_r: (R, C, z), (R,) -> (1, C, z)."""
    return np.tensordot(mix, predictions, axes=1).astype(np.float32)[None]
