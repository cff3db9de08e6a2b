"""What an autoencoder's reconstruction is held to, and in part a denoised latent's clip (`swing`).

All masks are (b, l), 1 for real frames.

How strongly the joints of a denoised latent's clip swing.

Squared error of the noise alone makes hands wave at two thirds of their reach: where they are in their swing is
hardest to tell, and the mean of all that may be does not move. So, while the latent is clear enough (`CLEAR`), the clip
that the frozen autoencoder makes of the denoised latent is held to the spectrum of that of the true one, whatever the
phase.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from kinegraph.motion import features as layout
from kinegraph.motion.skeleton import FEET, JOINTS, PARENTS
from kinegraph_training.latents import TrainedVae
from kinegraph_training.models.transformer import smooth_l1

SPECTRA = (16, 32)
"""Frames of the windows whose frequencies are compared: .8 and 1.6 s."""


@dataclass(frozen=True)
class ReconstructionLoss:
    """Weights of the terms; metres and radians where a term has a unit."""

    positions: float = 2.0
    velocities: float = 8.0
    accelerations: float = 8.0
    feet: float = 8.0
    """Displacement of the feet over the floor from one frame to the next: what skating is made of."""
    bones: float = 2.0
    spectra: float = 4.0
    """How strongly every joint swings at every frequency, whatever its phase: held to positions alone, a wave of the
    hand whose phase is not known is best drawn as a hand that stands still (a third of its path was left)."""
    windows: float = 1.0
    """Heading and place integrated over short windows. The whole integral (`path`) at full weight starves the pose."""
    root_features: float = 4.0
    kl: float = 1e-4
    """GraphMotion's lambda."""


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """Mean over real frames and all trailing axes."""
    mask = mask.reshape(mask.shape + (1,) * (values.dim() - mask.dim()))
    return (values * mask).sum() / (mask.sum() * values[0, 0].numel()).clamp(min=1.0)


def local_joints(features: Tensor) -> Tensor:
    """(b, l, 137) not normalised -> (b, l, 22, 3) in the body's facing frame, pelvis on the vertical axis."""
    height = features[..., layout.HEIGHT]
    pelvis = torch.cat([torch.zeros_like(height), height, torch.zeros_like(height)], dim=-1)
    joints = features[..., layout.POSITIONS].reshape(*features.shape[:-1], JOINTS - 1, 3)
    return torch.cat([pelvis[..., None, :], joints], dim=-2)


def turned(vectors: Tensor, angle: Tensor) -> tuple[Tensor, Tensor]:
    """x and z of (..., 2) floor vectors turned by +angle about Y."""
    cos, sin = torch.cos(angle), torch.sin(angle)
    x, z = vectors[..., 0], vectors[..., 1]
    return cos * x + sin * z, cos * z - sin * x


def window_path(features: Tensor, window: int) -> Tensor:
    """Heading and place inside windows that each start at zero: (b, l', 3) with l' cut to whole windows."""
    batch, frames = features.shape[:2]
    count = max(frames // window, 1)
    size = min(window, frames)
    rows = features[:, : count * size].reshape(batch * count, size, -1)
    angle = torch.cumsum(rows[..., 0], dim=1)
    before = angle - rows[..., 0]
    x, z = turned(rows[..., layout.ROOT_VELOCITY], before)
    path = torch.stack([angle, torch.cumsum(x, dim=1), torch.cumsum(z, dim=1)], dim=-1)
    return path.reshape(batch, count * size, 3)


def spectrum(joints: Tensor, window: int) -> Tensor:
    """Amplitudes in metres at the frequencies of overlapping Hann windows: (b, l, 22, 3) -> (b, n, 66, window / 2)."""
    rows = joints.flatten(2).unfold(1, window, window // 2)
    shape = torch.hann_window(window, device=joints.device) * (4.0 / window)
    swings = torch.view_as_real(torch.fft.rfft(rows * shape)[..., 1:])
    return torch.sqrt(swings.square().sum(dim=-1) + 1e-8)


def foot_steps(features: Tensor, joints: Tensor) -> Tensor:
    """Displacement of the four foot joints over the floor, (b, l-1, 4, 3), from pose and root together."""
    feet = joints[:, :, list(FEET)]
    root = features[:, :-1, layout.ROOT_VELOCITY]
    x, z = turned(feet[:, 1:, :, [0, 2]], features[:, :-1, 0][..., None])
    after = torch.stack([x + root[..., None, 0], feet[:, 1:, :, 1], z + root[..., None, 1]], dim=-1)
    return after - feet[:, :-1]


def bone_lengths(joints: Tensor) -> Tensor:
    """(b, l, 22, 3) -> (b, l, 21)."""
    bones = joints[:, :, 1:] - joints[:, :, list(PARENTS[1:])]
    return torch.sqrt(bones.square().sum(dim=-1) + 1e-8)


def reconstruction_terms(
    predicted: Tensor, target: Tensor, mask: Tensor, std: Tensor, mean: Tensor, weights: ReconstructionLoss
) -> dict[str, Tensor]:
    """Weighted terms by name; their sum is the loss. predicted and target: (b, l, 137), group-normalised."""
    emphasis = torch.ones_like(std)
    emphasis[: layout.HEIGHT.stop] = weights.root_features
    terms = {"features": masked_mean(smooth_l1(predicted - target) * emphasis, mask)}
    raw_p, raw_t = predicted * std + mean, target * std + mean
    joints_p, joints_t = local_joints(raw_p), local_joints(raw_t)
    difference = joints_p - joints_t
    pairs, triples = mask[:, 1:], mask[:, 2:]
    velocity = difference[:, 1:] - difference[:, :-1]
    terms["positions"] = weights.positions * masked_mean(difference.abs(), mask)
    terms["velocities"] = weights.velocities * masked_mean(velocity.abs(), pairs)
    terms["accelerations"] = weights.accelerations * masked_mean((velocity[:, 1:] - velocity[:, :-1]).abs(), triples)
    terms["feet"] = weights.feet * masked_mean((foot_steps(raw_p, joints_p) - foot_steps(raw_t, joints_t)).abs(), pairs)
    terms["bones"] = weights.bones * masked_mean((bone_lengths(joints_p) - bone_lengths(joints_t)).abs(), mask)
    for window in (8, 16):
        path_p, path_t = window_path(raw_p, window), window_path(raw_t, window)
        terms[f"window_{window}"] = weights.windows * masked_mean((path_p - path_t).abs(), mask[:, : path_p.shape[1]])
    for window, difference in spectral_difference(joints_p, joints_t, mask).items():
        terms[f"spectra_{window}"] = weights.spectra * difference
    return terms


def spectral_difference(predicted: Tensor, target: Tensor, mask: Tensor) -> dict[int, Tensor]:
    """How much stronger or weaker joints (b, l, 22, 3) swing than they should, in metres over all frequencies: by
    window of `SPECTRA` that clips of l frames are long enough for."""
    found = {}
    for window in SPECTRA:
        if predicted.shape[1] >= window:
            whole = mask.unfold(1, window, window // 2).amin(dim=-1)
            difference = (spectrum(predicted, window) - spectrum(target, window)).abs().sum(dim=-1)
            found[window] = masked_mean(difference, whole)
    return found


def path_loss(predicted: Tensor, target: Tensor, mask: Tensor, std: Tensor, mean: Tensor) -> Tensor:
    """Heading and place integrated over the whole clip."""
    frames = predicted.shape[1]
    error = window_path(predicted * std + mean, frames) - window_path(target * std + mean, frames)
    return masked_mean(error.abs(), mask)


def kl_divergence(mean: Tensor, log_variance: Tensor) -> Tensor:
    """KL(q || N(0, I)), mean over all numbers (GraphMotion, Eq. 4)."""
    return 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).mean()


CLEAR = 0.3
"""Part of the diffusion, from its clean end."""
WEIGHT = 2.0


def denoised(latent: Tensor, noise: Tensor, predicted: Tensor, alpha: Tensor) -> Tensor:
    """z_0' = (z_t - sqrt(1 - alpha) eps') / sqrt(alpha) for z_t = sqrt(alpha) z_0 + sqrt(1 - alpha) eps: (b, c, z)
    each, alpha (b, 1, 1)."""
    return latent + ((1 - alpha) / alpha).sqrt() * (noise - predicted)


@dataclass(frozen=True)
class SpectralMotionLoss:
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
