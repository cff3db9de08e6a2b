"""Edits of clips, in-betweens and endless streams: what the calls of `MotionPipeline` make of constraints."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.bundle.sessions import run_model
from kinegraph.clip import Clip
from kinegraph.constrained_denoising import EncodedClip, Wanted
from kinegraph.constraints import Constraint, EndPose, Keyframe, StartPose, pose_frames
from kinegraph.denoising import LatentSampler
from kinegraph.errors import InvalidInputError
from kinegraph.frame_denoising import FrameSampler
from kinegraph.frame_inpainting import encode_frames
from kinegraph.keeping import check_keep
from kinegraph.motion.body_frame import BodyFrame
from kinegraph.motion.features import features_from_joints
from kinegraph.motion.resampling import resample
from kinegraph.motion.skeleton import start_at_origin
from kinegraph.options import LATENT
from kinegraph.validation import finite_number, short_repr

if TYPE_CHECKING:
    from kinegraph.pipeline import MotionPipeline


def check_edit(
    clip: object, keep: object, strength: object, wanted: Wanted, sampler: LatentSampler
) -> tuple[Wanted, float]:
    """Check an edit, and encode the clip that is edited.

    Args:
        clip: the one to edit.
        keep: see `keeping.check_keep`.
        strength: share of the steps of the finest level that are taken, above 0 to 1.
        wanted: further constraints, if any.
        sampler: of the bundle.

    Returns:
        What is wanted, and the seconds of the result.

    Raises:
        InvalidInputError: not a clip, nothing to keep or to change, a strength that is none, or a bundle without an
            encoder, which latent space needs.
    """
    if not isinstance(clip, Clip):
        raise InvalidInputError(
            f"an edit takes a Clip, not {short_repr(clip)}; read a file with kinegraph.formats.read"
        )
    share = finite_number(strength)
    if share is None or not 0 < share <= 1:
        raise InvalidInputError(f"strength must be above 0 and at most 1, not {short_repr(strength)}")
    manifest = sampler.manifest
    if sampler.space == LATENT and sampler.sessions.encoder is None:
        raise InvalidInputError(
            f"bundle {manifest.name} {manifest.version} has no encoder, which edits of clips need; take another "
            "one, or add the graph: python -m kinegraph_export.add_gradients"
        )
    joints = start_at_origin(clip.joints if clip.fps == manifest.fps else resample(clip.joints, clip.fps, manifest.fps))
    frames = len(joints)
    if not manifest.frames.min <= frames <= manifest.frames.max:
        shortest, longest = manifest.seconds_limits
        raise InvalidInputError(
            f"the clip has {frames / manifest.fps:g} s; this bundle edits clips of {shortest:g} to {longest:g} s"
        )
    kept = check_keep(keep, joints, manifest.fps)
    latent = encode_frames(joints, sampler) if isinstance(sampler, FrameSampler) else encode(joints, sampler)
    begin = EncodedClip(latent, share)
    return replace(wanted, kept=kept, begin=begin), frames / manifest.fps


def encode(joints: FloatArray, sampler: LatentSampler) -> FloatArray:
    """Encode joints (frames, 22, 3) to a latent (1, C, z) of the finest level."""
    manifest, session = sampler.manifest, sampler.sessions.encoder
    if session is None:
        raise InvalidInputError(f"bundle {manifest.name} {manifest.version} has no encoder")
    group = manifest.frames.per_token
    padded = -(-len(joints) // group) * group
    features = np.zeros((1, padded, len(manifest.features.mean)), dtype=np.float32)
    rows = features_from_joints(joints)
    features[0, : len(joints)] = (rows - np.array(manifest.features.mean)) / np.array(manifest.features.std)
    mask = np.zeros((1, padded), dtype=np.float32)
    mask[0, : len(joints)] = 1.0
    inputs = {"features": features, "frame_mask": mask}
    return run_model(session(), ["latent"], inputs, "the encoder")[0]


def between(start: Any, end: Any, seconds: float, fps: float, *, placed: bool) -> list[Constraint]:
    """Make the constraints of an in-between.

    Args:
        start, end: clips, or joints (22, 3) or (frames, 22, 3).
        seconds: of the clip.
        fps: of the bundle.
        placed: whether the end is where it is relative to the start; else it may be anywhere on the floor.

    Raises:
        InvalidInputError: see `constraints.StartPose`, `constraints.EndPose`.
    """
    first, last = (_as_frames(pose) for pose in (start, end))
    begin = StartPose(first)
    if not placed:
        return [begin, EndPose(last)]
    pose = EndPose(last)
    frames = pose.joints if pose.fps in (None, fps) else resample(pose.joints, pose.fps, fps)
    goal = BodyFrame.of(begin.joints[0]).to_body(frames[-1]).astype(np.float32)
    # the step into the end, wherever it is, and its place
    return [begin, pose, Keyframe(max(seconds - 1.0 / fps, 0.0), goal)]


def _as_frames(pose: Any) -> Any:
    """Make frames of a single pose (22, 3); leave all else to the constraint."""
    return pose[None] if isinstance(pose, np.ndarray) and pose.ndim == 2 else pose


def begin_in(frames: FloatArray, sampler: LatentSampler) -> Wanted:
    """Ask that a clip begins in the last frames (n, 22, 3) of a motion, wherever that has come to.

    Raises:
        InvalidInputError: see `constrained_denoising.Wanted.check`.
    """
    return Wanted.check([StartPose(start_at_origin(frames))], 1.0, True, False, sampler)


def stream_frames(
    pipe: MotionPipeline, texts: Iterable[Any], *, seconds: float | None, seed: int, options: Mapping[str, Any]
) -> Iterator[FloatArray]:
    """Yield the frames (22, 3) of one part after another, each from the last pose of the one before.

    Only the part that is shown is held. See `MotionPipeline.stream`.
    """
    fps = pipe.manifest.fps
    overlap = pose_frames(fps)
    shown: FloatArray | None = None  # the last frames, in the world
    for number, text in enumerate(texts):
        if shown is None:
            yield from (joints := pipe.generate(text, seconds=seconds, seed=seed, **options).joints)
        else:
            frame = BodyFrame.of(shown[0])
            start = StartPose(start_at_origin(shown))  # near the origin, however far the stream has come
            length = None if seconds is None else min(seconds + overlap / fps, pipe.manifest.seconds_limits[1])
            clip = pipe.generate(text, seconds=length, seed=seed + number, constraints=[start], **options)
            joints = frame.to_world(clip.joints).astype(np.float32)
            yield from joints[overlap:]  # the frames before are the last ones that were shown
        shown = joints[-overlap:]
