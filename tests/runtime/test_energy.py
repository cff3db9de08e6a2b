"""Energies of predicted noise: known potentials, an independent loop over a real composition, and its picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph import Cancelled, Concept, InvalidInputError, MissingExtraError, MotionPipeline
from kinegraph.denoising import sample_hierarchy
from kinegraph.diffusion.energy import EnergyMap, EnergyMaps, Plane, noise_field, plane_through, potential
from kinegraph.diffusion.sampling import StepInfo, initial_noise
from kinegraph.energy import axes_around, energy_maps
from kinegraph.errors import NonFiniteError, OutputError
from kinegraph.formats.energy_png import save_energy_maps
from kinegraph.options import resolve_options
from support.cli_runs import fails

WALK, WAVE = "a person walks forward", "a person waves the right hand"
FEW: dict[str, Any] = {"steps": (2, 2, 4), "seconds": 2, "seed": 5}


GRID = 9


@pytest.fixture(autouse=True)
def coarse_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kinegraph.energy.GRID", GRID)


def by_loops(field: np.ndarray, spacing: float) -> np.ndarray:
    """The definition, edge by edge, solved by another routine."""
    size = len(field)
    rows, values = [], []
    for i in range(size):
        for j in range(size):
            for axis, (k, m) in enumerate(((i, j + 1), (i + 1, j))):
                if k < size and m < size:
                    row = np.zeros(size * size)
                    row[k * size + m], row[i * size + j] = 1.0, -1.0
                    rows.append(row)
                    values.append(spacing * 0.5 * (field[i, j, axis] + field[k, m, axis]))
    energy = np.linalg.lstsq(np.array(rows), np.array(values), rcond=None)[0].reshape(size, size)
    return energy - energy.mean()


def test_any_field_has_the_energy_of_its_definition() -> None:
    field = np.random.default_rng(1).standard_normal((6, 6, 2))
    energy, rest = potential(field, 0.7)
    np.testing.assert_allclose(energy, by_loops(field, 0.7), atol=1e-10)
    assert 0.1 < rest < 1
    other = np.random.default_rng(2).standard_normal((6, 6, 2))
    mixed = potential(0.3 * field - 2 * other, 0.7)[0]
    np.testing.assert_allclose(mixed, 0.3 * energy - 2 * potential(other, 0.7)[0], atol=1e-10)


def test_a_gradient_gives_its_potential_and_a_whirl_none() -> None:
    axis = np.linspace(-1.5, 2, 15)
    x, y = np.meshgrid(axis, axis)
    bowl = 0.5 * x**2 + y**2 + 0.3 * x * y - y
    energy, rest = potential(np.stack([x + 0.3 * y, 2 * y + 0.3 * x - 1], axis=-1), axis[1] - axis[0])
    np.testing.assert_allclose(energy, bowl - bowl.mean(), atol=1e-10)
    assert rest < 1e-10
    energy, rest = potential(np.stack([-y, x], axis=-1), axis[1] - axis[0])
    assert rest > 0.5


def test_the_energy_of_a_gaussian_is_lowest_at_its_mean() -> None:
    """If all clips are one latent m: eps(z_t) = (z_t - sqrt(a) m) / sqrt(1 - a), E = |z - m|^2 a / (2 sqrt(1 - a))."""
    rng = np.random.default_rng(3)
    ends = [rng.standard_normal((2, 3)) for _ in range(3)]
    plane = plane_through(ends)
    mean, signal = plane.latent(0.4, -0.8), 0.6
    asked = []

    def predict(latent: np.ndarray, step: int) -> np.ndarray:
        asked.append(step)
        return ((latent - np.sqrt(signal) * mean) / np.sqrt(1 - signal)).astype(np.float32)

    places = (np.linspace(-1, 2, 9), np.linspace(-2, 1, 9))
    energy, _ = potential(noise_field(predict, 7, signal, plane, places, lambda: None), 3 / 8)
    x, y = np.meshgrid(*places)
    wanted = ((x - 0.4) ** 2 + (y + 0.8) ** 2) * signal / (2 * np.sqrt(1 - signal))
    np.testing.assert_allclose(energy, wanted - wanted.mean(), atol=1e-5)
    assert asked == [7] * 81


def test_the_plane_holds_the_samples() -> None:
    rng = np.random.default_rng(4)
    ends = [rng.standard_normal((2, 5)) for _ in range(4)]
    plane = plane_through(ends)
    np.testing.assert_allclose(plane.axes @ plane.axes.T, np.eye(2), atol=1e-12)
    for end in ends[:3]:
        np.testing.assert_allclose(plane.latent(*plane.place(end)), end, atol=1e-12)
    assert plane.place(ends[0]).tolist() == [0, 0]
    first, second = plane.place(ends[1]), plane.place(ends[2])
    assert first[1] == pytest.approx(second[1]) and second[0] > first[0]


@pytest.mark.parametrize("count", [2, 3, 4])
def test_samples_that_coincide_leave_a_plane(count: int) -> None:
    same = np.arange(6.0).reshape(2, 3)
    plane = plane_through([same] * count)
    np.testing.assert_allclose(plane.axes @ plane.axes.T, np.eye(2), atol=1e-12)
    first, second = axes_around(np.zeros((count, 2)))
    assert first[0] == second[0] == -1 and len(first) == GRID


def test_noise_that_is_none_is_an_error() -> None:
    plane = Plane(np.zeros((1, 2)), np.eye(2))
    with pytest.raises(NonFiniteError):
        noise_field(lambda z, _: z * np.nan, 0, 0.5, plane, (np.arange(2.0), np.arange(2.0)), lambda: None)


@pytest.fixture
def maps_of_one(toy: MotionPipeline) -> EnergyMaps:
    """Maps of one concept, of its composition and of its text, whose clips are one and the same."""
    maps = energy_maps(toy, [WALK], **FEW)
    assert max(np.abs(energy.sample).max() for energy in maps.maps) < 1e-4
    return maps


def test_a_latent_composition_is_the_sum_of_its_concepts(toy: MotionPipeline) -> None:
    # Eq. 7 with weights that sum to 1: what the concepts share cancels, the guided predictions add up
    maps = energy_maps(toy, [Concept(WALK, 0.3), Concept(WAVE, 0.7)], method="latent", **FEW).maps
    first, second, composed = (energy.energy - energy.energy.mean() for energy in maps[:3])
    np.testing.assert_allclose(composed, 0.3 * first + 0.7 * second, atol=1e-4 * np.ptp(composed))
    assert np.abs(first - second).max() > 0.1 * np.ptp(composed)


def test_a_map_follows_the_predictions_of_generate(toy: MotionPipeline, maps_of_one: EnergyMaps) -> None:
    """Ask the guided predictor of `generate`, which knows nothing of compositions, point by point."""
    options = resolve_options(toy.manifest, **FEW)
    sampler = toy.sampler
    conditions = toy.encoder.attend(toy.encoder.encode_text([toy.parse(WALK)]))
    schedule, levels = sampler.schedule, sampler.level_plans(options)
    predictors: dict[str, Any] = {}

    def make_predictor(level: str, ddim: Any, coarse: Any) -> Any:
        predictors[level] = sampler.predictor(conditions, None, [options], level, ddim, coarse)
        return predictors[level]

    noise_of_levels = [noise[None] for noise in initial_noise(FEW["seed"], levels)]
    end = sample_hierarchy(levels, noise_of_levels, make_predictor, schedule)[-1][0].astype(np.float64)
    # of a plane through one sample, the axes are the first two coordinates
    signals = schedule.alphas_cumprod[schedule.timesteps(4)]
    step = int(np.argmin(np.abs(signals - 0.9)))
    field = np.zeros((GRID, GRID, 2))
    for i, second in enumerate(maps_of_one.second):
        for j, first in enumerate(maps_of_one.first):
            point = end.copy()
            point[0, 0] += first
            point[0, 1] += second
            noise = predictors["specific"]((signals[step] ** 0.5 * point[None]).astype(np.float32), step)
            field[i, j] = signals[step] ** 0.5 * noise[0, 0, :2]
    energy = by_loops(field, maps_of_one.first[1] - maps_of_one.first[0])
    np.testing.assert_allclose(maps_of_one.maps[1].energy, energy - energy.min(), atol=1e-3 * np.ptp(energy))


def test_one_concept_its_composition_and_its_text_have_one_map(maps_of_one: EnergyMaps) -> None:
    concept, composed, text = maps_of_one.maps
    for other in (composed, text):
        np.testing.assert_allclose(other.energy, concept.energy, atol=1e-4 * np.ptp(concept.energy))


def test_progress_is_told_and_can_stop(toy: MotionPipeline) -> None:
    seen: list[StepInfo] = []
    energy_maps(toy, [WALK, WAVE], **FEW, on_step=seen.append)
    rows = [info for info in seen if info.level == "energy"]
    assert [info.done for info in rows] == list(range(1, 4 * GRID + 1)) and rows[-1].total == 4 * GRID
    assert len(seen) == 8 + len(rows)
    with pytest.raises(Cancelled, match="row 2"):
        energy_maps(toy, [WALK], **FEW, on_step=lambda info: not (info.level == "energy" and info.step == 2))


def test_bad_input_is_refused_as_compose_does(toy: MotionPipeline) -> None:
    for concepts, how in (([], {}), ([WALK], {"method": "sum"}), ([WALK], {"lambdas": (1, 1, 1)})):
        with pytest.raises(InvalidInputError):
            energy_maps(toy, concepts, **how, **FEW, on_step=lambda _: pytest.fail("a model ran"))


def some_maps(count: int = 3, label: str = "a $5 walk") -> EnergyMaps:
    axis = np.linspace(-1, 1, 7)
    bowl = axis[:, None] ** 2 + axis[None] ** 2
    maps = [EnergyMap(label, bowl * (k + 1), np.array([0.1 * k, 0.0]), 0.3 * k, 0.01) for k in range(count)]
    return EnergyMaps(tuple(maps), axis, axis, 101)


@pytest.mark.parametrize("count", [1, 3, 10])
def test_the_picture_depends_on_the_maps_alone(count: int, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    for name in ("one.png", "two.png"):
        save_energy_maps(some_maps(count), tmp_path / name)
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()
    assert (tmp_path / "one.png").read_bytes()[:4] == b"\x89PNG"
    with pytest.raises(OutputError, match="exists"):
        save_energy_maps(some_maps(), tmp_path / "one.png")
    save_energy_maps(some_maps(label="word " * 100), tmp_path / "one.png", force=True)


def test_flat_maps_are_drawn(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    flat = EnergyMap("nothing", np.zeros((3, 3)), np.zeros(2), 0.0, 0.0)
    save_energy_maps(EnergyMaps((flat,), np.arange(3.0), np.arange(3.0), 1), tmp_path / "flat.png")


def test_without_matplotlib_the_way_out_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("kinegraph.formats.find_spec", lambda package: None)
    with pytest.raises(MissingExtraError, match=r"kinegraph\[plot\]"):
        save_energy_maps(some_maps(), tmp_path / "one.png")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-o", "x.npz", "--energy", "x.bvh"], "bvh"),
        (["-o", "x.png", "--energy", "./x.png"], "same file"),
        (["-o", "x.npz", "--energy", "nowhere/x.png"], "nowhere"),
    ],
)
def test_the_command_line_checks_the_picture_first(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    message: str,
) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    assert message in fails(capsys, "compose", "--and", WALK, *arguments)
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("toy_by_default")
def test_the_command_line_draws(toy: MotionPipeline, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from kinegraph import cli

    words = ["--and", WALK, "--and", f"{WAVE}:0.8", "--steps", "2", "--seconds", "1", "--seed", "3", "--threads", "1"]
    target, picture = tmp_path / "x.npz", tmp_path / "energy.png"
    assert cli.main(["compose", *words, "-o", str(target), "--energy", str(picture)]) == 0
    wishes: dict[str, Any] = {"steps": 2, "seconds": 1, "seed": 3}
    save_energy_maps(energy_maps(toy, [Concept(WALK), Concept(WAVE, 0.8)], **wishes), tmp_path / "again.png")
    assert target.is_file() and picture.read_bytes() == (tmp_path / "again.png").read_bytes()
