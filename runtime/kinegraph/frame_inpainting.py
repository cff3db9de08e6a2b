"""Known frames, joints and places in skeleton space: held at every step, so that the network makes the rest to them.

MDM edits motions so (Tevet et al., 2023, section 3, "Editing"). At each step, with x_0 the guided and composed
prediction of the clean frames:

    x_0 <- known where it is known, x_0 elsewhere        eps = (x_t - sqrt(a) x_0) / sqrt(1 - a)

What is known are features (`motion.known_features`): poses and steps, each in the frame of its own body. Places on the
floor are sums of steps, and held as such. Where a joint has to be, and where a loop ends, depends on all of the motion:
there x_0 is read as joints, which are brought there (`ReachedFrames`). Bones of one length and places come last, in the
joints, as under `constrained_denoising`; the clip tells what it misses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import DoubleArray, FloatArray
from kinegraph.bundle.manifest import Manifest
from kinegraph.clip import Clip
from kinegraph.conditioning import Conditions
from kinegraph.constrained_denoising import BegunPrediction, EncodedClip, Wanted, corrected, told_clip
from kinegraph.constraints import Constraint, EndPose, JointTarget, Keyframe, Loop, Path, StartPose, Waypoint
from kinegraph.decoding import MotionDecoder
from kinegraph.denoising import LatentSampler, sample_hierarchy
from kinegraph.diffusion.composition import CompositionWeights
from kinegraph.diffusion.sampling import DdimCoefficients, OnStep, PredictNoise
from kinegraph.feasibility import frame_of
from kinegraph.frame_denoising import FrameDecoder, FrameSampler, clean_of, group, noise_of, ungroup
from kinegraph.keeping import PARTS, Kept
from kinegraph.motion.features import CONTACTS, features_from_joints, joints_from_features
from kinegraph.motion.known_features import Anchor, KnownFeatures, lead_root
from kinegraph.motion.postprocess import lock_feet
from kinegraph.motion.reaching import Pins, reach, smooth_field
from kinegraph.motion.skeleton import PELVIS, bone_lengths
from kinegraph.options import GenerateOptions

REACHED: Final = (JointTarget, Loop)
"""Constraints whose places depend on the whole motion. The others say features: whole poses, and places of the root."""
PATH_STEP: Final = 0.25
"""Seconds between the places of a path that are held; between them a body sways as it walks."""
TURN_SECONDS: Final = 1.0
"""Time over which the direction of a path is averaged, and in which a body turns into it at first."""

Hold = Callable[[FloatArray], FloatArray]
"""Clean frames (1, C, z) -> the same with what is known in its place."""


def encode_frames(joints: FloatArray, sampler: FrameSampler) -> FloatArray:
    """Convert a clip (frames, 22, 3) to whole groups of frames (1, C, z), the last frame repeated."""
    rows = features_from_joints(joints)
    missing = sampler.whole_frames(len(rows)) - len(rows)
    return group(np.pad(rows, ((0, missing), (0, 0)), mode="edge")[None], sampler.manifest)


def known_of(wanted: Wanted, frames: int, whole: int, fps: float) -> KnownFeatures:
    """Collect what is known of a clip; poses that are asked for go before what is kept.

    Args:
        wanted: of the clip, checked for its length.
        frames: of the clip.
        whole: frames of its groups.
        fps: frames per second.
    """
    known = KnownFeatures.nothing(whole)
    if wanted.kept is not None:
        known = _with_kept(known, wanted.kept)
    for constraint in wanted.constraints:
        if constraint.weight > 0:
            known = _with_constraint(known, constraint, frames, fps)
    return known


def _with_kept(known: KnownFeatures, kept: Kept) -> KnownFeatures:
    """Know what an edit keeps: legs with the way of the body, arms in its frame, spans where they are."""
    for part in kept.parts:
        known = known.with_poses(kept.joints, 0, PARTS[part], moving=PELVIS in PARTS[part])
    for start, end in kept.spans:
        span = kept.joints[start:end]
        known = known.with_poses(span, start).with_anchor(Anchor.of(span[0], start))
    return known


def _with_constraint(known: KnownFeatures, constraint: Constraint, frames: int, fps: float) -> KnownFeatures:
    match constraint:
        case Path():
            for anchor in anchors_of(constraint, frames, fps):
                known = known.with_anchor(anchor)
        case Waypoint():
            heading = None if constraint.heading is None else float(np.radians(constraint.heading))
            frame = frame_of(constraint.seconds, frames, fps)
            return known.with_anchor(Anchor(frame, constraint.position, heading))
        case StartPose():
            return known.with_poses(constraint.frames(fps), 0)
        case EndPose():
            poses = constraint.frames(fps)
            return known.with_poses(poses, frames - len(poses))
        case Keyframe():
            frame = frame_of(constraint.seconds, frames, fps)
            known = known.with_poses(constraint.joints[None], frame)
            return known if constraint.anywhere else known.with_anchor(Anchor.of(constraint.joints, frame))
    return known


def anchors_of(path: Path, frames: int, fps: float) -> list[Anchor]:
    """List where the root of a clip of so many frames comes by on a path: every `PATH_STEP`, and at its end."""
    moments, duration = np.arange(frames) / fps, (frames - 1) / fps
    covered = np.flatnonzero(path.covers(moments, duration))
    if not len(covered):
        return []
    every = max(round(PATH_STEP * fps), 1)
    chosen = np.unique(np.append(covered[::every], covered[-1]))
    positions, headings = path.positions(moments, duration)[chosen], _headings_of(path, moments, duration, fps)
    faces = [None] * len(chosen) if headings is None else [float(angle) for angle in headings[chosen]]
    return [
        Anchor(int(frame), (float(x), float(z)), face)
        for frame, (x, z), face in zip(chosen, positions, faces, strict=True)
    ]


def _headings_of(path: Path, moments: DoubleArray, duration: float, fps: float) -> DoubleArray | None:
    """Return where a body faces on a path at some moments, radians; None on a path that goes nowhere.

    A path without headings is faced along, in turns that a person can make. Free headings would drift: places are held,
    and nothing pulls a body round to where it goes.
    """
    if path.heading is not None:
        return path.headings(moments, duration)
    along = replace(path, heading="along").headings(moments, duration)
    if along is None:
        return None
    half = max(round(TURN_SECONDS * fps) // 2, 1)
    smooth = np.convolve(np.pad(along, half, mode="edge"), np.full(2 * half + 1, 1.0 / (2 * half + 1)), "valid")
    return np.asarray(smooth * np.minimum(moments / TURN_SECONDS, 1.0))


@dataclass(frozen=True)
class ReachedFrames:
    """Clean frames of a clip in which joints are brought to where they have to be; a `Hold`.

    Joints reach by `reaching.MAX_REACH`, and the body goes the rest of the way; what the network then makes of the rest
    of the motion is nearer at the next step.
    """

    wanted: Wanted
    """Constraints of `REACHED` alone."""
    frames: int
    """Of the clip."""
    manifest: Manifest

    def __call__(self, clean: FloatArray) -> FloatArray:
        features = ungroup(clean, self.manifest)[0]
        joints = joints_from_features(features[: self.frames])
        fps = self.manifest.fps
        pins = self.wanted.pins(joints, fps)
        lengths = np.median(bone_lengths(joints), axis=0)
        moved = reach(_walked_nearer(joints, pins, fps), pins, lengths, fps, foot_fix=False)
        change = features_from_joints(moved) - features_from_joints(joints)
        change[:, CONTACTS] = 0.0
        features[: self.frames] += change
        return group(features[None], self.manifest)


def _walked_nearer(joints: FloatArray, pins: Pins, fps: float) -> FloatArray:
    """Move a body (frames, 22, 3) over the floor by what is further off than joints reach, smoothly from its start."""
    far = np.where(pins.wanted, pins.target - joints, 0.0) - pins.missed(joints)
    far[:, PELVIS] = 0.0  # which `reach` leads itself
    walked = np.zeros((len(joints), 3))
    for axis in (0, 2):
        furthest = np.take_along_axis(far[..., axis], np.abs(far[..., axis]).argmax(axis=1)[:, None], axis=1)
        at = furthest[:, 0] != 0.0
        if at.any():
            at[0] = True
            walked[:, axis] = smooth_field(furthest, at, fps)[:, 0]
    return np.asarray(joints + walked[:, None], dtype=np.float32)


@dataclass(frozen=True)
class HeldFrames:
    """What is known of the clean frames of a clip, as the network has them; a `Hold`."""

    known: KnownFeatures
    manifest: Manifest
    tokens: FloatArray
    """(1, C, z) of what is known."""
    mask: NDArray[np.bool_]
    """(1, C, z) where it is."""
    reached: ReachedFrames | None = None
    """What joints have to reach besides; what is known goes before it."""

    @classmethod
    def of(cls, known: KnownFeatures, manifest: Manifest, reached: ReachedFrames | None = None) -> HeldFrames:
        """Group and normalise what is known."""
        tokens = group(known.values[None], manifest)
        return cls(known, manifest, tokens, known.known.reshape(tokens.shape), reached)

    @classmethod
    def wanted(cls, wanted: Wanted, frames: int, whole: int, manifest: Manifest) -> HeldFrames:
        """Hold all that is wanted of a clip; arguments as in `known_of`."""
        reached = tuple(each for each in wanted.constraints if isinstance(each, REACHED) and each.weight > 0)
        reaching = ReachedFrames(replace(wanted, constraints=reached, kept=None), frames, manifest) if reached else None
        return cls.of(known_of(wanted, frames, whole, manifest.fps), manifest, reaching)

    def __call__(self, clean: FloatArray) -> FloatArray:
        """Put what is known into its place, and lead the root to where it has to come by."""
        if self.reached is not None:
            clean = self.reached(clean)
        held = np.where(self.mask, self.tokens, clean)
        if not self.known.anchors:
            return held
        features = ungroup(held, self.manifest)[0]
        led = lead_root(features, self.known.free_steps, self.known.anchors).astype(np.float32)
        return np.where(self.mask, self.tokens, group(led[None], self.manifest))


@dataclass(frozen=True)
class HeldPrediction:
    """A prediction of the noise in whose clean frames something is held; a `PredictNoise`."""

    predict: PredictNoise
    hold: Hold
    alphas: DoubleArray
    """(K,) alpha_bar of the steps of the run."""

    def __call__(self, latents: FloatArray, index: int) -> FloatArray:
        alpha = float(self.alphas[index])
        clean = clean_of(latents, self.predict(latents, index), alpha)
        return noise_of(latents, self.hold(clean), alpha)


def sample_known(
    sampler: FrameSampler,
    conditions: Conditions,
    weights: CompositionWeights | None,
    options: GenerateOptions,
    hold: Hold,
    begin: EncodedClip | None = None,
    on_step: OnStep | None = None,
) -> FloatArray:
    """Sample groups of frames (1, C, z) in which something is held.

    What is known is put into its place once more at the end, for rounding.

    Args:
        sampler, conditions, weights: as in `LatentSampler.sample`; one sample.
        options: of the clip.
        hold: what is known.
        begin: the clip at which an edit begins, see `EncodedClip`.
        on_step: see `sample_hierarchy`.

    Raises:
        Cancelled, NonFiniteError: see `sample_hierarchy`.
    """
    whole = replace(options, frames=sampler.whole_frames(options.frames))
    noise, alpha_bar = sampler.initial_noise([whole]), sampler.schedule.alphas_cumprod

    def make_predictor(level: str, ddim: DdimCoefficients, coarse: FloatArray | None) -> PredictNoise:
        predict = sampler.predictor(conditions, weights, [whole], level, ddim, coarse)
        alphas = alpha_bar[ddim.timesteps]
        held = HeldPrediction(predict, hold, alphas)
        if begin is None:
            return held
        first = begin.first_step(len(alphas))
        return BegunPrediction(held, ddim, begin.noised(alphas[first], noise[-1]), first)

    latents = sample_hierarchy(sampler.level_plans(whole), noise, make_predictor, sampler.schedule, on_step)[-1]
    return hold(latents)


def sample_held(
    sampler: LatentSampler,
    decoder: MotionDecoder,
    conditions: Conditions,
    weights: CompositionWeights | None,
    options: GenerateOptions,
    caption: str,
    wanted: Wanted,
    on_step: OnStep | None = None,
) -> Clip:
    """Sample, read and correct one clip in which poses and what an edit keeps are held.

    Args:
        sampler, decoder: of skeleton space.
        conditions, weights, options, caption, wanted: as in `constrained_denoising.sample_constrained`. A weight above
            0 holds whole; 0 is the clip without it.
        on_step: called after every step.

    Raises:
        Cancelled, NonFiniteError: see `sample_known`.
        InvalidInputError: with `strict`, something was missed by more than `constrained_denoising.MISSED`.
    """
    assert isinstance(sampler, FrameSampler)
    manifest, frames = sampler.manifest, options.frames
    if not wanted.acts:
        latents = sampler.sample(conditions, weights, [options], on_step)
        joints = decoder.decode(latents, [options], [caption])[0].joints
        return told_clip(joints, wanted, options, caption, manifest)
    hold = HeldFrames.wanted(wanted, frames, sampler.whole_frames(frames), manifest)
    latents = sample_known(sampler, conditions, weights, options, hold, wanted.begin, on_step)
    return read_held(decoder, latents, hold.known, wanted, options, caption, manifest)


def read_held(
    decoder: MotionDecoder,
    latents: FloatArray,
    known: KnownFeatures,
    wanted: Wanted,
    options: GenerateOptions,
    caption: str,
    manifest: Manifest,
) -> Clip:
    """Read the clip of latents (1, C, z) in which something was held, and correct it; see `sample_held`."""
    assert isinstance(decoder, FrameDecoder)
    joints = decoder.joints_with_known(latents, options.frames, known)
    return told_clip(nearer(joints, wanted, options, manifest.fps), wanted, options, caption, manifest)


def nearer(joints: FloatArray, wanted: Wanted, options: GenerateOptions, fps: float) -> FloatArray:
    """Correct joints (frames, 22, 3) towards what is wanted, unless that leads away from it.

    What is held is near already; and where a pose has other bones, no correction puts all joints into their places.
    """
    held = lock_feet(joints, fps) if options.foot_fix else joints
    if not wanted.fix:
        return held
    mended = corrected(joints, wanted, fps, foot_fix=options.foot_fix)
    return min((mended, held), key=lambda each: sum(miss.metres for miss in wanted.misses(each, fps)))
