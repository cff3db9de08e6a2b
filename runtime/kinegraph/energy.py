"""What a composition pulls towards (EnergyMoGen, Fig. 5, 6): the energy of each concept, of their composition, and of
one text that names all, on one plane of latents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from kinegraph.arrays import DoubleArray, FloatArray
from kinegraph.bundle.contract import LEVELS
from kinegraph.concepts import Concept, validate_composition
from kinegraph.conditioning import Conditions
from kinegraph.denoising import Denoisers
from kinegraph.diffusion.composition import CompositionWeights
from kinegraph.diffusion.energy import SAME, EnergyMap, EnergyMaps, noise_field, plane_through, potential
from kinegraph.diffusion.sampling import (
    DdimCoefficients,
    OnStep,
    Predict,
    StepInfo,
    ddim_coefficients,
    initial_noise,
    sample_hierarchy,
    sample_level,
)
from kinegraph.errors import Cancelled
from kinegraph.graph import SemanticGraph
from kinegraph.options import GenerateOptions, Guidance, Steps, resolve_options
from kinegraph.pipeline import MotionPipeline

GRID: Final = 21
"""Places along each side of a map: GRID^2 runs of the finest step graph per map."""
SIGNAL: Final = 0.9
"""alpha_bar of the step that is shown, or the nearest to it: noise of a third of the latents' spread. Earlier steps
look at all motions at once, and their lowest places lie outside the map."""
MARGIN: Final = 1.6
"""Side of the map in terms of the samples it shows."""


@dataclass
class _Rows:
    """Tells of the rows of maps that are done."""

    on_step: OnStep | None
    total: int
    timestep: int
    done: int = 0

    def tell(self) -> None:
        self.done += 1
        info = StepInfo("energy", self.done, self.total, self.done, self.total, self.timestep)
        if self.on_step is not None and self.on_step(info) is False:
            raise Cancelled(f"stopped by on_step at row {self.done} of {self.total} of the energy maps")


def energy_maps(
    pipe: MotionPipeline,
    concepts: Sequence[Concept | str | SemanticGraph],
    *,
    method: str = "fused",
    text: str | SemanticGraph | None = None,
    lambdas: tuple[float, float, float] | None = None,
    agd: tuple[float, float] | None = None,
    seconds: float | None = None,
    seed: int | None = None,
    steps: Steps | None = None,
    guidance: Guidance | None = None,
    on_step: OnStep | None = None,
) -> EnergyMaps:
    """The energy of each concept, of their composition and of the joint text.

    Args:
        pipe: a loaded bundle.
        concepts, method, text, lambdas, agd, seconds, seed, steps, guidance: as in `MotionPipeline.compose`; the joint
            text has a map whatever the method.
        on_step: told of the steps of the composition, then of every row of the maps (level "energy").

    Raises:
        InvalidInputError: as in `MotionPipeline.compose`; nothing has been run.
        Cancelled: `on_step` returned False.
        NonFiniteError: a model produced NaN or infinity.
    """
    what = validate_composition(concepts, method, text, lambdas, agd)
    options = resolve_options(pipe.manifest, seconds=seconds, seed=seed, steps=steps, guidance=guidance)
    encoded, mixture, options = pipe._mixed(what, options, seconds is None)
    found = (*what.concepts, *what.negated)
    labels = [concept.caption + ("" if concept.weight == 1 else f", weight {concept.weight:g}") for concept in found]
    joint = Concept(what.joint)
    labels += [f"composed: {method}", f"one text: {joint.caption}"]
    by_themselves = [validate_composition([each.text], "latent", None, None, None) for each in (*found, joint)]
    *alone, named = [pipe._mixed(each, options, False)[:2] for each in by_themselves]
    denoisers = Denoisers(pipe._sessions, pipe.manifest)
    return maps_of(denoisers, labels, [*alone, (encoded, mixture), named], options, on_step)


def maps_of(
    denoisers: Denoisers,
    labels: Sequence[str],
    mixtures: Sequence[tuple[Conditions, CompositionWeights]],
    options: GenerateOptions,
    on_step: OnStep | None,
) -> EnergyMaps:
    """Maps of several mixtures: concepts, their composition, their joint text. All share its coarser latents."""
    schedule, level = denoisers.manifest.schedule.noise, LEVELS[-1]
    plans = denoisers.plans(options)
    noises = [noise[None] for noise in initial_noise(options.seed, plans)]

    def composed(number: int, times: DdimCoefficients, coarse: FloatArray | None) -> Predict:
        return denoisers.predictor_of(LEVELS[number], *mixtures[-2], coarse, options, times)

    coarse = sample_hierarchy(plans, noises, composed, schedule, on_step)[-2]
    times = ddim_coefficients(schedule, options.steps[level])
    predictors = [denoisers.predictor_of(level, *each, coarse, options, times) for each in mixtures]
    ends = [sample_level(noises[-1], each, times, lambda _: None)[0].astype(np.float64) for each in predictors]
    plane = plane_through([ends[-2], *ends[:-2], ends[-1]])
    places = axes_around(np.stack([plane.place(end) for end in ends]))
    signals = schedule.alphas_cumprod[times.timesteps]
    step = int(np.abs(signals - SIGNAL).argmin())
    rows = _Rows(on_step, len(ends) * GRID, int(times.timesteps[step]))
    maps = []
    for label, predict, end in zip(labels, predictors, ends, strict=True):
        field = noise_field(predict, step, signals[step], plane, places, rows.tell)
        energy, rest = potential(field, places[0][1] - places[0][0])
        off_plane = float(np.linalg.norm(end - plane.latent(*plane.place(end))))
        maps.append(EnergyMap(label, energy - energy.min(), plane.place(end), off_plane, rest))
    return EnergyMaps(tuple(maps), *places, rows.timestep)


def axes_around(samples: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """Places (GRID,) along both axes of a square around samples (n, 2)."""
    low, high = samples.min(axis=0), samples.max(axis=0)
    side = float((high - low).max())
    # samples that coincide leave the size open: one standard deviation each way
    half = MARGIN * side / 2 if side > SAME else 1.0
    first, second = (np.linspace(middle - half, middle + half, GRID) for middle in (low + high) / 2)
    return first, second
