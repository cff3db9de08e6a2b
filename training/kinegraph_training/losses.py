"""Losses of the autoencoders, and the spectral loss of the denoisers.

`reconstruction_terms` compares a decoded clip with its source: features, joint positions and their derivatives, foot
motion, bone lengths, the integrated path of the root, and amplitude spectra. `SpectralMotionLoss` applies the last of
these to the clip that a denoised latent decodes to. The squared error of the noise alone makes hands wave at two thirds
of their reach: the phase of a swing is hardest to predict, and the mean over all phases does not move. A spectrum does
not depend on the phase.

Shapes: b clips, l frames, c latent tokens, z latent width. All masks are (b, l), 1 for real frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from kinegraph.motion import features as layout
from kinegraph.motion.skeleton import FEET, JOINTS, PARENTS
from kinegraph_training.latents import TrainedVae
from kinegraph_training.layouts import layout_of
from kinegraph_training.models.transformer import smooth_l1

PATH_WINDOWS = (8, 16)
"""Lengths in frames of the windows over which heading and place are integrated: 0.4 and 0.8 s."""
SPECTRUM_WINDOWS = (16, 32)
"""Lengths in frames of the windows whose spectra are compared: 0.8 and 1.6 s."""
SPECTRAL_TIMESTEPS = 0.3
"""Share of the diffusion timesteps, from the clean end, at which a denoised latent is decoded and compared."""
SPECTRAL_WEIGHT = 2.0
"""Weight of `SpectralMotionLoss` beside the squared error of the noise."""


@dataclass(frozen=True)
class ReconstructionWeights:
    """Weights of the reconstruction terms; metres and radians where a term has a unit."""

    positions: float = 2.0
    velocities: float = 8.0
    accelerations: float = 8.0
    feet: float = 8.0
    """Horizontal displacement of the feet from frame to frame, which is what foot skating consists of."""
    bones: float = 2.0
    spectra: float = 4.0
    """Amplitude of every joint at every frequency, whatever its phase. With positions alone, a wave of the hand whose
    phase is unknown is best drawn as a hand that stands still: a third of its path was left."""
    windows: float = 1.0
    """Heading and place integrated over `PATH_WINDOWS`. The whole path (`path_loss`) at full weight spoils the pose."""
    root_features: float = 4.0
    kl: float = 1e-4
    """GraphMotion's lambda."""


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """Average (b, l, ...) over real frames and all trailing axes."""
    mask = mask.reshape(mask.shape + (1,) * (values.dim() - mask.dim()))
    return (values * mask).sum() / (mask.sum() * values[0, 0].numel()).clamp(min=1.0)


def local_joints(features: Tensor) -> Tensor:
    """Read joints in the body's facing frame, pelvis on the vertical axis, from features.

    Args:
        features: (b, l, width) of any layout, not normalised.

    Returns:
        (b, l, 22, 3) metres.
    """
    height = features[..., layout.HEIGHT]
    pelvis = torch.cat([torch.zeros_like(height), height, torch.zeros_like(height)], dim=-1)
    joints = features[..., layout.POSITIONS].reshape(*features.shape[:-1], JOINTS - 1, 3)
    return torch.cat([pelvis[..., None, :], joints], dim=-2)


def rotate_about_y(vectors: Tensor, angle: Tensor) -> tuple[Tensor, Tensor]:
    """Rotate floor vectors (..., 2), x and z, by +angle (...,) about Y; returns x and z apart."""
    cos, sin = torch.cos(angle), torch.sin(angle)
    x, z = vectors[..., 0], vectors[..., 1]
    return cos * x + sin * z, cos * z - sin * x


def root_steps(features: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Read how the root turns and moves in each frame, in the facing frame at the start of it.

    Args:
        features: (..., width) of any layout, not normalised.

    Returns:
        Turn to the left in radians, x and z in metres, (...,) each.
    """
    form = layout_of(features.shape[-1])
    turn = features[..., 0] * form.turn
    velocity = features[..., layout.ROOT_VELOCITY]
    x, z = rotate_about_y(velocity, turn) if form.moves_after_turning else velocity.unbind(dim=-1)
    return turn, x, z


def integrate_path(features: Tensor, window: int) -> Tensor:
    """Integrate heading and place over consecutive windows, each starting at zero.

    Args:
        features: (b, l, width) of any layout, not normalised.
        window: frames; one window of l frames where the clip is shorter.

    Returns:
        (b, l', 3) heading in radians, x and z in metres; l' is l cut to whole windows.
    """
    batch, frames = features.shape[:2]
    count = max(frames // window, 1)
    size = min(window, frames)
    rows = features[:, : count * size].reshape(batch * count, size, -1)
    turn, *step = root_steps(rows)
    heading = torch.cumsum(turn, dim=1)
    # steps are in the facing frame at the start of their frame, before its rotation
    x, z = rotate_about_y(torch.stack(step, dim=-1), heading - turn)
    path = torch.stack([heading, torch.cumsum(x, dim=1), torch.cumsum(z, dim=1)], dim=-1)
    return path.reshape(batch, count * size, 3)


def amplitude_spectrum(joints: Tensor, window: int) -> Tensor:
    """Compute amplitudes in metres at the frequencies of Hann windows that overlap by half.

    Args:
        joints: (b, l, 22, 3).
        window: frames.

    Returns:
        (b, windows, 66, window / 2), without the constant.
    """
    rows = joints.flatten(2).unfold(1, window, window // 2)
    # The weights of a Hann window sum to window / 2, and a cosine has half its amplitude at +f, half at -f: hence 4.
    hann = torch.hann_window(window, device=joints.device) * (4.0 / window)
    components = torch.view_as_real(torch.fft.rfft(rows * hann)[..., 1:])
    return torch.sqrt(components.square().sum(dim=-1) + 1e-8)


def foot_displacement(features: Tensor, joints: Tensor) -> Tensor:
    """Compute how far the four foot joints move over the floor per frame, from pose and root together.

    Args:
        features: (b, l, width) of any layout, not normalised.
        joints: (b, l, 22, 3) of `local_joints`.

    Returns:
        (b, l-1, 4, 3) metres in the facing frame of the earlier frame.
    """
    feet = joints[:, :, list(FEET)]
    turn, root_x, root_z = root_steps(features[:, :-1])
    # The next frame's feet, brought into this frame: rotated by the root's turn, then moved by its velocity.
    x, z = rotate_about_y(feet[:, 1:, :, [0, 2]], turn[..., None])
    after = torch.stack([x + root_x[..., None], feet[:, 1:, :, 1], z + root_z[..., None]], dim=-1)
    return after - feet[:, :-1]


def bone_lengths(joints: Tensor) -> Tensor:
    """Measure all bones: (b, l, 22, 3) -> (b, l, 21)."""
    bones = joints[:, :, 1:] - joints[:, :, list(PARENTS[1:])]
    return torch.sqrt(bones.square().sum(dim=-1) + 1e-8)


def reconstruction_terms(
    predicted: Tensor, target: Tensor, mask: Tensor, std: Tensor, mean: Tensor, weights: ReconstructionWeights
) -> dict[str, Tensor]:
    """Compute the weighted terms of the reconstruction loss by name; the loss is their sum.

    Args:
        predicted: (b, l, width) of any layout, group-normalised.
        target: as predicted.
        mask: (b, l).
        std: (width,) of the normalisation.
        mean: (width,) of the normalisation.
        weights: of the terms.
    """
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
    feet = foot_displacement(raw_p, joints_p) - foot_displacement(raw_t, joints_t)
    terms["feet"] = weights.feet * masked_mean(feet.abs(), pairs)
    terms["bones"] = weights.bones * masked_mean((bone_lengths(joints_p) - bone_lengths(joints_t)).abs(), mask)
    for window in PATH_WINDOWS:
        path_p, path_t = integrate_path(raw_p, window), integrate_path(raw_t, window)
        terms[f"window_{window}"] = weights.windows * masked_mean((path_p - path_t).abs(), mask[:, : path_p.shape[1]])
    for window, difference in spectral_difference(joints_p, joints_t, mask).items():
        terms[f"spectra_{window}"] = weights.spectra * difference
    return terms


def spectral_difference(predicted: Tensor, target: Tensor, mask: Tensor) -> dict[int, Tensor]:
    """Compare the amplitude spectra of two motions, in metres summed over frequencies.

    Args:
        predicted: joints (b, l, 22, 3).
        target: as predicted.
        mask: (b, l); windows with padding do not count.

    Returns:
        By window of `SPECTRUM_WINDOWS` that l frames can hold: the mean absolute difference.
    """
    differences = {}
    for window in SPECTRUM_WINDOWS:
        if predicted.shape[1] >= window:
            whole = mask.unfold(1, window, window // 2).amin(dim=-1)
            difference = (amplitude_spectrum(predicted, window) - amplitude_spectrum(target, window)).abs().sum(dim=-1)
            differences[window] = masked_mean(difference, whole)
    return differences


def path_loss(predicted: Tensor, target: Tensor, mask: Tensor, std: Tensor, mean: Tensor) -> Tensor:
    """Compare heading and place integrated over the whole clip; arguments as in `reconstruction_terms`."""
    frames = predicted.shape[1]
    error = integrate_path(predicted * std + mean, frames) - integrate_path(target * std + mean, frames)
    return masked_mean(error.abs(), mask)


def kl_divergence(mean: Tensor, log_variance: Tensor) -> Tensor:
    """Compute KL(q || N(0, I)), averaged over all numbers (GraphMotion, Eq. 4)."""
    return 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).mean()


def denoise(latent: Tensor, noise: Tensor, predicted: Tensor, alpha: Tensor) -> Tensor:
    """Estimate the clean latent z_0' from a noise prediction, with the true z_0 known.

    z_0' = (z_t - sqrt(1 - alpha) eps') / sqrt(alpha) and z_t = sqrt(alpha) z_0 + sqrt(1 - alpha) eps give
    z_0' = z_0 + sqrt((1 - alpha) / alpha) (eps - eps').

    Args:
        latent: z_0, (b, c, z).
        noise: eps, (b, c, z).
        predicted: eps', (b, c, z).
        alpha: cumulative alpha of the timestep, (b, 1, 1).
    """
    return latent + ((1 - alpha) / alpha).sqrt() * (noise - predicted)


@dataclass(frozen=True)
class SpectralMotionLoss:
    """Spectral difference of the clips that a frozen autoencoder decodes from two latents."""

    autoencoder: TrainedVae
    """Of the level that the latents belong to."""
    centre: Tensor
    """(c, z) mean of the standardisation of latents."""
    scale: Tensor
    """(c, z) standard deviation of the standardisation of latents."""

    def __call__(self, predicted: Tensor, target: Tensor, frames: Tensor) -> Tensor:
        """Sum `spectral_difference` over its windows.

        Args:
            predicted: standardised latents (b, c, z).
            target: as predicted.
            frames: (b,) lengths of the clips.
        """
        group = self.autoencoder.vae.config.frames_per_token
        index = torch.arange(-(-int(frames.max()) // group) * group, device=frames.device)
        mask = (index < frames[:, None]).float()
        differences = spectral_difference(self.joints(predicted, mask), self.joints(target, mask), mask)
        return sum(differences.values(), predicted.new_zeros(()))

    def joints(self, latent: Tensor, mask: Tensor) -> Tensor:
        """Decode (b, c, z) to joints (b, l, 22, 3) in the body's facing frame."""
        centre, scale = (value.to(latent.device) for value in (self.centre, self.scale))
        mean, std = (
            torch.as_tensor(value, device=latent.device) for value in (self.autoencoder.mean, self.autoencoder.std)
        )
        features = self.autoencoder.vae.to(latent.device).decode(latent * scale + centre, mask)
        return local_joints(features.float() * std + mean)
