"""Rows of a batch that compose its samples from concepts, as compositions do at run time (EnergyMoGen, Eq. 7 and 9).

A product of energies holds only where the energies were fitted to be multiplied: denoisers that saw each concept alone
leave one of two actions out of half of the clips. So some samples of several actions are predicted from one caption
of each, and the loss is that of the composed prediction. Rows and coefficients are those of
`kinegraph.diffusion.composition.plan_rows`, at guidance scale 1.

Shapes: b samples, r latent rows, a attention rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from kinegraph.diffusion.composition import (
    AttentionRouting,
    CompositionWeights,
    RowPlan,
    plan_rows,
)
from kinegraph_training.models.denoiser import RowMixing

LATENT_AWARE, SEMANTIC_AWARE = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
"""Shares of the terms of Eq. 10 that leave one of them alone."""
_NEGLIGIBLE = 1e-6


@dataclass(frozen=True)
class ComposedRows:
    """How the rows of a batch predict the noise of its samples."""

    sample: Tensor
    """(r,) sample whose latent a row holds."""
    mixing: RowMixing
    """Latent rows (r) and attention rows (a)."""
    coefficients: Tensor
    """(b, r) of each row's prediction in each sample's."""
    composed: Tensor
    """(b,) whether a sample is composed of several captions."""

    @property
    def attention_sample(self) -> Tensor:
        """Return the sample (a,) that each attention row belongs to."""
        return self.sample[self.mixing.src]

    def to(self, device: torch.device) -> ComposedRows:
        """Move all tensors to a device."""
        mixing = RowMixing(self.mixing.src.to(device), self.mixing.combine.to(device))
        return ComposedRows(self.sample.to(device), mixing, self.coefficients.to(device), self.composed.to(device))


def plan_concepts(count: int, lambdas: tuple[float, float, float]) -> RowPlan:
    """Lay out the rows that compose one sample of `count` concepts of weight 1, without those that count for nothing.

    One concept is a plain prediction: one row, whatever the terms.

    Args:
        count: of concepts.
        lambdas: `LATENT_AWARE` or `SEMANTIC_AWARE`.

    Returns:
        Plan whose contexts are numbered as in `kinegraph.diffusion.composition`.
    """
    plan = plan_rows(CompositionWeights((1.0,) * count, lambdas=lambdas), 1.0, coarse=True)
    kept = np.flatnonzero(np.abs(plan.coefficients) > _NEGLIGIBLE)
    routing = plan.routing
    attention = np.flatnonzero(np.isin(routing.src, kept))
    cut = AttentionRouting(
        routing.context[attention],
        np.searchsorted(kept, routing.src[attention]),
        routing.combine[np.ix_(kept, attention)],
    )
    return RowPlan(cut, plan.coefficients[kept])


def join_plans(plans: Sequence[RowPlan]) -> ComposedRows:
    """Lay the rows of one sample after another: the rows of each stand together, in its plan's order."""
    rows = [len(plan.coefficients) for plan in plans]
    first = np.cumsum([0, *rows[:-1]])
    return ComposedRows(
        sample=torch.from_numpy(np.repeat(np.arange(len(plans)), rows)),
        mixing=RowMixing(
            torch.from_numpy(
                np.concatenate([plan.routing.src + start for plan, start in zip(plans, first, strict=True)])
            ),
            torch.block_diag(*(torch.from_numpy(plan.routing.combine) for plan in plans)),
        ),
        coefficients=torch.block_diag(*(torch.from_numpy(plan.coefficients)[None] for plan in plans)),
        composed=torch.tensor([len(plan.routing.context) > 1 for plan in plans]),
    )
