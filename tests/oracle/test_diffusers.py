"""Schedule and DDIM against an implementation that shares no line with ours: diffusers' DDIMScheduler."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.diffusion.sampling import NoiseSchedule, ddim_coefficients, ddim_step

torch = pytest.importorskip("torch")
diffusers = pytest.importorskip("diffusers", reason="the independent sampler (extra `oracle`) is not installed")


def scheduler(spacing: str) -> object:
    """As GraphMotion configures it; see its config of the noise scheduler."""
    return diffusers.DDIMScheduler(
        num_train_timesteps=1000,
        beta_start=8.5e-4,
        beta_end=0.012,
        beta_schedule="scaled_linear",
        clip_sample=False,
        set_alpha_to_one=False,
        steps_offset=1,
        timestep_spacing=spacing,
    )


@pytest.mark.parametrize("spacing", ["leading", "trailing"])
@pytest.mark.parametrize("steps", [1, 5, 10, 15, 20, 50, 300])
def test_timesteps_are_the_same(spacing: str, steps: int) -> None:
    theirs = scheduler(spacing)
    theirs.set_timesteps(steps)
    np.testing.assert_array_equal(NoiseSchedule(spacing=spacing).timesteps(steps), theirs.timesteps.numpy())


def test_alphas_are_the_same() -> None:
    np.testing.assert_allclose(NoiseSchedule().alphas_cumprod, scheduler("leading").alphas_cumprod.numpy(), atol=1e-6)


@pytest.mark.parametrize("spacing", ["leading", "trailing"])
@pytest.mark.parametrize("steps", [5, 15, 20, 50])
def test_whole_trajectories_are_the_same(spacing: str, steps: int) -> None:
    theirs = scheduler(spacing)
    theirs.set_timesteps(steps)
    ours = ddim_coefficients(NoiseSchedule(spacing=spacing), steps)
    generator = torch.Generator().manual_seed(steps)
    mix = torch.randn(16, 16, generator=generator) / 4
    start = torch.randn(4, 8, 16, generator=generator)
    a, b = start, start.numpy()
    for number, time in enumerate(theirs.timesteps):
        # A stand-in for the network: keeps the trajectory near unit size, as a trained one does.
        a = theirs.step(torch.tanh(a @ mix), time, a, eta=0.0).prev_sample
        b = ddim_step(b, np.tanh(b @ mix.numpy()), ours, number)
        np.testing.assert_allclose(b, a.numpy(), atol=2e-5 * max(1.0, float(a.abs().max())))
