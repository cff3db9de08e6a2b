"""Map what a composition pulls towards (EnergyMoGen, Fig. 5, 6).

One map for the energy of each concept, of their composition, and of one text that names all, on one plane of latents.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from kinegraph.arrays import DoubleArray
from kinegraph.bundle.contract import LEVELS
from kinegraph.concepts import Concept, validate_composition
from kinegraph.conditioning import Conditions
from kinegraph.denoising import LatentSampler, sample_hierarchy
from kinegraph.diffusion.composition import CompositionWeights
from kinegraph.diffusion.energy import SAME, EnergyMap, EnergyMaps, noise_field, plane_through, potential
from kinegraph.diffusion.sampling import OnStep, StepInfo, ddim_coefficients, initial_noise, is_stop
from kinegraph.errors import Cancelled, InvalidInputError
from kinegraph.graph import SemanticGraph
from kinegraph.options import LATENT, Deadline, GenerateOptions, Guidance, Steps, resolve_options
from kinegraph.pipeline import MotionPipeline
from kinegraph.validation import check_callback

GRID: Final = 21
"""Points along each side of a map: GRID^2 runs of the finest denoiser per map."""
SIGNAL: Final = 0.9
"""alpha_bar of the step that is shown, or the nearest to it: noise of a third of the latents' spread.

Earlier steps look at all motions at once, and their lowest points lie outside the map.
"""
MARGIN: Final = 1.6
"""Side of the map in terms of the spread of the samples it shows."""


@dataclass
class _RowProgress:
    """Reports finished rows of maps to `on_step`."""

    on_step: OnStep | None
    total: int
    timestep: int
    done: int = 0

    def report(self) -> None:
        self.done += 1
        info = StepInfo("energy", self.done, self.total, self.done, self.total, self.timestep)
        if self.on_step is not None and is_stop(self.on_step(info)):
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
    timeout: float | None = None,
    on_step: OnStep | None = None,
) -> EnergyMaps:
    """Map the energy of each concept, of their composition and of the joint text.

    Args:
        pipe: a loaded bundle.
        concepts, method, text, lambdas, agd, seconds, seed, steps, guidance, timeout: as in `MotionPipeline.compose`;
            the joint text has a map whatever the method.
        on_step: called after the steps of the composition, then after every row of the maps (level "energy").

    Raises:
        InvalidInputError: as in `MotionPipeline.compose`, and for released networks; nothing has been run.
        Cancelled: `on_step` returned False, or as `TimedOut`, the timeout is over.
        NonFiniteError: a model produced NaN or infinity.
    """
    if pipe.manifest.family != "kinegraph":
        raise InvalidInputError(
            f"energy maps are drawn for kinegraph's own networks alone, and {pipe.manifest.name} has those of the "
            f"family {pipe.manifest.family!r}; load another bundle"
        )
    if pipe.sampler.space != LATENT:
        raise InvalidInputError("energy maps are of latent space; take the pipeline that `MotionPipeline.load` gives")
    check_callback(on_step, "on_step")
    on_step = Deadline.start(timeout).watch(on_step)
    spec = validate_composition(concepts, method, text, lambdas, agd)
    options = resolve_options(pipe.manifest, seconds=seconds, seed=seed, steps=steps, guidance=guidance)
    conditions, plan, options, _ = pipe.encode_composition(spec, options, own_length=seconds is None)
    all_concepts = (*spec.concepts, *spec.negated)
    joint = Concept(spec.joint)
    # Each concept is mapped as the composition sees it: as a part of what happens, or as all of it.
    partial = (*spec.partial[: len(spec.concepts)], *(True for _ in spec.negated), False)
    labels = [_label(concept) for concept in all_concepts]
    labels += [f"composed: {method}", f"one text: {joint.caption}"]
    compositions = [
        _encode_alone(pipe, concept, options, is_part)
        for concept, is_part in zip((*all_concepts, joint), partial, strict=True)
    ]
    compositions.insert(-1, (conditions, plan.weights))
    return map_compositions(pipe.sampler, labels, compositions, options, on_step)


def _label(concept: Concept) -> str:
    return concept.caption if concept.weight == 1 else f"{concept.caption}, weight {concept.weight:g}"


def _encode_alone(
    pipe: MotionPipeline, concept: Concept, options: GenerateOptions, is_part: bool
) -> tuple[Conditions, CompositionWeights]:
    """Encode a concept as a composition of itself with weight 1; `is_part` as in `CompositionSpec.partial`."""
    spec = replace(validate_composition([concept.text], "latent", None, None, None), partial=(is_part,))
    conditions, plan, _, _ = pipe.encode_composition(spec, options, own_length=False)
    return conditions, plan.weights


def map_compositions(
    sampler: LatentSampler,
    labels: Sequence[str],
    compositions: Sequence[tuple[Conditions, CompositionWeights]],
    options: GenerateOptions,
    on_step: OnStep | None,
) -> EnergyMaps:
    """Map the energies of several compositions on one plane.

    Args:
        sampler: of the bundle.
        labels: of the maps.
        compositions: concepts, their composition, their joint text; all are given its coarser latents.
        options: of the clip.
        on_step: see `energy_maps`.
    """
    schedule, finest = sampler.schedule, LEVELS[-1]
    levels = sampler.level_plans(options)
    noise = [level[None] for level in initial_noise(options.seed, levels)]
    make_predictor = partial(sampler.predictor, *compositions[-2], [options])
    coarse = sample_hierarchy(levels, noise, make_predictor, schedule, on_step)[-2]
    ddim = ddim_coefficients(schedule, options.steps[finest])
    predictors = [sampler.predictor(*composition, [options], finest, ddim, coarse) for composition in compositions]
    samples = [
        sample_hierarchy(levels[-1:], noise[-1:], lambda *_, predict=predict: predict, schedule)[-1][0].astype(
            np.float64
        )
        for predict in predictors
    ]
    plane = plane_through([samples[-2], *samples[:-2], samples[-1]])
    axes = axes_around(np.stack([plane.place(sample) for sample in samples]))
    signals = schedule.alphas_cumprod[ddim.timesteps]
    step = int(np.abs(signals - SIGNAL).argmin())
    progress = _RowProgress(on_step, len(samples) * GRID, int(ddim.timesteps[step]))
    maps = []
    for label, predict, sample in zip(labels, predictors, samples, strict=True):
        field = noise_field(predict, step, signals[step], plane, axes, progress.report)
        energy, rest = potential(field, axes[0][1] - axes[0][0])
        off_plane = float(np.linalg.norm(sample - plane.latent(*plane.place(sample))))
        maps.append(EnergyMap(label, energy - energy.min(), plane.place(sample), off_plane, rest))
    return EnergyMaps(tuple(maps), *axes, progress.timestep)


def axes_around(samples: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """Place GRID points along both axes of a square around samples (n, 2)."""
    low, high = samples.min(axis=0), samples.max(axis=0)
    side = float((high - low).max())
    # samples that coincide leave the size open: one standard deviation each way
    half = MARGIN * side / 2 if side > SAME else 1.0
    first, second = (np.linspace(middle - half, middle + half, GRID) for middle in (low + high) / 2)
    return first, second
