"""GraphMotion's own denoiser, for comparison: self-attention over conditions and latent in one sequence.

It has the interface of `denoiser.Denoiser`, so that training and sampling work with either. Without cross-attention, it
cannot be composed inside its layers (EnergyMoGen), and it is not exported.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from kinegraph_training.models.denoiser import ContextTokens, DenoiserConfig, LatentShape, TimestepLengthEmbedding
from kinegraph_training.models.transformer import EncoderLayer, SkipStack


class ConcatStep(SkipStack):
    """Predictor of the noise in a latent by self-attention over [time, conditions, latent]."""

    def __init__(self, config: DenoiserConfig, latent: LatentShape) -> None:
        layer = (config.width, config.heads, config.feed_forward, config.dropout)
        super().__init__([EncoderLayer(*layer) for _ in range(config.layers)], config.width)
        self.tokens = latent.tokens
        self.latent_in = nn.Linear(latent.width, config.width)
        self.position = nn.Parameter(torch.randn(latent.tokens, config.width) * 0.02)
        self.noise_out = nn.Linear(config.width, latent.width)

    def forward(self, latent: Tensor, time: Tensor, context: Tensor, bias: Tensor) -> Tensor:  # type: ignore[override]
        """Predict the noise.

        Args:
            latent: (r, c, z).
            time: (r, d) of `TimestepLengthEmbedding`.
            context: (r, s, d) of `ContextTokens`.
            bias: (r, 1, 1, s) of the context.

        Returns:
            (r, c, z).
        """
        sequence = torch.cat([time[:, None], context, self.latent_in(latent) + self.position], dim=1)
        free = bias.new_zeros(*bias.shape[:-1], 1)
        full = torch.cat([free, bias, free.expand(*bias.shape[:-1], self.tokens)], dim=-1)
        return self.noise_out(super().forward(sequence, full)[:, -self.tokens :])


class ConcatDenoiser(nn.Module):
    """Denoiser of one level."""

    def __init__(self, config: DenoiserConfig, latent: LatentShape, coarse: LatentShape | None) -> None:
        super().__init__()
        self.context = ContextTokens(config, coarse)
        self.clock = TimestepLengthEmbedding(config)
        self.step = ConcatStep(config, latent)
