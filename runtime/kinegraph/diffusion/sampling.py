"""Diffusion sampling: noise schedule, DDIM step and classifier-free guidance as pure functions of arrays.

    NoiseSchedule           alpha_bar_t, and the timesteps of a run
    ddim_coefficients       what a DDIM step multiplies with, for all steps of a run
    ddim_step               z_t -> z_{t-1}
    guide                   classifier-free guidance
    initial_noise           z_T of every level, drawn from one seed

The loop that uses them is `kinegraph.denoising.sample_hierarchy`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from kinegraph.arrays import DoubleArray, FloatArray, IntArray
from kinegraph.errors import InvalidInputError


@dataclass(frozen=True)
class NoiseSchedule:
    """The "scaled linear" schedule of latent diffusion (Rombach et al., 2022), as MLD and GraphMotion use it.

    betas = linspace(sqrt(beta_start), sqrt(beta_end), train_steps)^2; alpha_bar_t = prod_{s <= t} (1 - beta_s).

    Raises:
        InvalidInputError: no steps, betas outside 0 < beta_start <= beta_end < 1, or an unknown spacing.
    """

    train_steps: int = 1000
    beta_start: float = 8.5e-4
    beta_end: float = 0.012
    steps_offset: int = 1
    """Added to every timestep of "leading" spacing."""
    spacing: Literal["leading", "trailing"] = "leading"
    """"leading" counts up from the clean end (the published models); "trailing" starts at pure noise, which is fairer
    when steps are few."""
    ends_clean: bool = False
    """Whether the last step ends at the predicted clean latent, and not at alpha_bar[0], as the published models do."""

    def __post_init__(self) -> None:
        if self.train_steps < 1 or not 0 < self.beta_start <= self.beta_end < 1:
            raise InvalidInputError(
                f"a schedule needs train_steps >= 1 and 0 < beta_start <= beta_end < 1, not {self.train_steps}, "
                f"{self.beta_start}, {self.beta_end}"
            )
        if self.spacing not in ("leading", "trailing"):
            raise InvalidInputError(f"spacing must be 'leading' or 'trailing', not {self.spacing!r}")

    @cached_property
    def alphas_cumprod(self) -> DoubleArray:
        """Compute alpha_bar for every timestep: (train_steps,), read-only."""
        betas = np.linspace(self.beta_start**0.5, self.beta_end**0.5, self.train_steps) ** 2
        alpha_bar = np.cumprod(1.0 - betas).astype(np.float64, copy=False)
        alpha_bar.setflags(write=False)
        return alpha_bar

    def timesteps(self, steps: int) -> IntArray:
        """Choose the timesteps of a run of `steps` steps: (steps,), descending.

        Raises:
            InvalidInputError: fewer than one step, or one that falls outside the table.
        """
        if not 1 <= steps <= self.train_steps:
            raise InvalidInputError(f"steps must be 1 to {self.train_steps}, not {steps}")
        if self.spacing == "leading":
            ratio = self.train_steps // steps
            timesteps = np.arange(steps - 1, -1, -1, dtype=np.int64) * ratio + self.steps_offset
        else:
            exact_ratio = self.train_steps / steps
            timesteps = np.round(np.arange(self.train_steps, 0, -exact_ratio)).astype(np.int64)[:steps] - 1
        if timesteps[0] >= self.train_steps:
            raise InvalidInputError(
                f"{steps} steps would start at timestep {timesteps[0]} of a schedule of {self.train_steps}; take fewer"
            )
        return timesteps


@dataclass(frozen=True)
class DdimCoefficients:
    """Factors of deterministic DDIM steps (Song et al., 2021, Eq. 12 with eta = 0) for models that predict the noise.

    With a = alpha_bar at a step and a' = alpha_bar after it:

        z_0 = (z_t - sqrt(1 - a) eps) / sqrt(a)          predicted clean latent
        z_{t-1} = sqrt(a') z_0 + sqrt(1 - a') eps        moved back to the noise level a'

    hence z_{t-1} = keep z_t + move eps with keep = sqrt(a' / a) and move = sqrt(1 - a') - keep sqrt(1 - a).
    """

    timesteps: IntArray
    """(K,) of K steps, descending."""
    keep: DoubleArray
    """(K,)."""
    move: DoubleArray
    """(K,)."""


def ddim_coefficients(schedule: NoiseSchedule, steps: int) -> DdimCoefficients:
    """Compute the coefficients of a run of `steps` steps, which ends as `NoiseSchedule.ends_clean` says.

    Raises:
        InvalidInputError: see `NoiseSchedule.timesteps`.
    """
    timesteps = schedule.timesteps(steps)
    following = timesteps - schedule.train_steps // steps
    alpha_bar = schedule.alphas_cumprod
    alpha, alpha_next = alpha_bar[timesteps], alpha_bar[np.maximum(following, 0)]
    if schedule.ends_clean:
        alpha_next[-1] = 1.0
    keep = np.sqrt(alpha_next / alpha)
    return DdimCoefficients(timesteps, keep, np.sqrt(1.0 - alpha_next) - keep * np.sqrt(1.0 - alpha))


def ddim_step(latents: FloatArray, noise: FloatArray, ddim: DdimCoefficients, index: int) -> FloatArray:
    """Take step `index` of a run, z_t -> z_{t-1}; latents and predicted noise have equal shapes."""
    return np.float32(ddim.keep[index]) * latents + np.float32(ddim.move[index]) * noise


def guide(unconditional: FloatArray, conditional: FloatArray, scale: float) -> FloatArray:
    """Apply classifier-free guidance, eps = eps_0 + s (eps_c - eps_0) (GraphMotion, Eq. A).

    s = 1 is the condition alone, s = 0 the unconditional model. All shapes are equal.
    """
    return unconditional + np.float32(scale) * (conditional - unconditional)


@dataclass(frozen=True)
class LevelPlan:
    """Size and number of steps of one level."""

    name: str
    tokens: int
    """Latent tokens C."""
    latent_width: int
    """Width z of a token."""
    steps: int
    """Diffusion steps."""


@dataclass(frozen=True)
class StepInfo:
    """Where a run stands after a diffusion step."""

    level: str
    """Name of the level, see `bundle.contract.LEVELS`."""
    step: int
    """1 .. steps."""
    steps: int
    """Steps of this level."""
    done: int
    """Steps done over all levels."""
    total: int
    """Steps of all levels."""
    timestep: int
    """Timestep of the schedule, 0 is clean."""


PredictNoise = Callable[[FloatArray, int], FloatArray]
"""(latents (B, C, z), index of the step) -> guided and composed noise prediction (B, C, z)."""

OnStep = Callable[[StepInfo], bool | None]
"""Called after every step; returning False stops the run."""


def is_stop(answer: object) -> bool:
    """Tell whether the answer of a callback stops the run: False does, None and 0 do not."""
    return isinstance(answer, bool | np.bool_) and not answer


def subrange_progress(on_step: OnStep | None, index: int, count: int) -> OnStep | None:
    """Make a callback for run `index` of `count` equal runs that reports the progress of all of them together."""
    if on_step is None:
        return None
    return lambda info: on_step(replace(info, done=index * info.total + info.done, total=count * info.total))


def initial_noise(seed: int, levels: Sequence[LevelPlan]) -> tuple[FloatArray, ...]:
    """Draw z_T of one sample, (C, z) for each level in order, from `PCG64(seed)` alone.

    Neighbours in a batch do not change it, and no global state is touched.
    """
    generator = np.random.Generator(np.random.PCG64(seed))
    return tuple(generator.standard_normal((level.tokens, level.latent_width), dtype=np.float32) for level in levels)
