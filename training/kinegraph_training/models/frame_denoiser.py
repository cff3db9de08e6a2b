"""Skeleton-space denoiser (EnergyMoGen, 3.1 and appendix A and B): its latents are the motion features themselves.

A token is a group of consecutive frames. Everything else is a latent denoiser's (`models.denoiser`): context encoder,
modulation, cross-attention with `src` and `combine`, adaptive gradient descent. Three things differ.

- The number of tokens is the clip's; in a batch of clips of different lengths, padding is hidden from self-attention.
- Where tokens are groups of frames, a convolution over frames mends the seams between them, as in the autoencoders.
- It predicts the clean frames and not the noise, as MDM does (Tevet et al., 2023). The noise of a group of frames has
  more numbers than the network is wide and could not pass through it, while motion has few degrees of freedom. Noise
  predictions and clean predictions compose alike, for the coefficients of every composition sum to 1.

Shapes: r latent rows, a attention rows, c groups of frames, g frames of a group, f features, z = g f, d width.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from kinegraph_training.models.denoiser import Denoiser, DenoiserConfig, LatentShape, NoisePredictor
from kinegraph_training.models.vae import ConvolutionBlock

FRAME_CHANNELS = 96
"""Channels of the convolution over frames, as in the autoencoders."""


class SeamSmoothing(nn.Module):
    """Correction of predicted frames by convolutions over time, which see both sides of the seams between groups.

    Each token predicts its own group of frames, and neighbours disagree: without this the third derivative of a walk
    was five times as large across seams as within a group.
    """

    def __init__(self, features: int) -> None:
        super().__init__()
        self.features = features
        self.frames_in = nn.Linear(features, FRAME_CHANNELS)
        self.blocks = nn.ModuleList(ConvolutionBlock(FRAME_CHANNELS) for _ in range(2))
        self.norm = nn.LayerNorm(FRAME_CHANNELS)
        self.features_out = nn.Linear(FRAME_CHANNELS, features)
        # New layers change nothing, so that training may start from weights without them.
        nn.init.zeros_(self.features_out.weight)
        nn.init.zeros_(self.features_out.bias)

    def forward(self, groups: Tensor, mask: Tensor | None = None) -> Tensor:
        """Correct groups of frames (r, c, z).

        Args:
            groups: predicted clean frames.
            mask: (r, c) 1 on groups, 0 on padding; None where all are real.
        """
        frames = groups.reshape(groups.shape[0], -1, self.features)
        real = torch.ones_like(groups[..., 0]) if mask is None else mask.to(groups.dtype)
        real = real.repeat_interleave(groups.shape[2] // self.features, dim=1)
        x = self.frames_in(frames)
        for block in self.blocks:
            x = block(x, real)
        return groups + self.features_out(self.norm(x)).reshape(groups.shape)


class FramePredictor(NoisePredictor):
    """Predictor of the clean frames at one diffusion step."""

    def __init__(self, config: DenoiserConfig, latent: LatentShape) -> None:
        super().__init__(config, latent)
        group = config.frames_per_token
        self.seams = SeamSmoothing(latent.width // group) if group > 1 else None

    def embed(self, latent: Tensor) -> Tensor:
        """Embed groups of frames (r, c, z), which may be fewer than there are positions for, as (r, c, d)."""
        return self.latent_in(latent) + self.position[: latent.shape[1]]

    def read_out(self, x: Tensor, padding: Tensor | None) -> Tensor:
        """Read the clean frames (r, c, z) off the last layer's tokens, and mend their seams."""
        clean = super().read_out(x, padding)
        if self.seams is None:
            return clean
        return self.seams(clean, None if padding is None else (padding[:, 0, 0] == 0).to(clean.dtype))


class FrameDenoiser(Denoiser):
    """Denoiser of groups of frames; it has no coarser latent."""

    def __init__(self, config: DenoiserConfig, latent: LatentShape, coarse: LatentShape | None = None) -> None:
        super().__init__(config, latent, coarse)
        self.step = FramePredictor(config, latent)


def group_frames(features: Tensor, frames_per_token: int) -> Tensor:
    """Join consecutive frames (b, l, f) to tokens (b, l / g, g f); l is a multiple of g."""
    batch, frames, width = features.shape
    return features.reshape(batch, frames // frames_per_token, frames_per_token * width)


def hide_padding(mask: Tensor, hidden: float) -> Tensor:
    """Make the bias (b, 1, 1, c) that hides padding from self-attention, from a mask (b, c) that is 1 on tokens."""
    return torch.where(mask > 0, 0.0, hidden)[:, None, None, :]
