"""The denoiser of one level, ready for the steps of one sample: what is constant over the steps is computed once.

The three latent diffusion models (GraphMotion, section 3.3): motion, then action, then specific latent."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import LEVELS
from kinegraph.bundle.manifest import Manifest
from kinegraph.bundle.sessions import Sessions
from kinegraph.conditioning import Conditions, drop_all, drop_text, for_level, stacked
from kinegraph.diffusion.composition import AttentionRouting, CompositionWeights, combine_rows, plan_rows, step_sizes
from kinegraph.diffusion.sampling import (
    DdimCoefficients,
    LevelPlan,
    OnLatent,
    OnStep,
    Predict,
    PredictorFor,
    guide,
    initial_noise,
    sample_hierarchy,
)
from kinegraph.errors import InvalidInputError
from kinegraph.options import GenerateOptions

RowNetwork = Callable[[FloatArray, int], FloatArray]
"""(latents (R, C, z), step number) -> noise (R, C, z)."""


def modulations(
    clock: onnxruntime.InferenceSession, timesteps: NDArray[np.int64], frames: NDArray[np.int64]
) -> FloatArray:
    """Scales and shifts of every step and row: (K, R, m, d); timesteps (K,), frames (R,).

    (K, 1, m, d) where all rows are of one length: onnxruntime normalises faster by one scale than by one for each row.
    """
    lengths, row = np.unique(frames, return_inverse=True)
    found: FloatArray = clock.run(["modulation"], {"timestep": timesteps, "frames": lengths})[0]
    return found if len(lengths) == 1 else found[:, row]


def row_network(
    context: onnxruntime.InferenceSession,
    step: onnxruntime.InferenceSession,
    known: Conditions,
    coarse: FloatArray | None,
    wiring: AttentionRouting,
    modulation: FloatArray,
    gamma: FloatArray | None = None,
) -> RowNetwork:
    """Noise predictions of R rows, for one level.

    Args:
        context: session of context_{level}, or of context_{level}_agd.
        step: session of step_{level}, or of step_{level}_agd.
        known: K conditions.
        coarse: (K, C', z') latent of the level above for each of them.
        wiring: of contexts and rows.
        modulation: (K, R, m, d), see `modulations`.
        gamma: (A, 2) step sizes of adaptive gradient descent, for the graphs of it.
    """
    feeds = {"nodes": known.nodes, "kind": known.kind, "order": known.order}
    bias = known.bias
    if coarse is not None:
        feeds["coarse"] = coarse
        bias = np.concatenate([bias, np.repeat(known.coarse_bias, coarse.shape[1], axis=1)], axis=1)
    names = [output.name for output in context.get_outputs()]
    attended = context.run(names, feeds)
    tokens = step.get_inputs()[0].shape[1]
    spread = np.repeat(bias[wiring.context][:, None, None, :], tokens, axis=2)
    constant = {
        **{name: value[wiring.context] for name, value in zip(names, attended, strict=True)},
        **({} if gamma is None else {"gamma": gamma}),
        "src": wiring.src,
        "combine": wiring.combine,
        "bias": spread,
    }

    def predict(latents: FloatArray, number: int) -> FloatArray:
        noise: FloatArray = step.run(["noise"], {"latent": latents, "modulation": modulation[number], **constant})[0]
        return noise

    return predict


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
        self, encoded: Conditions, mixture: CompositionWeights, options: GenerateOptions, on_step: OnStep | None
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
        mixture: CompositionWeights,
        coarse: FloatArray | None,
        options: GenerateOptions,
        times: DdimCoefficients,
    ) -> Predict:
        """Guided noise prediction of one level for a mixture, one sample at a time."""
        apart = coarse is not None and self.manifest.defaults.guidance_base == "empty"
        plan = plan_rows(mixture, options.guidance[name], coarse=apart)
        gamma = step_sizes(plan.wiring, mixture.agd) if any(mixture.agd) else None
        seen = for_level(encoded, self.manifest.levels[name].nodes)
        first = Conditions(*(part[:1] for part in vars(seen).values()))
        known = stacked(stacked(self._base(first), drop_text(first)), seen)
        rows = len(plan.mix)
        shared = None if coarse is None else np.repeat(coarse, len(known.kind), axis=0)
        network = self._network(name, known, shared, plan.wiring, np.full(rows, options.frames), times, gamma)
        return lambda latent, step: combine_rows(network(np.repeat(latent, rows, axis=0), step), plan.mix)

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
        return sample_hierarchy(plans, noises, predictor_for, self.manifest.schedule.noise, on_step, self.on_latent)[-1]

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
        network = self._network(
            name, known, twice, AttentionRouting.straight(2 * len(frames)), np.tile(frames, 2), times
        )

        def predict(latent: FloatArray, step: int) -> FloatArray:
            both, half = network(np.concatenate([latent, latent]), step), len(latent)
            return guide(both[:half], both[half:], scale)

        return predict

    def _base(self, seen: Conditions) -> Conditions:
        """What guidance leads away from."""
        return drop_all(seen) if self.manifest.defaults.guidance_base == "empty" else drop_text(seen)

    def _network(
        self,
        name: str,
        known: Conditions,
        coarse: FloatArray | None,
        wiring: AttentionRouting,
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
