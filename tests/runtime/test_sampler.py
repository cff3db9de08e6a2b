"""The coarse-to-fine loop, with predictors whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.denoising import sample_hierarchy
from kinegraph.diffusion.sampling import DdimCoefficients, LevelPlan, NoiseSchedule, StepInfo, initial_noise
from kinegraph.errors import Cancelled, NonFiniteError

LEVELS = (LevelPlan("motion", 2, 3, 3), LevelPlan("action", 4, 3, 2), LevelPlan("specific", 8, 3, 4))
SCHEDULE = NoiseSchedule()
NAMES = [level.name for level in LEVELS]


def noises(*seeds: int) -> list[np.ndarray]:
    """(B, C, z) per level."""
    per_sample = [initial_noise(seed, LEVELS) for seed in seeds]
    return [np.stack(level) for level in zip(*per_sample, strict=True)]


def predictor(level: str, coefficients: DdimCoefficients, coarse: np.ndarray | None):
    """Some smooth function of latent, step and the coarser latent, row by row."""
    hint = 0.0 if coarse is None else np.float32(0.1) * coarse.mean(axis=(1, 2), keepdims=True)
    return lambda latent, step: np.tanh(latent + np.float32(0.01 * step + NAMES.index(level))) + hint


def test_every_step_of_every_level_is_told_in_order() -> None:
    seen: list[StepInfo] = []
    sample_hierarchy(LEVELS, noises(1), predictor, SCHEDULE, seen.append)
    assert [(info.level, info.step, info.steps) for info in seen] == [
        (plan.name, step, plan.steps) for plan in LEVELS for step in range(1, plan.steps + 1)
    ]
    assert [info.done for info in seen] == list(range(1, 10))
    assert {info.total for info in seen} == {9}
    assert [info.timestep for info in seen[:3]] == SCHEDULE.timesteps(3).tolist()


def test_every_level_is_told_with_its_final_latent_before_the_next_begins() -> None:
    levels: list[tuple[str, np.ndarray, int]] = []
    steps: list[StepInfo] = []
    latents = sample_hierarchy(
        LEVELS, noises(1, 2), predictor, SCHEDULE, steps.append, lambda *level: levels.append((*level, len(steps)))
    )
    assert [(level, done) for level, _, done in levels] == [("motion", 3), ("action", 5), ("specific", 9)]
    for (_, latent, _), final in zip(levels, latents, strict=True):
        np.testing.assert_array_equal(latent, final)


@pytest.mark.parametrize("stop", [1, 3, 4, 9])
def test_false_stops_at_once(stop: int) -> None:
    calls: list[int] = []

    def on_step(info: StepInfo) -> bool:
        calls.append(info.done)
        return info.done < stop

    with pytest.raises(Cancelled, match=f"step {stop} of 9"):
        sample_hierarchy(LEVELS, noises(1), predictor, SCHEDULE, on_step)
    assert calls == list(range(1, stop + 1))


@pytest.mark.parametrize("answer", [None, True, 0])
def test_only_false_stops(answer: object) -> None:
    # 0 is not False: `lambda info: bar.update()` may return anything.
    sample_hierarchy(LEVELS, noises(1), predictor, SCHEDULE, lambda info: answer)  # type: ignore[arg-type, return-value]


def test_each_level_sees_the_final_latent_above_it() -> None:
    handed: list[np.ndarray | None] = []

    def spy(level: str, coefficients: DdimCoefficients, coarse: np.ndarray | None):
        handed.append(coarse)
        return predictor(level, coefficients, coarse)

    latents = sample_hierarchy(LEVELS, noises(5), spy, SCHEDULE)
    assert handed[0] is None
    np.testing.assert_array_equal(handed[1], latents[0])
    np.testing.assert_array_equal(handed[2], latents[1])
    assert [latent.shape for latent in latents] == [(1, 2, 3), (1, 4, 3), (1, 8, 3)]


def test_the_loop_is_the_update_rule_repeated() -> None:
    noise_of_level = expected = noises(2)[0]
    level = LevelPlan("motion", 2, 3, 6)
    table, timesteps = SCHEDULE.alphas_cumprod, SCHEDULE.timesteps(6)
    for step, time in enumerate(timesteps):
        after = max(int(time) - 1000 // 6, 0)
        noise = np.tanh(expected + np.float32(0.01 * step))
        clean = (expected - np.sqrt(1 - table[time]) * noise) / np.sqrt(table[time])
        expected = (np.sqrt(table[after]) * clean + np.sqrt(1 - table[after]) * noise).astype(np.float32)
    (sampled,) = sample_hierarchy([level], [noise_of_level], predictor, SCHEDULE)
    np.testing.assert_allclose(sampled, expected, atol=2e-5)


def test_a_sample_is_the_same_alone_and_among_neighbours() -> None:
    alone = sample_hierarchy(LEVELS, noises(8), predictor, SCHEDULE)
    among = sample_hierarchy(LEVELS, noises(3, 8, 4), predictor, SCHEDULE)
    for one, many in zip(alone, among, strict=True):
        assert one[0].tobytes() == many[1].tobytes()


def test_noise_is_standard_normal_drawn_by_the_seed_alone() -> None:
    # Legacy on purpose: the global state must stay as it was.
    state = np.random.get_state()[1].copy()  # noqa: NPY002
    first, again, other = (initial_noise(seed, LEVELS) for seed in (6, 6, 7))
    assert all(a.tobytes() == b.tobytes() for a, b in zip(first, again, strict=True))
    assert not np.allclose(first[2], other[2])
    assert (np.random.get_state()[1] == state).all()  # noqa: NPY002
    many = np.concatenate([initial_noise(seed, LEVELS)[2].ravel() for seed in range(400)])
    assert abs(many.mean()) < 0.05 and abs(many.std() - 1) < 0.05


def test_a_latent_that_explodes_names_its_level() -> None:
    def broken(level: str, coefficients: DdimCoefficients, coarse: np.ndarray | None):
        return lambda latent, step: latent * np.float32(np.nan if level == "action" else 1.0)

    with pytest.raises(NonFiniteError, match="action"):
        sample_hierarchy(LEVELS, noises(1), broken, SCHEDULE)
