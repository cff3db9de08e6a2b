"""Deterministic DDIM (Song et al., 2021, Eq. 12 with eta = 0) for models that predict the noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinegraph.diffusion.schedule import NoiseSchedule

FloatArray = NDArray[np.float32]


@dataclass(frozen=True)
class DdimCoefficients:
    """One step is `latent * keep[i] + noise * move[i]`.

    With a = alpha_bar at the step and a' = alpha_bar after it:
    z0 = (z - sqrt(1 - a) eps) / sqrt(a) and z' = sqrt(a') z0 + sqrt(1 - a') eps, hence
    keep = sqrt(a' / a) and move = sqrt(1 - a') - sqrt(a' / a) sqrt(1 - a).
    """

    timesteps: NDArray[np.int64]
    """(steps,) descending."""
    keep: NDArray[np.float64]
    """(steps,)."""
    move: NDArray[np.float64]
    """(steps,)."""


def ddim_coefficients(schedule: NoiseSchedule, steps: int) -> DdimCoefficients:
    """Coefficients of a run of `steps` steps; the last one ends at alpha_bar[0], as in the published models.

    Raises:
        InvalidInputError: see `NoiseSchedule.timesteps`.
    """
    timesteps = schedule.timesteps(steps)
    previous = timesteps - schedule.train_steps // steps
    table = schedule.alphas_cumprod
    alpha = table[timesteps]
    alpha_next = np.where(previous >= 0, table[np.maximum(previous, 0)], table[0])
    keep = np.sqrt(alpha_next / alpha)
    return DdimCoefficients(timesteps, keep, np.sqrt(1.0 - alpha_next) - keep * np.sqrt(1.0 - alpha))


def ddim_step(latent: FloatArray, noise: FloatArray, coefficients: DdimCoefficients, step: int) -> FloatArray:
    """The latent after step number `step`. latent and noise: equal shapes."""
    keep, move = np.float32(coefficients.keep[step]), np.float32(coefficients.move[step])
    return keep * latent + move * noise
