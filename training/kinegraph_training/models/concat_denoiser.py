"""Denoiser of one sequence, for comparison: self-attention over conditions and latent together.

GraphMotion's own denoisers are of this kind, and so is MDM's (Tevet et al., 2023), whose latent is the frames. It has
the interface of `denoiser.Denoiser`, so that training and sampling work with either. Without cross-attention, it cannot
be composed inside its layers (EnergyMoGen), and it is not exported.
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
        self.latent_in = nn.Linear(latent.width, config.width)
        self.position = nn.Parameter(torch.randn(latent.tokens, config.width) * 0.02)
        self.noise_out = nn.Linear(config.width, latent.width)

    def forward(  # type: ignore[override]
        self, latent: Tensor, time: Tensor, context: Tensor, bias: Tensor, padding: Tensor | None = None
    ) -> Tensor:
        """Predict the noise, or the clean frames.

        Args:
            latent: (r, c, z), of as many tokens as there are positions or fewer.
            time: (r, d) of `TimestepLengthEmbedding`.
            context: (r, s, d) of `ContextTokens`.
            bias: (r, 1, 1, s) of the context.
            padding: (r, 1, 1, c) of `frame_denoiser.hide_padding`; None where all tokens are real.

        Returns:
            (r, c, z).
        """
        count = latent.shape[1]
        sequence = torch.cat([time[:, None], context, self.latent_in(latent) + self.position[:count]], dim=1)
        free = bias.new_zeros(*bias.shape[:-1], 1)
        own = free.expand(*bias.shape[:-1], count) if padding is None else padding
        return self.noise_out(super().forward(sequence, torch.cat([free, bias, own], dim=-1))[:, -count:])


class ConcatDenoiser(nn.Module):
    """Denoiser of one level."""

    def __init__(self, config: DenoiserConfig, latent: LatentShape, coarse: LatentShape | None) -> None:
        super().__init__()
        self.context = ContextTokens(config, coarse)
        self.clock = TimestepLengthEmbedding(config)
        self.step = ConcatStep(config, latent)
