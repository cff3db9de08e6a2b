"""The three latent diffusion models (GraphMotion, section 3.3): motion, then action, then specific latent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinegraph.conditions import Conditions, for_level, stacked, without_anything, without_text
from kinegraph.contract import LEVELS
from kinegraph.diffusion.composition import Mixture, Wiring, composition, mixed, step_sizes
from kinegraph.diffusion.ddim import DdimCoefficients
from kinegraph.diffusion.guidance import guided
from kinegraph.diffusion.sampler import (
    LevelPlan,
    OnLatent,
    OnStep,
    Predict,
    PredictorFor,
    coarse_to_fine,
    initial_noise,
)
from kinegraph.errors import InvalidInputError
from kinegraph.manifest import Manifest
from kinegraph.network import RowNetwork, modulations, row_network
from kinegraph.options import GenerateOptions
from kinegraph.sessions import Sessions

FloatArray = NDArray[np.float32]


@dataclass(frozen=True)
class Denoisers:
    """From encoded graphs to the latent that the decoder reads."""

    sessions: Sessions
    manifest: Manifest
    on_latent: OnLatent | None = None
    """Told of every level that is done."""

    def guided(self, encoded: Conditions, options: Sequence[GenerateOptions], on_step: OnStep | None) -> FloatArray:
        """Latents of the finest level, (B, C, z); all samples of a batch share steps and guidance."""
        first = options[0]
        frames = np.array([each.frames for each in options])

        def predictor_for(number: int, times: DdimCoefficients, coarse: FloatArray | None) -> Predict:
            name = LEVELS[number]
            return self._predictor(name, encoded, coarse, frames, times, first.guidance[name])

        return self._sampled(options, predictor_for, on_step)

    def composed(
        self, encoded: Conditions, mixture: Mixture, options: GenerateOptions, on_step: OnStep | None
    ) -> FloatArray:
        """Latent of the finest level from several graphs, one run per step whatever the method.

        Rows of `encoded` come in the order of the mixture's weights, its joint text and its negated concepts.
        """

        def predictor_for(number: int, times: DdimCoefficients, coarse: FloatArray | None) -> Predict:
            return self.predictor_of(LEVELS[number], encoded, mixture, coarse, options, times)

        return self._sampled([options], predictor_for, on_step)

    def predictor_of(
        self,
        name: str,
        encoded: Conditions,
        mixture: Mixture,
        coarse: FloatArray | None,
        options: GenerateOptions,
        times: DdimCoefficients,
    ) -> Predict:
        """Guided noise prediction of one level for a mixture, one sample at a time."""
        apart = coarse is not None and self.manifest.defaults.guidance_base == "empty"
        plan = composition(mixture, options.guidance[name], coarse=apart)
        gamma = step_sizes(plan.wiring, mixture.agd) if any(mixture.agd) else None
        seen = for_level(encoded, self.manifest.levels[name].nodes)
        first = Conditions(*(part[:1] for part in vars(seen).values()))
        known = stacked(stacked(self._base(first), without_text(first)), seen)
        rows = len(plan.mix)
        shared = None if coarse is None else np.repeat(coarse, len(known.kind), axis=0)
        network = self._network(name, known, shared, plan.wiring, np.full(rows, options.frames), times, gamma)
        return lambda latent, step: mixed(network(np.repeat(latent, rows, axis=0), step), plan.mix)

    def plans(self, options: GenerateOptions) -> list[LevelPlan]:
        """The levels of a run."""
        return [
            LevelPlan(name, spec.tokens, spec.latent_width, options.steps[name])
            for name, spec in ((name, self.manifest.levels[name]) for name in LEVELS)
        ]

    def _sampled(
        self, options: Sequence[GenerateOptions], predictor_for: PredictorFor, on_step: OnStep | None
    ) -> FloatArray:
        """All levels, each sample from the noise of its own seed."""
        plans = self.plans(options[0])
        per_sample = [initial_noise(each.seed, plans) for each in options]
        noises = [np.stack(level) for level in zip(*per_sample, strict=True)]
        return coarse_to_fine(plans, noises, predictor_for, self.manifest.schedule.noise, on_step, self.on_latent)[-1]

    def _predictor(
        self,
        name: str,
        encoded: Conditions,
        coarse: FloatArray | None,
        frames: NDArray[np.int64],
        times: DdimCoefficients,
        scale: float,
    ) -> Predict:
        """Guided noise prediction of one level: rows are the unconditional predictions of all samples, then theirs."""
        seen = for_level(encoded, self.manifest.levels[name].nodes)
        known = stacked(self._base(seen), seen)
        twice = None if coarse is None else np.concatenate([coarse, coarse])
        network = self._network(name, known, twice, Wiring.straight(2 * len(frames)), np.tile(frames, 2), times)

        def predict(latent: FloatArray, step: int) -> FloatArray:
            both, half = network(np.concatenate([latent, latent]), step), len(latent)
            return guided(both[:half], both[half:], scale)

        return predict

    def _base(self, seen: Conditions) -> Conditions:
        """What guidance leads away from."""
        return without_anything(seen) if self.manifest.defaults.guidance_base == "empty" else without_text(seen)

    def _network(
        self,
        name: str,
        known: Conditions,
        coarse: FloatArray | None,
        wiring: Wiring,
        frames: NDArray[np.int64],
        times: DdimCoefficients,
        gamma: FloatArray | None = None,
    ) -> RowNetwork:
        sessions = self.sessions
        modulation = modulations(sessions.clock[name], times.timesteps, frames)
        context, step = sessions.context[name], sessions.step[name]
        if gamma is not None:
            context, step = sessions.context_agd[name](), sessions.step_agd[name]()
        return row_network(context, step, known, coarse, wiring, modulation, gamma)


def check_step_sizes(sessions: Sessions, manifest: Manifest, agd: tuple[float, float]) -> None:
    """Raises InvalidInputError where adaptive gradient descent is asked for and the bundle has no graphs for it."""
    if any(agd) and not sessions.step_agd:
        raise InvalidInputError(
            f"bundle {manifest.name} {manifest.version} has no graphs for adaptive gradient descent: "
            "leave agd out, or export the bundle again with this kinegraph"
        )
