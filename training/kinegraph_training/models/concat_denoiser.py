"""GraphMotion's own denoiser, for comparison: every condition in one self-attention sequence with the latent.

Same calls as `denoiser.Denoiser`, so that training and sampling need not know which one they hold. It cannot be
composed inside its layers (EnergyMoGen needs cross-attention) and is not exported.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from kinegraph_training.models.denoiser import ContextTokens, DenoiserConfig, LatentShape, TimestepLengthEmbedding
from kinegraph_training.models.transformer import EncoderLayer, SkipStack


class ConcatStep(SkipStack):
    """Self-attention over [time, conditions, latent]; the latent's places are read off."""

    def __init__(self, config: DenoiserConfig, latent: LatentShape) -> None:
        layer = (config.width, config.heads, config.feed_forward, config.dropout)
        super().__init__([EncoderLayer(*layer) for _ in range(config.layers)], config.width)
        self.tokens = latent.tokens
        self.latent_in = nn.Linear(latent.width, config.width)
        self.position = nn.Parameter(torch.randn(latent.tokens, config.width) * 0.02)
        self.noise_out = nn.Linear(config.width, latent.width)

    def forward(self, latent: Tensor, time: Tensor, context: Tensor, bias: Tensor) -> Tensor:  # type: ignore[override]
        """latent (r, c, z), time (r, d), context (r, s, d), bias (r, 1, 1, s) -> noise (r, c, z)."""
        sequence = torch.cat([time[:, None], context, self.latent_in(latent) + self.position], dim=1)
        free = bias.new_zeros(*bias.shape[:-1], 1)
        full = torch.cat([free, bias, free.expand(*bias.shape[:-1], self.tokens)], dim=-1)
        return self.noise_out(super().forward(sequence, full)[:, -self.tokens :])


class ConcatDenoiser(nn.Module):
    """One level."""

    def __init__(self, config: DenoiserConfig, latent: LatentShape, coarse: LatentShape | None) -> None:
        super().__init__()
        self.context = ContextTokens(config, coarse)
        self.clock = TimestepLengthEmbedding(config)
        self.step = ConcatStep(config, latent)
