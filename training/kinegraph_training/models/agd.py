"""Adaptive gradient descent: while the latent attends to it, the context climbs towards what the latent asks for
(EnergyMoGen, Eq. 3 and 4; after Park et al., Energy-Based Cross Attention for Bayesian Context Update, NeurIPS 2023).

With queries q_j and keys k_i of one layer, beta = 1 / sqrt(d/h) and log weights log w_i, the context c moves along the
gradient, Q held constant, of

    gamma_attn sum_heads sum_i logsumexp_j(beta k_i.q_j) / beta  -  gamma_reg logsumexp_i(|k_i|^2 / 2 + log w_i)

Shapes as in `denoiser`: r latent rows, a attention rows, c latent tokens, s context tokens, d width, h heads.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from kinegraph_training.models.denoiser import CrossAttention, Denoiser, RowMixing
from kinegraph_training.models.transformer import MASKED, attend, merge_heads, split_heads


@dataclass
class MovingContext:
    """The context of one diffusion step; every layer leaves it moved for the next one."""

    tokens: Tensor
    """(a, s, d) projected and normalised, see `ContextTokens`."""
    gamma: Tensor
    """(a, 2) step sizes gamma_attn and gamma_reg; 0 leaves a row alone."""


def ascent(query: Tensor, key: Tensor, log_weight: Tensor, gamma: Tensor) -> Tensor:
    """Bracket of Eq. 3, times the step sizes of Eq. 4: query (a, h, c, d/h), key (a, h, s, d/h), log_weight (a, s),
    gamma (a, 2) -> direction in the space of keys (a, s, d)."""
    beta = 1.0 / math.sqrt(query.shape[-1])
    towards = torch.softmax(beta * key @ query.transpose(-1, -2), dim=-1) @ query
    merged = merge_heads(key)
    share = torch.softmax(merged.square().sum(dim=-1) / 2 + log_weight, dim=-1)
    return gamma[:, :1, None] * merge_heads(towards) - gamma[:, 1:, None] * share[..., None] * merged


class MovingCrossAttention(CrossAttention):
    """Trained cross-attention that projects its own keys and values. It attends to the context as it came."""

    def __init__(self, trained: CrossAttention, key_value: nn.Linear, coarse_tokens: int) -> None:
        nn.Module.__init__(self)  # nothing of its own: the trained projections
        self.heads, self.query, self.out = trained.heads, trained.query, trained.out
        self.key_value = key_value
        self.coarse_tokens = coarse_tokens

    def forward(  # type: ignore[override]
        self, x: Tensor, context: MovingContext, bias: Tensor, mixing: RowMixing | None
    ) -> Tensor:
        """x (r, c, d), bias (a, 1, 1 or c, s) -> (r, c, d); padding and the coarser latent's tokens do not move."""
        key, value = (split_heads(part, self.heads) for part in self.key_value(context.tokens).chunk(2, dim=-1))
        query, log_weight = self.queries(x, mixing), bias[:, 0, 0]
        place = torch.arange(log_weight.shape[1], device=bias.device)
        moves = (log_weight > MASKED / 2) & (place < log_weight.shape[1] - self.coarse_tokens)
        # k = W_K c + b, so a direction of keys comes back to contexts through the transpose of W_K
        to_context = self.key_value.weight[: self.query.out_features]
        step = ascent(query, key, log_weight, context.gamma) @ to_context
        context.tokens = context.tokens + step * moves.to(step.dtype)[..., None]
        return self.combine_rows(attend(query, key, value, bias), mixing)


class AgdNoisePredictor(nn.Module):
    """`NoisePredictor` with a context that moves: the same weights, and those that make its keys and values."""

    def __init__(self, denoiser: Denoiser) -> None:
        super().__init__()
        encoder = denoiser.context
        coarse_tokens = 0 if encoder.coarse_position is None else len(encoder.coarse_position)
        self.step = copy.deepcopy(denoiser.step)
        for layer, key_value in zip(self.step.layers, encoder.key_value, strict=True):
            layer.cross_attention = MovingCrossAttention(layer.cross_attention, key_value, coarse_tokens)

    def forward(
        self,
        latent: Tensor,
        modulation: Tensor,
        context: Tensor,
        gamma: Tensor,
        bias: Tensor,
        mixing: RowMixing | None = None,
    ) -> Tensor:
        """As `NoisePredictor`, with context (a, s, d) and gamma (a, 2); each call starts from the context it is
        given."""
        moving = MovingContext(context, gamma)
        return self.step(latent, modulation, [(moving,)] * len(self.step.layers), bias, mixing)
