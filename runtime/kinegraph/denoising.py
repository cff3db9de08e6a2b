"""From conditions to latents: the denoising loop over three levels (GraphMotion, section 3.2).

Motion, then action, then specific latent: each level is a DDIM run from its own noise, and sees the final latent of
the level above among its conditions. `sample_hierarchy` is the loop; `LatentSampler` binds a bundle's models to it.

    papers                                  here
    z_t                                     latents (B, C, z) of B samples, C tokens of width z
    z_T                                     diffusion.sampling.initial_noise
    eps(z_t, c, t)                          NoisePredictor: R latent rows in one run of a level's denoiser
    eps_0 + s (eps_c - eps_0), Eq. A        GuidedPrediction, diffusion.sampling.guide
    Eq. 7-10 (EnergyMoGen)                  ComposedPrediction, diffusion.composition
    Eq. 3, 4 (EnergyMoGen)                  adaptive gradient descent: the graphs denoiser_*_agd, given step sizes gamma
    z_{t-1}                                 diffusion.sampling.ddim_step
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from kinegraph.arrays import FloatArray, IntArray
from kinegraph.bundle.contract import LEVELS
from kinegraph.bundle.manifest import Manifest
from kinegraph.bundle.sessions import Sessions, run_model
from kinegraph.conditioning import Conditions, drop_all, drop_text, for_level, stack_rows
from kinegraph.diffusion.composition import (
    AttentionRouting,
    CompositionWeights,
    agd_step_sizes,
    combine_rows,
    plan_rows,
)
from kinegraph.diffusion.sampling import (
    DdimCoefficients,
    LevelPlan,
    NoiseSchedule,
    OnStep,
    PredictNoise,
    StepInfo,
    ddim_coefficients,
    ddim_step,
    guide,
    initial_noise,
    is_stop,
)
from kinegraph.errors import Cancelled, InvalidInputError
from kinegraph.options import LATENT, GenerateOptions
from kinegraph.validation import require_finite

MakePredictor = Callable[[str, DdimCoefficients, FloatArray | None], PredictNoise]
"""(level, its DDIM coefficients, final latents of the level above) -> predictor of the level."""

OnLatent = Callable[[str, FloatArray], None]
"""Called after every level with its name and its final latents (B, C, z)."""


def sample_hierarchy(
    levels: Sequence[LevelPlan],
    noise: Sequence[FloatArray],
    make_predictor: MakePredictor,
    schedule: NoiseSchedule,
    on_step: OnStep | None = None,
    on_latent: OnLatent | None = None,
) -> tuple[FloatArray, ...]:
    """Denoise the latents of all levels, coarse to fine.

    Args:
        levels: coarse to fine.
        noise: z_T of each level, (B, C, z).
        make_predictor: called once for each level.
        schedule: of all levels.
        on_step: called after every step; returning False stops.
        on_latent: called after every level.

    Returns:
        Final latents (B, C, z) of each level.

    Raises:
        Cancelled: `on_step` returned False.
        NonFiniteError: latents stopped being finite; names the level and the step.
    """
    done, total = 0, sum(level.steps for level in levels)
    results: list[FloatArray] = []
    for level, latents in zip(levels, noise, strict=True):
        # 1. Timesteps and DDIM coefficients of this level
        ddim = ddim_coefficients(schedule, level.steps)
        # 2. All that is constant over the steps: keys and values, adaLN modulation, attention routing
        predict_noise = make_predictor(level.name, ddim, results[-1] if results else None)
        for index, timestep in enumerate(ddim.timesteps):
            # 3. Noise prediction, guided and composed (Eq. A, 3, 4, 7-10)
            prediction = predict_noise(latents, index)
            # 4. DDIM step, z_t -> z_{t-1}
            latents = ddim_step(latents, prediction, ddim, index)
            require_finite(latents, f"step {index + 1} of level {level.name}")
            # 5. Report; the caller may cancel
            done += 1
            info = StepInfo(level.name, index + 1, level.steps, done, total, int(timestep))
            if on_step is not None and is_stop(on_step(info)):
                raise Cancelled(f"stopped by on_step at step {done} of {total}")
        # 6. The next level sees the final latents of this one
        results.append(latents)
        if on_latent is not None:
            on_latent(level.name, latents)
    return tuple(results)


@dataclass(frozen=True)
class LatentSampler:
    """The three latent diffusion models of a bundle."""

    space: ClassVar[str] = LATENT
    """Where it samples, of `options.SPACES`."""
    sessions: Sessions
    manifest: Manifest

    def sample(
        self,
        conditions: Conditions,
        weights: CompositionWeights | None,
        options: Sequence[GenerateOptions],
        on_step: OnStep | None = None,
        on_latent: OnLatent | None = None,
    ) -> FloatArray:
        """Sample latents of the finest level, (B, C, z), each sample from the noise of its own seed.

        Args:
            conditions: one row for each sample; or, with `weights`, the rows that one sample is composed of, in the
                order of the weights' concepts, joint text and negated concepts.
            weights: how the rows compose one sample (Eq. 7-10); None is plain guidance (Eq. A).
            options: of each sample; all share steps and guidance.
            on_step, on_latent: see `sample_hierarchy`.

        Raises:
            Cancelled, NonFiniteError: see `sample_hierarchy`.
        """
        noise = self.initial_noise(options)
        make_predictor = partial(self.predictor, conditions, weights, options)
        levels = self.level_plans(options[0])
        return sample_hierarchy(levels, noise, make_predictor, self.schedule, on_step, on_latent)[-1]

    def predictor(
        self,
        conditions: Conditions,
        weights: CompositionWeights | None,
        options: Sequence[GenerateOptions],
        level: str,
        ddim: DdimCoefficients,
        coarse: FloatArray | None,
    ) -> PredictNoise:
        """Make the noise prediction of one level; keys, values and modulation are computed here, once.

        Args:
            conditions, weights, options: see `sample`.
            level: its name.
            ddim: of its run.
            coarse: (B, C', z') final latents of the level above; None at the coarsest.
        """
        seen = for_level(conditions, self.kinds_seen(level))
        if weights is None:
            return self._guided(level, seen, options, ddim, coarse)
        return self._composed(level, seen, weights, options[0], ddim, coarse)

    def kinds_seen(self, level: str) -> tuple[str, ...]:
        """Return the kinds of context tokens that a level attends to, see `contract.NODE_KINDS`."""
        return self.manifest.levels[level].nodes

    @property
    def schedule(self) -> NoiseSchedule:
        """The noise schedule of all levels."""
        return self.manifest.schedule.noise

    def initial_noise(self, options: Sequence[GenerateOptions]) -> list[FloatArray]:
        """Draw z_T (B, C, z) of every level, each sample from its own seed."""
        levels = self.level_plans(options[0])
        noise_of_samples = [initial_noise(sample.seed, levels) for sample in options]
        return [np.stack(level) for level in zip(*noise_of_samples, strict=True)]

    def level_plans(self, options: GenerateOptions) -> list[LevelPlan]:
        """List the levels with the steps that a call wants, coarse to fine."""
        specs = {level: self.manifest.levels[level] for level in LEVELS if level in self.manifest.levels}
        return [LevelPlan(level, spec.tokens, spec.latent_width, options.steps[level]) for level, spec in specs.items()]

    def validate_composition(self, lambdas: tuple[float, float, float], agd: tuple[float, float]) -> None:
        """Refuse terms of a composition that the bundle's networks cannot compute.

        Args:
            lambdas: shares of the latent-aware, the semantic-aware and the joint-text term; any are possible here.
            agd: step sizes of adaptive gradient descent.

        Raises:
            InvalidInputError: `agd` is not (0, 0), and the bundle has no graphs for it.
        """
        if any(agd) and not self.sessions.denoiser_agd:
            raise InvalidInputError(
                f"bundle {self.manifest.name} {self.manifest.version} has no graphs for adaptive gradient descent: "
                "leave agd out, or export the bundle again with this kinegraph"
            )

    def _guided(
        self,
        level: str,
        seen: Conditions,
        options: Sequence[GenerateOptions],
        ddim: DdimCoefficients,
        coarse: FloatArray | None,
    ) -> GuidedPrediction:
        """Bind 2 B rows: the unconditional predictions of all samples, then the conditional ones."""
        frames = np.array([sample.frames for sample in options])
        contexts = stack_rows(self._unconditional(seen), seen)
        coarse_twice = None if coarse is None else np.concatenate([coarse, coarse])
        routing = AttentionRouting.identity(2 * len(frames))
        predict_rows = self._bind(level, contexts, coarse_twice, routing, np.tile(frames, 2), ddim)
        return GuidedPrediction(predict_rows, options[0].guidance[level])

    def _composed(
        self,
        level: str,
        seen: Conditions,
        weights: CompositionWeights,
        options: GenerateOptions,
        ddim: DdimCoefficients,
        coarse: FloatArray | None,
    ) -> ComposedPrediction:
        """Bind the rows of one composed sample (`diffusion.composition.plan_rows`)."""
        # eps_c, no text beside the coarser latent, is a prediction of its own only where eps_0 lacks that latent
        apart = coarse is not None and self.manifest.defaults.guidance_base == "empty"
        plan = plan_rows(weights, options.guidance[level], coarse=apart)
        gamma = agd_step_sizes(plan.routing, weights.agd) if any(weights.agd) else None
        first = seen.map(lambda part: part[:1])
        contexts = stack_rows(self._unconditional(first), drop_text(first), seen)
        shared = None if coarse is None else np.repeat(coarse, len(contexts.kind), axis=0)
        frames = np.full(len(plan.coefficients), options.frames)
        return ComposedPrediction(
            self._bind(level, contexts, shared, plan.routing, frames, ddim, gamma), plan.coefficients
        )

    def _unconditional(self, seen: Conditions) -> Conditions:
        """Drop what guidance leads away from: the text, and where the bundle says so the coarser latent too."""
        return drop_all(seen) if self.manifest.defaults.guidance_base == "empty" else drop_text(seen)

    def _bind(
        self,
        level: str,
        contexts: Conditions,
        coarse: FloatArray | None,
        routing: AttentionRouting,
        frames: IntArray,
        ddim: DdimCoefficients,
        gamma: FloatArray | None = None,
    ) -> NoisePredictor:
        sessions = self.sessions
        modulation = adaln_modulation(sessions.modulation[level], ddim.timesteps, frames)
        if gamma is None:
            context, denoiser = sessions.context[level], sessions.denoiser[level]
        else:
            context, denoiser = sessions.context_agd[level](), sessions.denoiser_agd[level]()
        return bind_step_inputs(context, denoiser, contexts, coarse, routing, modulation, gamma)


@dataclass(frozen=True)
class GuidedPrediction:
    """eps = eps_0 + s (eps_c - eps_0) for B samples (GraphMotion, Eq. A); a `PredictNoise`."""

    predict_rows: NoisePredictor
    """Of 2 B rows: unconditional, then conditional."""
    scale: float
    """Guidance scale s."""

    def __call__(self, latents: FloatArray, index: int) -> FloatArray:
        rows = self.predict_rows(np.concatenate([latents, latents]), index)
        unconditional, conditional = rows[: len(latents)], rows[len(latents) :]
        return guide(unconditional, conditional, self.scale)


@dataclass(frozen=True)
class ComposedPrediction:
    """eps = sum_r coefficient_r eps_r for one sample (EnergyMoGen, Eq. 7-10); a `PredictNoise`."""

    predict_rows: NoisePredictor
    coefficients: FloatArray
    """(R,)."""

    def __call__(self, latents: FloatArray, index: int) -> FloatArray:
        rows = np.repeat(latents, len(self.coefficients), axis=0)
        return combine_rows(self.predict_rows(rows, index), self.coefficients)


@dataclass(frozen=True)
class NoisePredictor:
    """A level's denoiser with all inputs that are constant over the steps; made by `bind_step_inputs`."""

    denoiser: onnxruntime.InferenceSession
    constant: Mapping[str, Any]
    """Keys and values (or projected contexts), routing, bias, step sizes."""
    modulation: FloatArray
    """(K, R, m, d) or (K, 1, m, d), see `adaln_modulation`."""

    def __call__(self, latents: FloatArray, index: int) -> FloatArray:
        """Predict the noise of R latent rows (R, C, z) at step `index`."""
        inputs = {"latent": latents, "modulation": self.modulation[index], **self.constant}
        return run_model(self.denoiser, ["noise"], inputs, "the denoiser")[0]


def adaln_modulation(session: onnxruntime.InferenceSession, timesteps: IntArray, frames: IntArray) -> FloatArray:
    """Compute the scales and shifts of every adaptive LayerNorm (adaLN), for all steps at once.

    Args:
        session: of the level's modulation graph.
        timesteps: (K,).
        frames: (R,) length of each row's clip.

    Returns:
        (K, R, m, d); (K, 1, m, d) if all rows have one length: onnxruntime normalises faster by one scale than by one
        for each row.
    """
    lengths, row = np.unique(frames, return_inverse=True)
    inputs = {"timestep": timesteps, "frames": lengths}
    (modulation,) = run_model(session, ["modulation"], inputs, "the adaLN modulation")
    return modulation if len(lengths) == 1 else modulation[:, row]


def bind_step_inputs(
    context: onnxruntime.InferenceSession,
    denoiser: onnxruntime.InferenceSession,
    contexts: Conditions,
    coarse: FloatArray | None,
    routing: AttentionRouting,
    modulation: FloatArray,
    gamma: FloatArray | None = None,
    tokens: int | None = None,
) -> NoisePredictor:
    """Compute what the steps of one level share: keys and values of every layer, once, and their routing.

    Args:
        context: session of context_{level}, or of context_{level}_agd.
        denoiser: session of denoiser_{level}, or of denoiser_{level}_agd.
        contexts: K rows of conditions.
        coarse: (K, C', z') latents of the level above for each of them.
        routing: of contexts and latent rows.
        modulation: see `adaln_modulation`.
        gamma: (A, 2) step sizes of adaptive gradient descent, for its graphs.
        tokens: C, for a denoiser that takes any number of latent tokens.
    """
    inputs: dict[str, NDArray[Any]] = {"nodes": contexts.nodes, "kind": contexts.kind, "order": contexts.order}
    bias = contexts.bias
    if coarse is not None:
        inputs["coarse"] = coarse
        bias = np.concatenate([bias, np.repeat(contexts.coarse_bias, coarse.shape[1], axis=1)], axis=1)
    # Context encoders of format 4 let their tokens attend to one another; older ones have no such input.
    if any(tensor.name == "bias" for tensor in context.get_inputs()):
        inputs["bias"] = bias
    names = [output.name for output in context.get_outputs()]
    # key_i, value_i (K, h, S, d/h) of every layer, or the projected context (K, S, d) for AGD
    attended = dict(zip(names, run_model(context, names, inputs, "the context encoder"), strict=True))
    latent_tokens = denoiser.get_inputs()[0].shape[1] if tokens is None else tokens
    if not (routing.is_identity and len(routing.context) == len(contexts.kind)):
        attended = {name: value[routing.context] for name, value in attended.items()}
    constant: dict[str, Any] = {
        **attended,
        "src": routing.src,
        "combine": routing.combine,
        # log edge weights and padding, (A, S) -> (A, 1, C, S)
        "bias": np.repeat(bias[routing.context][:, None, None, :], latent_tokens, axis=2),
    }
    if gamma is not None:
        constant["gamma"] = gamma
    return NoisePredictor(denoiser, constant, modulation)
