"""Noise schedule of latent diffusion (Rombach et al.'s "scaled linear" betas, as MLD and GraphMotion use them).

Deterministic DDIM (Song et al., 2021, Eq. 12 with eta = 0) for models that predict the noise.

Classifier-free guidance (GraphMotion, Eq. A).

Coarse-to-fine sampling (GraphMotion, section 3.3): motion, then action, then specific, each a DDIM run that
sees the final latent of the level above."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import FloatArray
from kinegraph.errors import Cancelled, InvalidInputError, NonFiniteError


@dataclass(frozen=True)
class NoiseSchedule:
    """betas = linspace(sqrt(beta_start), sqrt(beta_end), train_steps)^2; alpha_bar_t = prod_s<=t (1 - beta_s)."""

    train_steps: int = 1000
    beta_start: float = 8.5e-4
    beta_end: float = 0.012
    steps_offset: int = 1
    """Added to every timestep of `leading` spacing."""
    spacing: Literal["leading", "trailing"] = "leading"
    """`leading` counts up from the clean end (the published models); `trailing` starts at pure noise, which is
    fairer when steps are few."""

    def __post_init__(self) -> None:
        if self.train_steps < 1 or not 0 < self.beta_start <= self.beta_end < 1:
            raise InvalidInputError(
                f"a schedule needs train_steps >= 1 and 0 < beta_start <= beta_end < 1, not {self.train_steps}, "
                f"{self.beta_start}, {self.beta_end}"
            )
        if self.spacing not in ("leading", "trailing"):
            raise InvalidInputError(f"spacing must be 'leading' or 'trailing', not {self.spacing!r}")

    @cached_property
    def alphas_cumprod(self) -> NDArray[np.float64]:
        """alpha_bar, (train_steps,)."""
        betas = np.linspace(self.beta_start**0.5, self.beta_end**0.5, self.train_steps) ** 2
        table = np.cumprod(1.0 - betas).astype(np.float64, copy=False)
        table.setflags(write=False)
        return table

    def timesteps(self, steps: int) -> NDArray[np.int64]:
        """The timesteps of a run of `steps` steps, descending, (steps,).

        Raises:
            InvalidInputError: fewer than one step, or one that falls outside the table.
        """
        if not 1 <= steps <= self.train_steps:
            raise InvalidInputError(f"steps must be 1 to {self.train_steps}, not {steps}")
        if self.spacing == "leading":
            ratio = self.train_steps // steps
            times = np.arange(steps - 1, -1, -1, dtype=np.int64) * ratio + self.steps_offset
        else:
            ratio_exact = self.train_steps / steps
            times = np.round(np.arange(self.train_steps, 0, -ratio_exact)).astype(np.int64)[:steps] - 1
        if times[0] >= self.train_steps:
            raise InvalidInputError(
                f"{steps} steps would start at timestep {times[0]} of a schedule of {self.train_steps}; take fewer"
            )
        return times


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


def guide(unconditional: FloatArray, conditional: FloatArray, scale: float) -> FloatArray:
    """eps = eps_0 + s (eps_c - eps_0); s = 1 is the condition alone, s = 0 no condition. Equal shapes."""
    return unconditional + np.float32(scale) * (conditional - unconditional)


Predict = Callable[[FloatArray, int], FloatArray]
"""(latent (B, C, z), step number) -> guided noise (B, C, z)."""

PredictorFor = Callable[[int, DdimCoefficients, FloatArray | None], Predict]
"""(level number, its coefficients, latent of the level above) -> predictor; called once per level."""


@dataclass(frozen=True)
class LevelPlan:
    """One level of a run."""

    name: str
    tokens: int
    latent_width: int
    steps: int


@dataclass(frozen=True)
class StepInfo:
    """Where a run stands after a step."""

    level: str
    step: int
    """1 .. steps."""
    steps: int
    """Of this level."""
    done: int
    """Steps done over all levels."""
    total: int
    timestep: int
    """Of the schedule's table."""


OnStep = Callable[[StepInfo], bool | None]
"""Called after every step; returning False stops the run."""


OnLatent = Callable[[str, FloatArray], None]
"""Called after every level with its name and its final latent (B, C, z)."""


def subrange_progress(on_step: OnStep | None, place: int, parts: int) -> OnStep | None:
    """The callback of run `place` of several alike, told where all of them stand together."""
    if on_step is None:
        return None
    return lambda info: on_step(replace(info, done=place * info.total + info.done, total=parts * info.total))


def initial_noise(seed: int, plans: Sequence[LevelPlan]) -> tuple[FloatArray, ...]:
    """One sample's starting noise per level, (C, z) each, drawn in the order of the levels from the sample's own
    generator: neighbours in a batch do not change it, nor is any global state touched."""
    generator = np.random.Generator(np.random.PCG64(seed))
    return tuple(generator.standard_normal((plan.tokens, plan.latent_width), dtype=np.float32) for plan in plans)


def sample_level(
    latent: FloatArray, predict: Predict, coefficients: DdimCoefficients, after_step: Callable[[int], None]
) -> FloatArray:
    """One DDIM run from noise (B, C, z) to the final latent of the same shape.

    `after_step(step)` may raise to stop.
    """
    for step in range(len(coefficients.timesteps)):
        latent = ddim_step(latent, predict(latent, step), coefficients, step)
        if not np.isfinite(latent).all():
            raise NonFiniteError(f"the latent is not finite after step {step + 1}; the bundle's weights are broken")
        after_step(step)
    return latent


def sample_hierarchy(
    plans: Sequence[LevelPlan],
    noises: Sequence[FloatArray],
    predictor_for: PredictorFor,
    schedule: NoiseSchedule,
    on_step: OnStep | None = None,
    on_latent: OnLatent | None = None,
) -> tuple[FloatArray, ...]:
    """Run all levels.

    Args:
        plans: coarse to fine.
        noises: (B, C, z) per level.
        predictor_for: makes a level's predictor; keys and values of the level are computed there, once.
        schedule: of all levels.
        on_step: told of every step; returning False stops.
        on_latent: told of every level that is done.

    Returns:
        The final latent (B, C, z) of every level.

    Raises:
        Cancelled: `on_step` returned False.
        NonFiniteError: a latent stopped being finite.
    """
    total = sum(plan.steps for plan in plans)
    latents: list[FloatArray] = []
    done = 0
    for number, (plan, noise) in enumerate(zip(plans, noises, strict=True)):
        coefficients = ddim_coefficients(schedule, plan.steps)
        predict = predictor_for(number, coefficients, latents[-1] if latents else None)

        def report(step: int, plan: LevelPlan = plan, done: int = done, times: DdimCoefficients = coefficients) -> None:
            info = StepInfo(plan.name, step + 1, plan.steps, done + step + 1, total, int(times.timesteps[step]))
            if on_step is not None and on_step(info) is False:
                raise Cancelled(f"stopped by on_step at step {info.done} of {total}")

        try:
            latents.append(sample_level(noise, predict, coefficients, report))
        except NonFiniteError as error:
            raise NonFiniteError(f"level {plan.name}: {error}") from error
        done += plan.steps
        if on_latent is not None:
            on_latent(plan.name, latents[-1])
    return tuple(latents)
