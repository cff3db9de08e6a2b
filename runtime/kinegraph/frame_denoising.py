"""Second and third stage in skeleton space: the motion features themselves are sampled (EnergyMoGen, appendix A and B).

    x_t                                 latents (B, C, z): C groups of frames, each the features of its frames
    x_0, predicted clean frames         `FramePredictor`, a run of the bundle's frames_denoiser
    eps = (x_t - sqrt(a) x_0) / sqrt(1 - a)
    Eq. A, 3, 4, 7-10, DDIM             as in `denoising`: the coefficients of a composition sum to 1, so that composing
                                        noise is composing clean frames
    joints                              the motion that positions and velocities both say (`motion.fusion`)

`FrameSampler` and `FrameDecoder` have the interfaces of `LatentSampler` and `MotionDecoder`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import ClassVar

import numpy as np

from kinegraph.arrays import DoubleArray, FloatArray, IntArray
from kinegraph.bundle.contract import FRAMES
from kinegraph.bundle.frames_part import FramesPart
from kinegraph.bundle.manifest import Manifest
from kinegraph.bundle.sessions import run_model
from kinegraph.conditioning import Conditions, drop_all, for_level
from kinegraph.decoding import MotionDecoder, joints_of_features
from kinegraph.denoising import (
    LatentSampler,
    NoisePredictor,
    OnLatent,
    adaln_modulation,
    bind_step_inputs,
)
from kinegraph.diffusion.composition import AttentionRouting, CompositionWeights
from kinegraph.diffusion.sampling import (
    DdimCoefficients,
    LevelPlan,
    NoiseSchedule,
    OnStep,
    PredictNoise,
    subrange_progress,
)
from kinegraph.errors import InvalidInputError
from kinegraph.motion.features import LAYOUT
from kinegraph.motion.fusion import certainty_of, fused_joints
from kinegraph.motion.known_features import KnownFeatures
from kinegraph.motion.postprocess import enforce_bone_lengths
from kinegraph.options import GenerateOptions


@dataclass(frozen=True)
class FramePredictor(NoisePredictor):
    """A denoiser that predicts clean frames, as a predictor of the noise."""

    alphas: DoubleArray
    """(K,) alpha_bar of the steps of the run."""

    def __call__(self, latents: FloatArray, index: int) -> FloatArray:
        """Predict the noise of R rows of frames (R, C, z) at step `index`."""
        inputs = {"latent": latents, "modulation": self.modulation[index], **self.constant}
        (clean,) = run_model(self.denoiser, ["clean"], inputs, "the skeleton-space denoiser")
        return noise_of(latents, clean, float(self.alphas[index]))


def noise_of(noisy: FloatArray, clean: FloatArray, alpha: float) -> FloatArray:
    """Compute the noise eps in x_t = sqrt(a) x_0 + sqrt(1 - a) eps; x_t and x_0 have equal shapes, a is alpha_bar."""
    return np.asarray((noisy - math.sqrt(alpha) * clean) / math.sqrt(1.0 - alpha), dtype=np.float32)


def clean_of(noisy: FloatArray, noise: FloatArray, alpha: float) -> FloatArray:
    """Compute the clean frames x_0 in x_t = sqrt(a) x_0 + sqrt(1 - a) eps; the reverse of `noise_of`."""
    return np.asarray((noisy - math.sqrt(1.0 - alpha) * noise) / math.sqrt(alpha), dtype=np.float32)


@dataclass(frozen=True)
class FrameSampler(LatentSampler):
    """The skeleton-space diffusion model of a bundle that has one."""

    space: ClassVar[str] = FRAMES

    @property
    def part(self) -> FramesPart:
        """What the manifest says of skeleton space."""
        return part_of(self.manifest)

    @property
    def schedule(self) -> NoiseSchedule:
        """Schedule that skeleton space is sampled with."""
        return self.part.schedule(self.manifest.schedule.noise)

    def sample(
        self,
        conditions: Conditions,
        weights: CompositionWeights | None,
        options: Sequence[GenerateOptions],
        on_step: OnStep | None = None,
        on_latent: OnLatent | None = None,
    ) -> FloatArray:
        """Sample groups of frames (B, C, z), each sample from the noise of its own seed.

        Clips of as many groups share a run. C is that of the longest clip; shorter ones end in zeros.

        Args:
            conditions, weights, options, on_step: see `LatentSampler.sample`.
            on_latent: never called: there is no coarser level.

        Raises:
            Cancelled, NonFiniteError: see `denoising.sample_hierarchy`.
        """
        # The network knows whole groups alone, in training as here.
        whole = [replace(sample, frames=self.whole_frames(sample.frames)) for sample in options]
        lengths = sorted({sample.frames for sample in whole})
        if len(lengths) == 1:
            return super().sample(conditions, weights, whole, on_step)
        longest = self.part.token_count(lengths[-1])
        found = np.zeros((len(whole), longest, self.part.level.latent_width), dtype=np.float32)
        for index, length in enumerate(lengths):
            rows = [row for row, sample in enumerate(whole) if sample.frames == length]
            of_length = conditions.map(itemgetter(rows))
            progress = subrange_progress(on_step, index, len(lengths))
            latents = super().sample(of_length, weights, [whole[row] for row in rows], progress)
            found[rows, : latents.shape[1]] = latents
        return found

    def whole_frames(self, frames: int) -> int:
        """Round frames up to whole groups."""
        return self.part.token_count(frames) * self.part.per_token

    def predict_nothing(self, conditions: Conditions, tokens: int, ddim: DdimCoefficients) -> PredictNoise:
        """Bind the unconditional prediction of `tokens` groups of frames: M_3 of EnergyMoGen, Eq. 11.

        Args:
            conditions: of any text, for their sizes.
            tokens: C.
            ddim: of the run.
        """
        blank = drop_all(for_level(conditions.map(lambda part: part[:1]), self.kinds_seen(FRAMES)))
        frames = np.array([tokens * self.part.per_token])
        return self._bind(FRAMES, blank, None, AttentionRouting.identity(1), frames, ddim)

    def kinds_seen(self, level: str) -> tuple[str, ...]:
        """Return the kinds of context tokens that the denoiser attends to."""
        return self.part.level.nodes

    def level_plans(self, options: GenerateOptions) -> list[LevelPlan]:
        """List the only level, with the groups of frames and the steps of a call."""
        tokens = self.part.token_count(options.frames)
        return [LevelPlan(FRAMES, tokens, self.part.level.latent_width, options.steps[FRAMES])]

    def validate_composition(self, lambdas: tuple[float, float, float], agd: tuple[float, float]) -> None:
        """Accept all terms: skeleton space comes with adaptive gradient descent."""

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
        sessions, variant = self.sessions.frames, "" if gamma is None else "_agd"
        modulation = adaln_modulation(sessions[f"{FRAMES}_modulation"](), ddim.timesteps, frames)
        context, denoiser = (sessions[f"{FRAMES}_{graph}{variant}"]() for graph in ("context", "denoiser"))
        tokens = self.part.token_count(int(frames[0]))
        bound = bind_step_inputs(context, denoiser, contexts, coarse, routing, modulation, gamma, tokens)
        alphas = self.schedule.alphas_cumprod[ddim.timesteps]
        return FramePredictor(bound.denoiser, bound.constant, bound.modulation, alphas)


@dataclass(frozen=True)
class FrameDecoder(MotionDecoder):
    """Groups of frames to clips: no network is left to run."""

    def joints(self, latents: FloatArray, frames: Sequence[int], level: str) -> list[FloatArray]:
        """Read the joints of every sample off its features; see `decoding.decode_joints`."""
        features = ungroup(latents, self.manifest)
        return [self._read(rows[:count]) for rows, count in zip(features, frames, strict=True)]

    def joints_with_known(self, latents: FloatArray, frames: int, known: KnownFeatures) -> FloatArray:
        """Read the joints (frames, 22, 3) of one sample (1, C, z) of which something is known, and stays as it is."""
        (features,) = ungroup(latents, self.manifest)
        return self._read(features[:frames], certainty_of(known)[:frames])

    def _read(self, features: FloatArray, certainty: DoubleArray | None = None) -> FloatArray:
        if self.manifest.features.layout != LAYOUT:
            return joints_of_features([features], self.manifest, self.bones)[0]
        return enforce_bone_lengths(fused_joints(features, certainty), self.bones)


def ungroup(latents: FloatArray, manifest: Manifest) -> FloatArray:
    """Convert groups of frames (B, C, z) to features (B, C per_token, F), not normalised."""
    mean, std = (np.array(part, dtype=np.float32) for part in (manifest.features.mean, manifest.features.std))
    normalised = latents.reshape(len(latents), -1, len(mean)) / np.float32(part_of(manifest).scale)
    features: FloatArray = normalised * std + mean
    return features


def group(features: FloatArray, manifest: Manifest) -> FloatArray:
    """Convert features (B, frames, F), whole groups of frames, to latents (B, C, z); the reverse of `ungroup`."""
    part = part_of(manifest)
    mean, std = (np.array(values, dtype=np.float32) for values in (manifest.features.mean, manifest.features.std))
    normalised = (features - mean) / std * np.float32(part.scale)
    return normalised.reshape(len(features), -1, part.level.latent_width)


def part_of(manifest: Manifest) -> FramesPart:
    """Return what a manifest says of skeleton space.

    Raises:
        InvalidInputError: the bundle has none; `options.resolve_options` says what to do.
    """
    if manifest.frames_part is None:
        raise InvalidInputError(f"bundle {manifest.name} {manifest.version} has no skeleton space")
    return manifest.frames_part
