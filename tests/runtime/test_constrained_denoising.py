"""Runs that are pulled, and runs that begin later: against the equations they stand for, on predictions made up."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.arrays import FloatArray
from kinegraph.constrained_denoising import MAX_PULL, BegunPrediction, ConstrainedPrediction, EncodedClip
from kinegraph.diffusion.descent import Evaluation
from kinegraph.diffusion.sampling import NoiseSchedule, ddim_coefficients, ddim_step

SCHEDULE, STEPS, SHAPE = NoiseSchedule(), 10, (1, 4, 8)
RNG = np.random.default_rng(0)
NOISE, CLEAN = (RNG.normal(size=SHAPE).astype(np.float32) for _ in range(2))


@pytest.mark.parametrize(("strength", "first"), [(0.4, 6), (0.75, 2), (0.01, 9), (1.0, 0)])
def test_an_edit_begins_at_the_noised_clip_of_its_step(strength: float, first: int) -> None:
    ddim = ddim_coefficients(SCHEDULE, STEPS)
    begin = EncodedClip(CLEAN, strength)
    assert begin.first_step(STEPS) == first
    alpha = SCHEDULE.alphas_cumprod[ddim.timesteps[first]]
    asked: list[tuple[int, FloatArray]] = []

    def predict(latents: FloatArray, index: int) -> FloatArray:
        asked.append((index, latents))
        return np.zeros_like(latents)

    begun, latents = BegunPrediction(predict, ddim, begin.noised(alpha, NOISE), first), NOISE
    for index in range(STEPS):
        latents = ddim_step(latents, begun(latents, index), ddim, index)
    assert [index for index, _ in asked] == list(range(first, STEPS))
    expected = np.sqrt(alpha) * CLEAN + np.sqrt(1 - alpha) * NOISE if first else NOISE  # SDEdit; or noise alone
    np.testing.assert_allclose(asked[0][1], expected, atol=1e-4)


@pytest.mark.parametrize("weight", [1.0, 10.0, 0.5])
@pytest.mark.parametrize("distance", [0.1, 0.4, 3.0])
def test_a_pull_goes_to_the_goal_or_as_far_as_it_may(distance: float, weight: float) -> None:
    ddim = ddim_coefficients(SCHEDULE, STEPS)
    alpha_bar = SCHEDULE.alphas_cumprod[ddim.timesteps]
    away = RNG.normal(size=SHAPE)
    away *= distance / np.sqrt((away**2).mean())
    goal = 0.5 * CLEAN + away

    def energy(clean: FloatArray) -> Evaluation:
        residual = clean.astype(np.float64) - goal
        return 0.5 * float((residual**2).sum()), lambda: residual.astype(np.float32)

    index = 7
    latents = (np.sqrt(alpha_bar[index]) * 0.5 * CLEAN + np.sqrt(1 - alpha_bar[index]) * NOISE).astype(np.float32)
    pulled = ConstrainedPrediction(lambda *_: NOISE, energy, alpha_bar, weight, 3)
    assert pulled(latents, 2) is NOISE  # before its first step
    noise = pulled(latents, index)
    clean = (latents - np.sqrt(1 - alpha_bar[index]) * noise) / np.sqrt(alpha_bar[index])
    share = min(weight, 1.0) * min(1.0, MAX_PULL / distance)
    np.testing.assert_allclose(clean, 0.5 * CLEAN + share * away, atol=2e-3)
