"""Compose the predictions of a diffusion step over time (EnergyMoGen, Eq. 11).

Two texts on N_1 and N_2 frames, of which N' are the same, have one score:

    M = M_1[: N_1 - N'] (+) (M_1[N_1 - N' :] + M_2[: N'] - M_3) (+) M_2[N' :]        Eq. 11, (+) joins

M_i is the guided prediction of text i on its own frames, M_3 the unconditional one of the N' frames alone. On these
frames it is Eq. 7 with weights of 1. So it goes on to any number k of texts that share frames, and to texts that are
for some of the features (parts of the body; STMC, Petrovich et al., 2024), each feature by itself:

    M = sum_i M_i - (k - 1) M_0

With k = 1 it is the text's own prediction, with k = 0 the unconditional one.

Shapes: c tokens of the whole, n_i tokens of part i, z features of a token.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinegraph.arrays import FloatArray


@dataclass(frozen=True)
class Span:
    """Half-open span of tokens."""

    start: int
    stop: int

    @property
    def tokens(self) -> slice:
        """Index of the tokens."""
        return slice(self.start, self.stop)

    def __len__(self) -> int:
        return self.stop - self.start


def claim_features(length: int, spans: Sequence[Span], wanted: Sequence[FloatArray]) -> list[FloatArray]:
    """Decide which features of which tokens are whose.

    A text for the whole body gives way to those for parts of it, on their features and tokens. A feature that no part
    of a token wants goes to the part that wants most of that token's features.

    Args:
        length: c.
        spans: of the parts.
        wanted: (z,) for each part, 1 on the features that it is for.

    Returns:
        (n_i, z) for each part, 1 on what is its own.
    """
    of_parts, taken = np.zeros((2, length, len(wanted[0])), dtype=bool)
    claims = [np.repeat(mask[None] > 0, len(span), axis=0) for span, mask in zip(spans, wanted, strict=True)]
    is_whole = [bool(claim.all()) for claim in claims]
    for span, claim, whole in zip(spans, claims, is_whole, strict=True):
        if not whole:
            of_parts[span.tokens] |= claim
    for span, claim, whole in zip(spans, claims, is_whole, strict=True):
        if whole:
            claim &= ~of_parts[span.tokens]
        taken[span.tokens] |= claim
    for index in sorted(range(len(spans)), key=lambda part: -float(wanted[part].sum())):
        claims[index] |= ~taken[spans[index].tokens]
        taken[spans[index].tokens] = True
    return [claim.astype(np.float32) for claim in claims]


def count_claims(length: int, spans: Sequence[Span], claims: Sequence[FloatArray]) -> FloatArray:
    """Count the parts that each feature of each token belongs to: k, (c, z)."""
    count = np.zeros((length, claims[0].shape[1]), dtype=np.float32)
    for span, claim in zip(spans, claims, strict=True):
        count[span.tokens] += claim
    return count


def shared_spans(count: FloatArray) -> list[Span]:
    """List the runs of tokens in which some feature has not exactly one part, (c, z): there M_0 is needed."""
    needed = np.concatenate([[False], (count != 1).any(axis=1), [False]])
    edges = np.flatnonzero(np.diff(needed.astype(np.int8)))
    return [Span(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]


def widen(span: Span, least: int, length: int) -> Span:
    """Widen a span of fewer than `least` tokens to as many, on both sides and within `length`."""
    missing = max(least - len(span), 0)
    start = max(min(span.start - missing // 2, length - len(span) - missing), 0)
    return Span(start, min(start + len(span) + missing, length))


def compose_over_time(
    spans: Sequence[Span], claims: Sequence[FloatArray], predictions: Sequence[FloatArray], unconditional: FloatArray
) -> FloatArray:
    """Compute M = sum_i M_i - (k - 1) M_0 (Eq. 11 with k = 2).

    Args:
        spans: of the parts.
        claims: (n_i, z) of `claim_features`.
        predictions: M_i of each part, (n_i, z).
        unconditional: M_0, (c, z); used where k is not 1.

    Returns:
        (c, z).
    """
    total = np.zeros_like(unconditional)
    for span, claim, prediction in zip(spans, claims, predictions, strict=True):
        total[span.tokens] += claim * prediction
    return total - (count_claims(len(total), spans, claims) - 1) * unconditional
