"""Timelines sampled in skeleton space: every interval is denoised on its own frames of one motion, all in one run.

EnergyMoGen, Eq. 11, and STMC's timelines (Petrovich et al., 2024). At every step each interval predicts the noise of
its own frames, guided and composed as any clip (`denoising`), and `diffusion.temporal` makes one prediction of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import FRAMES
from kinegraph.bundle.manifest import Manifest
from kinegraph.clip import Clip
from kinegraph.conditioning import ConditionEncoder, Conditions, GraphArrays, as_partial
from kinegraph.constrained_denoising import Wanted, told_clip
from kinegraph.decoding import MotionDecoder
from kinegraph.denoising import LatentSampler, sample_hierarchy
from kinegraph.diffusion.composition import CompositionWeights
from kinegraph.diffusion.sampling import DdimCoefficients, LevelPlan, OnStep, PredictNoise
from kinegraph.diffusion.temporal import (
    Span,
    claim_features,
    compose_over_time,
    count_claims,
    shared_spans,
    widen,
)
from kinegraph.errors import InvalidInputError
from kinegraph.frame_denoising import FrameSampler, part_of
from kinegraph.frame_inpainting import HeldFrames, HeldPrediction, Hold, read_held
from kinegraph.intervals import Interval
from kinegraph.keeping import PARTS
from kinegraph.motion.features import LAYOUT
from kinegraph.motion.known_features import columns_of_poses, columns_of_steps
from kinegraph.options import GenerateOptions
from kinegraph.validation import finite_number, short_repr

OVERLAP: Final = 0.8
"""Seconds that neighbours share by default: the shortest clip that models are trained on."""
MAX_OVERLAP: Final = 4.0
"""Longest one."""


@dataclass(frozen=True)
class SampledInterval:
    """An interval as it is sampled."""

    conditions: Conditions
    weights: CompositionWeights | None
    """How its rows compose (Eq. 7-10); None is plain guidance."""
    span: Span
    """Its groups of frames."""
    features: FloatArray
    """(z,) 1 on the features of a token that it is for."""


@dataclass(frozen=True)
class TimelinePrediction:
    """Prediction of the noise of a whole timeline, a `PredictNoise` of one sample."""

    spans: tuple[Span, ...]
    claims: tuple[FloatArray, ...]
    """(n_i, z) of `claim_features`."""
    predictors: tuple[PredictNoise, ...]
    """Of each interval, guided and composed."""
    shared: tuple[tuple[Span, Span, PredictNoise], ...]
    """Runs of tokens that need M_0, the span that it is predicted on, and its predictor."""

    def __call__(self, latents: FloatArray, index: int) -> FloatArray:
        predictions = [
            predict(latents[:, span.tokens], index)[0]
            for span, predict in zip(self.spans, self.predictors, strict=True)
        ]
        unconditional = np.zeros_like(latents[0])
        for run, seen, predict in self.shared:
            inside = slice(run.start - seen.start, run.stop - seen.start)
            unconditional[run.tokens] = predict(latents[:, seen.tokens], index)[0, inside]
        return compose_over_time(self.spans, self.claims, predictions, unconditional)[None]


def sample_timeline(
    sampler: FrameSampler,
    intervals: Sequence[SampledInterval],
    options: GenerateOptions,
    on_step: OnStep | None = None,
    hold: Hold | None = None,
) -> FloatArray:
    """Sample the groups of frames of a timeline, (1, C, z), from the noise of one seed.

    A timeline of one interval is what `FrameSampler.sample` makes of it. What is known is held in the composed
    prediction, as `frame_inpainting` holds it in that of one text.

    Args:
        sampler: of the bundle.
        intervals: that cover the timeline.
        options: seed, steps and guidance of all; its length counts for nothing.
        on_step: see `sample_hierarchy`.
        hold: what is known of the whole; None is nothing.

    Raises:
        Cancelled, NonFiniteError: see `sample_hierarchy`.
    """
    length = max(each.span.stop for each in intervals)
    plan = LevelPlan(FRAMES, length, sampler.part.level.latent_width, options.steps[FRAMES])
    whole = replace(options, frames=length * sampler.part.per_token)

    def make_predictor(level: str, ddim: DdimCoefficients, coarse: FloatArray | None) -> PredictNoise:
        predict = predict_timeline(sampler, intervals, options, length, ddim)
        if hold is None:
            return predict
        return HeldPrediction(predict, hold, sampler.schedule.alphas_cumprod[ddim.timesteps])

    latents = sample_hierarchy([plan], sampler.initial_noise([whole]), make_predictor, sampler.schedule, on_step)[-1]
    return latents if hold is None else hold(latents)


def predict_timeline(
    sampler: FrameSampler,
    intervals: Sequence[SampledInterval],
    options: GenerateOptions,
    length: int,
    ddim: DdimCoefficients,
) -> TimelinePrediction:
    """Bind everything that is constant over the steps of a timeline of `length` tokens; see `sample_timeline`."""
    spans = tuple(each.span for each in intervals)
    claims = tuple(claim_features(length, spans, [each.features for each in intervals]))
    per_token, least = sampler.part.per_token, sampler.part.token_count(sampler.manifest.frames.min)

    def of_interval(each: SampledInterval) -> PredictNoise:
        own = replace(options, frames=len(each.span) * per_token)
        return sampler.predictor(each.conditions, each.weights, [own], FRAMES, ddim, None)

    shared = []
    for run in shared_spans(count_claims(length, spans, claims)):
        seen = widen(run, least, length)
        shared.append((run, seen, sampler.predict_nothing(intervals[0].conditions, len(seen), ddim)))
    return TimelinePrediction(spans, claims, tuple(of_interval(each) for each in intervals), tuple(shared))


def interval_spans(
    times: Sequence[tuple[float, float]], overlap: float, manifest: Manifest
) -> tuple[tuple[Span, ...], int]:
    """Convert intervals in seconds to spans of tokens in which neighbours overlap.

    Each interval gets half of `overlap` at both ends, as in STMC, within the whole.

    Args:
        times: start and end of each interval, seconds.
        overlap: seconds.
        manifest: of the bundle.

    Returns:
        Spans, and the frames of the whole.

    Raises:
        InvalidInputError: an interval is shorter or longer than what the model was trained on.
    """
    part, fps, limits = part_of(manifest), manifest.fps, manifest.frames
    frames = round(max(end for _, end in times) * fps)
    length = part.token_count(frames)
    half = overlap / 2
    spans = []
    for start, end in times:
        first = max(round((start - half) * fps / part.per_token), 0) if start > 0 else 0
        last = min(round((end + half) * fps / part.per_token), length) if round(end * fps) < frames else length
        span = Span(first, max(last, first))
        if not limits.min <= len(span) * part.per_token <= -(-limits.max // part.per_token) * part.per_token:
            shortest, longest = manifest.seconds_limits
            taken = len(span) * part.per_token / fps
            raise InvalidInputError(
                f"the interval from {start:g} to {end:g} s takes {taken:g} s with its overlaps; "
                f"this bundle makes {shortest:g} to {longest:g} s at a time"
            )
        spans.append(span)
    return tuple(spans), frames


def features_of_parts(parts: Sequence[str], manifest: Manifest) -> FloatArray:
    """Mark the features of a token that belong to parts of the body, (z,); no parts are the whole body.

    The path of the body and its height belong to the pelvis, and so to the legs; contacts belong to the feet.

    Raises:
        InvalidInputError: parts of the body in a bundle of another feature layout than joints-137.
    """
    per_token = part_of(manifest).per_token
    if not parts:
        return np.ones(per_token * len(manifest.features.mean), dtype=np.float32)
    if manifest.features.layout != LAYOUT:
        raise InvalidInputError(
            f"parts of the body need features of the layout joints-137, not {manifest.features.layout}"
        )
    joints = {joint for part in parts for joint in PARTS[part]}
    row = (columns_of_poses(joints) | columns_of_steps(joints)).astype(np.float32)
    return np.tile(row, per_token)


@dataclass(frozen=True)
class EncodedInterval:
    """An interval with its encoded text."""

    features: Sequence[GraphArrays]
    """Of the graphs that it is composed of."""
    weights: CompositionWeights | None
    """How they compose (Eq. 7-10); None is plain guidance."""
    interval: Interval


def make_timeline(
    encoder: ConditionEncoder,
    sampler: LatentSampler,
    decoder: MotionDecoder,
    encoded: Sequence[EncodedInterval],
    options: GenerateOptions,
    overlap: float | None,
    on_step: OnStep | None = None,
    wanted: Wanted | None = None,
) -> Clip:
    """Make the clip of a timeline.

    A text for parts of the body alone is told to name a part of what happens (`conditioning.as_partial`).

    Args:
        encoder, sampler, decoder: of a bundle with skeleton space.
        encoded: the intervals.
        options: of all of them; the length counts for nothing.
        overlap: seconds that neighbours share; None is `OVERLAP`.
        on_step: see `sample_timeline`.
        wanted: what else the whole has to do, see `constrained_denoising.Wanted.check`.

    Raises:
        InvalidInputError: see `interval_spans`, `features_of_parts`, `Wanted.for_clip`, `told_clip`; or an overlap that
            is none.
        Cancelled, NonFiniteError: see `sample_timeline`.
    """
    assert isinstance(sampler, FrameSampler)
    manifest = sampler.manifest
    shared = OVERLAP if overlap is None else finite_number(overlap)
    if shared is None or not 0 <= shared <= MAX_OVERLAP:
        raise InvalidInputError(f"overlap must be 0 to {MAX_OVERLAP:g} seconds, not {short_repr(overlap)}")
    times = [(each.interval.start, each.interval.end) for each in encoded]
    spans, frames = interval_spans(times, shared, manifest)
    intervals = []
    for each, span in zip(encoded, spans, strict=True):
        parts = each.interval.parts
        graphs = [as_partial(graph) for graph in each.features] if parts else each.features
        intervals.append(
            SampledInterval(encoder.attend(graphs), each.weights, span, features_of_parts(parts, manifest))
        )
    whole = replace(options, frames=frames, seconds=frames / manifest.fps)
    fitting = None if wanted is None else wanted.for_clip(frames, manifest.fps)
    if fitting is None or not fitting.acts:
        latents = sample_timeline(sampler, intervals, whole, on_step)
        clip = decoder.decode(latents, [whole], [""])[0]
        return clip if fitting is None else told_clip(clip.joints, fitting, whole, "", manifest)
    hold = HeldFrames.wanted(fitting, frames, sampler.whole_frames(frames), manifest)
    latents = sample_timeline(sampler, intervals, whole, on_step, hold)
    return read_held(decoder, latents, hold.known, fitting, whole, "", manifest)
