"""Coarse-to-fine sampling (GraphMotion, section 3.3): motion, then action, then specific, each a DDIM run that
sees the final latent of the level above."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinegraph.diffusion.ddim import DdimCoefficients, ddim_coefficients, ddim_step
from kinegraph.diffusion.schedule import NoiseSchedule
from kinegraph.errors import Cancelled, NonFiniteError

FloatArray = NDArray[np.float32]

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


def part_of(on_step: OnStep | None, place: int, parts: int) -> OnStep | None:
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


def coarse_to_fine(
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
