"""How strongly the joints of a denoised latent's clip swing.

Squared error of the noise alone makes hands wave at two thirds of their reach: where they are in their swing is
hardest to tell, and the mean of all that may be does not move. So, while the latent is clear enough (`CLEAR`), the clip
that the frozen autoencoder makes of the denoised latent is held to the spectrum of that of the true one, whatever the
phase.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from kinegraph_training.latents import TrainedVae
from kinegraph_training.losses import local_joints, spectral_difference

CLEAR = 0.3
"""Part of the diffusion, from its clean end."""
WEIGHT = 2.0


def denoised(latent: Tensor, noise: Tensor, predicted: Tensor, alpha: Tensor) -> Tensor:
    """z_0' = (z_t - sqrt(1 - alpha) eps') / sqrt(alpha) for z_t = sqrt(alpha) z_0 + sqrt(1 - alpha) eps: (b, c, z)
    each, alpha (b, 1, 1)."""
    return latent + ((1 - alpha) / alpha).sqrt() * (noise - predicted)


@dataclass(frozen=True)
class Swing:
    """The autoencoder that a level's latents are of, and how these are standardised."""

    trained: TrainedVae
    centre: Tensor
    """(c, z)."""
    scale: Tensor
    """(c, z)."""

    def __call__(self, made: Tensor, true: Tensor, frames: Tensor) -> Tensor:
        """`spectral_difference` of two latents (b, c, z) of clips of so many frames (b,), summed over windows."""
        group = self.trained.vae.config.frames_per_token
        places = torch.arange(-(-int(frames.max()) // group) * group, device=frames.device)
        mask = (places < frames[:, None]).float()
        parts = spectral_difference(self.joints(made, mask), self.joints(true, mask), mask)
        return sum(parts.values(), made.new_zeros(()))

    def joints(self, latent: Tensor, mask: Tensor) -> Tensor:
        """(b, c, z) -> (b, l, 22, 3) in the body's facing frame."""
        centre, scale = (part.to(latent.device) for part in (self.centre, self.scale))
        mean, std = (torch.as_tensor(part, device=latent.device) for part in (self.trained.mean, self.trained.std))
        features = self.trained.vae.to(latent.device).decode(latent * scale + centre, mask)
        return local_joints(features.float() * std + mean)
