"""Skeleton-space denoiser (EnergyMoGen, 3.1 and appendix A and B): its latents are the motion features themselves.

A token is a group of consecutive frames. Everything else is a latent denoiser's (`models.denoiser`): context encoder,
modulation, cross-attention with `src` and `combine`, adaptive gradient descent. Two things differ.

- The number of tokens is the clip's; in a batch of clips of different lengths, padding is hidden from self-attention.
- It predicts the clean frames and not the noise, as MDM does (Tevet et al., 2023). The noise of a group of frames has
  more numbers than the network is wide and could not pass through it, while motion has few degrees of freedom. Noise
  predictions and clean predictions compose alike, for the coefficients of every composition sum to 1.

Shapes: r latent rows, a attention rows, c groups of frames, g frames of a group, f features, z = g f, d width.
"""

from __future__ import annotations

import torch
from torch import Tensor

from kinegraph_training.models.denoiser import Denoiser, DenoiserConfig, LatentShape, NoisePredictor


class FramePredictor(NoisePredictor):
    """Predictor of the clean frames at one diffusion step."""

    def embed(self, latent: Tensor) -> Tensor:
        """Embed groups of frames (r, c, z), which may be fewer than there are positions for, as (r, c, d)."""
        return self.latent_in(latent) + self.position[: latent.shape[1]]


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
