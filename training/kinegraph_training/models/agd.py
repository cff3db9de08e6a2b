"""Adaptive gradient descent (AGD): every cross-attention moves the context towards the queries that attend to it.

EnergyMoGen, Eq. 3 and 4, after Park et al., "Energy-Based Cross Attention for Bayesian Context Update in Text-to-Image
Diffusion Models", NeurIPS 2023. With queries q_j and keys k_i of one layer, beta = 1 / sqrt(d/h) and log weights
log w_i, the context moves along the gradient, queries held constant, of

    gamma_attn sum_heads sum_i logsumexp_j(beta k_i.q_j) / beta  -  gamma_reg logsumexp_i(|k_i|^2 / 2 + log w_i)

Shapes as in `denoiser`: r latent rows, a attention rows, c latent tokens, s context tokens, d width, h heads.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from kinegraph.bundle.contract import PADDING_BIAS
from kinegraph_training.models.denoiser import CrossAttention, Denoiser, RowMixing
from kinegraph_training.models.transformer import attend, merge_heads, split_heads


@dataclass
class MovingContext:
    """Context of one diffusion step, which every layer moves before the next one reads it."""

    tokens: Tensor
    """(a, s, d) of `ContextTokens`."""
    gamma: Tensor
    """(a, 2) step sizes gamma_attn and gamma_reg; a row with 0 does not move."""


def ascent(query: Tensor, key: Tensor, log_weight: Tensor, gamma: Tensor) -> Tensor:
    """Compute the gradient of Eq. 3, scaled by the step sizes of Eq. 4, in the space of keys.

    Args:
        query: q, (a, h, c, d/h).
        key: k, (a, h, s, d/h).
        log_weight: log w, (a, s).
        gamma: (a, 2) step sizes gamma_attn and gamma_reg.

    Returns:
        (a, s, d).
    """
    beta = 1.0 / math.sqrt(query.shape[-1])
    # gradient of the first term: sum_j softmax_j(beta k_i.q_j) q_j
    attention = torch.softmax(beta * key @ query.transpose(-1, -2), dim=-1) @ query
    merged = merge_heads(key)
    # gradient of the second term: softmax_i(|k_i|^2 / 2 + log w_i) k_i
    share = torch.softmax(merged.square().sum(dim=-1) / 2 + log_weight, dim=-1)
    return gamma[:, :1, None] * merge_heads(attention) - gamma[:, 1:, None] * share[..., None] * merged


class MovingCrossAttention(CrossAttention):
    """Trained cross-attention that projects keys and values itself; it attends to the context before moving it."""

    def __init__(self, trained: CrossAttention, key_value: nn.Linear, coarse_tokens: int) -> None:
        nn.Module.__init__(self)  # no new parameters: it takes over the trained ones
        self.heads, self.query, self.out = trained.heads, trained.query, trained.out
        self.key_value = key_value
        self.coarse_tokens = coarse_tokens

    def forward(  # type: ignore[override]
        self, x: Tensor, context: MovingContext, bias: Tensor, mixing: RowMixing | None
    ) -> Tensor:
        """As `CrossAttention.forward`; padding and the tokens of the coarser latent do not move."""
        key, value = (split_heads(part, self.heads) for part in self.key_value(context.tokens).chunk(2, dim=-1))
        query, log_weight = self.queries(x, mixing), bias[:, 0, 0]
        index = torch.arange(log_weight.shape[1], device=bias.device)
        moves = (log_weight > PADDING_BIAS / 2) & (index < log_weight.shape[1] - self.coarse_tokens)
        # As k = W_K c + b, a gradient in keys becomes one in contexts through the transpose of W_K.
        to_context = self.key_value.weight[: self.query.out_features]
        step = ascent(query, key, log_weight, context.gamma) @ to_context
        context.tokens = context.tokens + step * moves.to(step.dtype)[..., None]
        return self.combine_rows(attend(query, key, value, bias), mixing)


class AgdNoisePredictor(nn.Module):
    """`NoisePredictor` with a context that moves; holds the projections to keys and values too."""

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
        """As `NoisePredictor.forward`, with context (a, s, d) and step sizes gamma (a, 2)."""
        moving = MovingContext(context, gamma)
        return self.step(latent, modulation, [(moving,)] * len(self.step.layers), bias, mixing)
