"""The noise schedule and DDIM against loops of a few lines, and against the released code's tables."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.diffusion.sampling import NoiseSchedule, ddim_coefficients, ddim_step, guide
from kinegraph.errors import InvalidInputError
from support.shared import shared_path


def alpha_bars(train_steps: int, start: float, end: float) -> list[float]:
    """The product written out."""
    product, table = 1.0, []
    for step in range(train_steps):
        root = start**0.5 + (end**0.5 - start**0.5) * step / (train_steps - 1)
        product *= 1.0 - root * root
        table.append(product)
    return table


def test_alpha_bar_is_the_running_product() -> None:
    np.testing.assert_allclose(NoiseSchedule().alphas_cumprod, alpha_bars(1000, 8.5e-4, 0.012), rtol=1e-12)
    np.testing.assert_allclose(NoiseSchedule(50, 0.001, 0.2).alphas_cumprod, alpha_bars(50, 0.001, 0.2), rtol=1e-12)


def test_the_table_cannot_be_written_to() -> None:
    with pytest.raises(ValueError, match="read-only"):
        NoiseSchedule().alphas_cumprod[0] = 1.0


def test_the_released_codes_numbers() -> None:
    schedule = NoiseSchedule()
    with np.load(shared_path("fixtures", "official", "ddim_schedule.npz")) as official:
        # Their table is a product in float32, ours in float64.
        np.testing.assert_allclose(schedule.alphas_cumprod, official["alphas_cumprod"], atol=5e-7, rtol=0)
        for steps in (10, 15, 20, 50, 100, 300, 400):
            np.testing.assert_array_equal(schedule.timesteps(steps), official[f"timesteps_{steps}"])


@given(st.integers(1, 999))
def test_leading_times_descend_by_one_stride_to_the_offset(steps: int) -> None:
    times = NoiseSchedule().timesteps(steps)
    assert len(times) == steps
    assert times[-1] == 1
    assert (np.diff(times) == -(1000 // steps)).all()


@given(st.integers(1, 1000))
def test_trailing_times_start_at_pure_noise(steps: int) -> None:
    times = NoiseSchedule(spacing="trailing").timesteps(steps)
    assert len(times) == steps
    assert times[0] == 999
    assert (np.diff(times) < 0).all() and times[-1] >= 0


@pytest.mark.parametrize("steps", [0, -3, 1001])
def test_steps_outside_the_table_are_refused(steps: int) -> None:
    with pytest.raises(InvalidInputError, match=str(steps)):
        NoiseSchedule().timesteps(steps)


def test_a_thousand_leading_steps_would_start_past_the_table() -> None:
    # The released code fails here with an index error.
    with pytest.raises(InvalidInputError, match="fewer"):
        NoiseSchedule().timesteps(1000)


@pytest.mark.parametrize(
    "wrong",
    [{"train_steps": 0}, {"beta_start": 0.0}, {"beta_end": 1.0}, {"beta_start": 0.5}, {"spacing": "middle"}],
)
def test_a_schedule_that_is_none_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InvalidInputError):
        NoiseSchedule(**wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("spacing", ["leading", "trailing"])
@pytest.mark.parametrize("steps", [1, 7, 20])
def test_a_step_predicts_the_clean_latent_and_noises_it_again(spacing: str, steps: int) -> None:
    schedule = NoiseSchedule(spacing=spacing)  # type: ignore[arg-type]
    coefficients = ddim_coefficients(schedule, steps)
    table = alpha_bars(1000, 8.5e-4, 0.012)
    rng = np.random.default_rng(steps)
    for number, time in enumerate(coefficients.timesteps):
        latent, noise = rng.standard_normal((2, 3, 4), dtype=np.float32)
        after = time - 1000 // steps
        alpha, alpha_after = table[time], table[after] if after >= 0 else table[0]
        clean = (latent - (1 - alpha) ** 0.5 * noise) / alpha**0.5
        expected = alpha_after**0.5 * clean + (1 - alpha_after) ** 0.5 * noise
        denoised = ddim_step(latent, noise, coefficients, number)
        assert denoised.dtype == np.float32
        np.testing.assert_allclose(denoised, expected, atol=2e-5)


def test_a_perfect_prediction_leads_to_the_clean_latent() -> None:
    # With the noise that was really added, every DDIM run ends at alpha_bar[0] of the same clean latent.
    schedule = NoiseSchedule()
    rng = np.random.default_rng(3)
    clean, noise = rng.standard_normal((2, 5, 6), dtype=np.float32)
    for steps in (1, 4, 25):
        coefficients = ddim_coefficients(schedule, steps)
        alpha = schedule.alphas_cumprod[coefficients.timesteps[0]]
        latent = (np.sqrt(alpha) * clean + np.sqrt(1 - alpha) * noise).astype(np.float32)
        for number in range(steps):
            latent = ddim_step(latent, noise, coefficients, number)
        last = schedule.alphas_cumprod[0]
        np.testing.assert_allclose(latent, np.sqrt(last) * clean + np.sqrt(1 - last) * noise, atol=2e-5)


@pytest.mark.parametrize("spacing", ["leading", "trailing"])
@pytest.mark.parametrize("steps", range(1, 41))  # where 1000 / steps is rounded up, the last stride ends at timestep 0
def test_a_run_that_ends_clean_ends_at_the_predicted_clean_latent(steps: int, spacing: Any) -> None:
    ddim = ddim_coefficients(NoiseSchedule(spacing=spacing, ends_clean=True), steps)
    a = alpha_bars(1000, 8.5e-4, 0.012)[ddim.timesteps[-1]]
    latent, noise = (np.random.default_rng(steps).normal(size=(2, 1, 4, 8))).astype(np.float32)
    clean = (latent - (1 - a) ** 0.5 * noise) / a**0.5
    np.testing.assert_allclose(ddim_step(latent, noise, ddim, steps - 1), clean, atol=1e-5)


def test_guidance_of_one_is_the_condition_and_of_zero_none() -> None:
    rng = np.random.default_rng(0)
    without, within = rng.standard_normal((2, 4, 4), dtype=np.float32)
    np.testing.assert_allclose(guide(without, within, 1.0), within, atol=1e-6)
    np.testing.assert_array_equal(guide(without, within, 0.0), without)
    np.testing.assert_allclose(guide(without, within, 2.5), 2.5 * within - 1.5 * without, atol=1e-5)
