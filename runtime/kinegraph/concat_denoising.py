"""From conditions to latents with released networks: latent, time and conditions in one sequence (GraphMotion, MLD).

The loop is `denoising.sample_hierarchy`. What differs is what it runs on:

- Every condition is a token of the denoiser's sequence. So two concepts cannot meet inside a layer: Eq. 9 and Eq. 10's
  share of it are refused. Guidance (Eq. A) and the latent-aware sums (Eq. 7, 8) need predictions alone.
- Both halves of guidance have a coarser latent of their own: the conditional half the one that guidance led to, the
  unconditional half one whose *last* step took the unconditional prediction. The loop therefore carries
  [unconditional, conditional] rows, equal until that step.

K graphs for B samples give 2K rows of a denoiser: K unconditional, then K conditional.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import onnxruntime

from kinegraph.arrays import FloatArray
from kinegraph.bundle.released_contract import slots_seen
from kinegraph.bundle.sessions import run_model
from kinegraph.conditioning import Conditions
from kinegraph.denoising import LatentSampler, OnLatent, sample_hierarchy
from kinegraph.diffusion.composition import CompositionWeights
from kinegraph.diffusion.sampling import DdimCoefficients, OnStep, PredictNoise
from kinegraph.errors import InvalidInputError
from kinegraph.options import GenerateOptions
from kinegraph.slot_conditioning import SlotConditions


@dataclass(frozen=True)
class GuidanceWeights:
    """How the predictions u_k (unconditional) and c_k of K graphs make up those of B samples (Eq. A, 7, 8).

    eps_b = sum_k base_bk u_k + s sum_k lift_bk (c_k - u_k)

    A graph counts by what its words add to the same graph without them. The base of several graphs is the mean of those
    that should happen, by their weights, so that one concept of weight 1 is plain guidance.
    """

    base: FloatArray
    """(B, K), rows sum to 1."""
    lift: FloatArray
    """(B, K)."""

    @staticmethod
    def plain(count: int) -> GuidanceWeights:
        """Guide each of several samples by its own graph."""
        identity = np.eye(count, dtype=np.float32)
        return GuidanceWeights(identity, identity)

    @staticmethod
    def composed(weights: CompositionWeights) -> GuidanceWeights:
        """Compose one sample of concepts, joint text and negated concepts, in this order."""
        latent, _, joint = weights.lambdas
        parts = ((latent, weights.concepts), (joint, weights.joint), (1.0, weights.negated))
        lift = np.array([[share * weight for share, part in parts for weight in part]], dtype=np.float32)
        wanted = np.maximum(lift, 0.0)
        base = wanted / wanted.sum() if wanted.any() else np.full_like(lift, 1.0 / lift.size)
        return GuidanceWeights(base, lift)


class ConcatSampler(LatentSampler):
    """The latent diffusion models of a bundle with released networks."""

    def sample(
        self,
        conditions: Conditions,
        weights: CompositionWeights | None,
        options: Sequence[GenerateOptions],
        on_step: OnStep | None = None,
        on_latent: OnLatent | None = None,
    ) -> FloatArray:
        """Sample latents of the finest level, (B, C, z); see `LatentSampler.sample`."""
        noise = self.initial_noise(options)
        halves = self.sample_halves(conditions, weights, options, noise, on_step, on_latent)
        return halves[-1][len(options) :]

    def sample_halves(
        self,
        conditions: Conditions,
        weights: CompositionWeights | None,
        options: Sequence[GenerateOptions],
        noise: Sequence[FloatArray],
        on_step: OnStep | None = None,
        on_latent: OnLatent | None = None,
    ) -> tuple[FloatArray, ...]:
        """Sample from given noise (B, C, z) of each level.

        Returns:
            Final latents (2B, C, z) of each level: the unconditional halves, then the conditional ones, which are the
            result.
        """
        count = len(options)
        tell = None if on_latent is None else lambda level, latents: on_latent(level, latents[count:])
        twice = [np.concatenate([latents, latents]) for latents in noise]
        make_predictor = partial(self.predictor, conditions, weights, options)
        levels = self.level_plans(options[0])
        return sample_hierarchy(levels, twice, make_predictor, self.schedule, on_step, tell)

    def predictor(
        self,
        conditions: Conditions,
        weights: CompositionWeights | None,
        options: Sequence[GenerateOptions],
        level: str,
        ddim: DdimCoefficients,
        coarse: FloatArray | None,
    ) -> PredictNoise:
        """Make the noise prediction of one level; condition and time tokens are computed here, once.

        Args:
            conditions: of K graphs, from `SlotEncoder.attend`.
            weights: how they compose one sample; None guides each of K samples by its own graph.
            options: of each sample.
            level: its name.
            ddim: of its run.
            coarse: (2B, C', z) latents of the level above, see the module; None at the coarsest.
        """
        if not isinstance(conditions, SlotConditions):
            raise TypeError("conditions of released networks come from SlotEncoder")
        guidance = GuidanceWeights.plain(len(options)) if weights is None else GuidanceWeights.composed(weights)
        spec, graphs = self.manifest.levels[level], len(conditions.nodes)
        seen = slots_seen(spec)
        inputs = {"nodes": np.concatenate([conditions.null_nodes, conditions.nodes])[:, :seen]}
        mask = (conditions.bias[:, :seen] >= 0).astype(np.float32)
        if coarse is not None:
            halves = coarse.reshape(2, -1, *coarse.shape[1:])
            # a composed sample has one latent for all of its graphs
            inputs["coarse"] = np.broadcast_to(halves, (2, graphs, *coarse.shape[1:])).reshape(-1, *coarse.shape[1:])
            mask = np.concatenate([np.ones((graphs, coarse.shape[1]), dtype=np.float32), mask], axis=1)
        (condition,) = run_model(self.sessions.context[level], ["condition"], inputs, "the context encoder")
        timestep = {"timestep": ddim.timesteps}
        (time,) = run_model(self.sessions.modulation[level], ["time"], timestep, "the time embedding")
        step = self.sessions.denoiser[level]
        scale = options[0].guidance[level]
        return ConcatPrediction(step, condition, np.concatenate([mask, mask]), time, guidance, scale)

    def validate_composition(self, lambdas: tuple[float, float, float], agd: tuple[float, float]) -> None:
        """Refuse what happens inside cross-attention; see `LatentSampler.validate_composition`.

        Raises:
            InvalidInputError: a semantic-aware term, or adaptive gradient descent.
        """
        if lambdas[1] or any(agd):
            what = "the semantic-aware term (EnergyMoGen, Eq. 9)" if lambdas[1] else "agd (EnergyMoGen, Eq. 3, 4)"
            raise InvalidInputError(
                f"{what} works inside cross-attention, and the denoisers of {self.manifest.name} "
                f"{self.manifest.version} have none: they read conditions and latent as one sequence; compose with "
                "method 'latent' (Eq. 7, 8), or with method 'fused' and lambdas like (0.5, 0, 0.5)"
            )


@dataclass(frozen=True)
class ConcatPrediction:
    """Guided or composed noise prediction of one level; a `PredictNoise` on [unconditional, conditional] rows."""

    step: onnxruntime.InferenceSession
    condition: FloatArray
    """(2K, S, d)."""
    mask: FloatArray
    """(2K, S)."""
    time: FloatArray
    """(steps, d)."""
    guidance: GuidanceWeights
    scale: float
    """Guidance scale s."""

    def __call__(self, latents: FloatArray, index: int) -> FloatArray:
        unconditional, conditional = self.predict(latents[len(latents) // 2 :], index)
        guided = _combine(self.guidance.base, unconditional)
        base = guided
        guided = guided + np.float32(self.scale) * _combine(self.guidance.lift, conditional - unconditional)
        # both halves follow guidance, and part at the last step alone
        is_last = index == len(self.time) - 1
        return np.concatenate([base if is_last else guided, guided])

    def predict(self, latents: FloatArray, index: int) -> tuple[FloatArray, FloatArray]:
        """Predict the noise of B samples (B, C, z) for all graphs: unconditional and conditional, (K, C, z) each."""
        rows = len(self.condition)
        shared = np.broadcast_to(latents, (rows // 2, *latents.shape[1:]))
        inputs = {
            "latent": np.concatenate([shared, shared]),
            "time": np.repeat(self.time[index : index + 1], rows, axis=0),
            "condition": self.condition,
            "mask": self.mask,
        }
        (noise,) = run_model(self.step, ["noise"], inputs, "the denoiser")
        return noise[: rows // 2], noise[rows // 2 :]


def _combine(weights: FloatArray, predictions: FloatArray) -> FloatArray:
    """Compute sum_k weights_bk predictions_k: (B, K), (K, C, z) -> (B, C, z)."""
    combined: FloatArray = np.tensordot(weights, predictions, axes=1).astype(np.float32)
    return combined
