"""Edits of clips, in-betweens and endless streams: what the calls of `MotionPipeline` make of constraints."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kinegraph.arrays import DoubleArray, FloatArray
from kinegraph.bundle.sessions import run_model
from kinegraph.clip import Clip
from kinegraph.constrained_denoising import EncodedClip, Wanted
from kinegraph.constraints import POSE_SECONDS, Constraint, EndPose, Keyframe, StartPose
from kinegraph.denoising import LatentSampler
from kinegraph.errors import InvalidInputError
from kinegraph.keeping import check_keep
from kinegraph.motion.features import features_from_joints
from kinegraph.motion.quaternions import about_axis, rotate
from kinegraph.motion.resampling import resample
from kinegraph.motion.skeleton import HORIZONTAL, PELVIS, facing_angle, start_at_origin
from kinegraph.validation import finite_number, short_repr

if TYPE_CHECKING:
    from kinegraph.pipeline import MotionPipeline


def check_edit(clip: object, keep: object, strength: object, wanted: Wanted | None, sampler: LatentSampler) -> Wanted:
    """Check an edit, and encode the clip that is edited.

    Args:
        clip: the one to edit.
        keep: see `keeping.check_keep`.
        strength: share of the steps of the finest level that are taken, above 0 to 1.
        wanted: further constraints.
        sampler: of the bundle.

    Raises:
        InvalidInputError: not a clip, nothing to keep, a strength that is none, or a bundle without an encoder.
    """
    if not isinstance(clip, Clip):
        raise InvalidInputError(
            f"an edit takes a Clip, not {short_repr(clip)}; read a file with kinegraph.formats.read"
        )
    share = finite_number(strength)
    if share is None or not 0 < share <= 1:
        raise InvalidInputError(f"strength must be above 0 and at most 1, not {short_repr(strength)}")
    manifest = sampler.manifest
    if sampler.sessions.encoder is None:
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
    begin = EncodedClip(encode(joints, sampler), share)
    wanted = wanted or Wanted((), 1.0, True, False)
    return replace(wanted, kept=kept, begin=begin)


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
    origin = begin.joints[0].astype(np.float64)
    goal = EndPose(last).joints[-1].astype(np.float64)
    heading = float(facing_angle(begin.joints[:1])[0])
    target = rotate(about_axis(1, np.array(-heading)), goal - origin[PELVIS] * HORIZONTAL)
    return [begin, Keyframe(max(seconds - 1.0 / fps, 0.0), np.asarray(target))]


def _as_frames(pose: Any) -> Any:
    """Make frames of a single pose (22, 3); leave all else to the constraint."""
    return pose[None] if isinstance(pose, np.ndarray) and pose.ndim == 2 else pose


def stream_frames(
    pipe: MotionPipeline, texts: Iterable[Any], seed: int, seconds: float | None, options: dict[str, Any]
) -> Iterator[FloatArray]:
    """Yield the frames (22, 3) of one part after another, each from the last pose of the one before.

    Only the part that is shown is held. See `MotionPipeline.stream`.
    """
    place = _Place.origin()
    before: Clip | None = None
    fps = pipe.manifest.fps
    count = max(1, round(POSE_SECONDS * fps))
    for number, text in enumerate(texts):
        start: list[Constraint] = [] if before is None else [StartPose(before.joints[-count:])]
        length = seconds
        if before is not None and seconds is not None:
            length = min(seconds + count / fps, pipe.manifest.seconds_limits[1])
        clip = pipe.generate(text, seconds=length, seed=seed + number, constraints=start, **options)
        if before is None:
            yield from clip.joints
        else:
            place = place.after(before.joints[-count])
            yield from place.put(clip.joints[count:])  # the frames before are the last ones of the part before
        before = clip


class _Place:
    """Where a part of a stream starts in the world."""

    def __init__(self, spot: DoubleArray, heading: float) -> None:
        self.spot, self.heading = spot, heading

    @staticmethod
    def origin() -> _Place:
        """Start of the first part."""
        return _Place(np.zeros(3), 0.0)

    def after(self, pose: FloatArray) -> _Place:
        """Tell the place of the next part, which starts in a pose (22, 3) of this one."""
        spot = self.put(pose[None])[0, PELVIS].astype(np.float64) * HORIZONTAL
        heading = self.heading + float(facing_angle(pose[None])[0])
        return _Place(spot, (heading + np.pi) % (2 * np.pi) - np.pi)

    def put(self, joints: FloatArray) -> FloatArray:
        """Put joints (frames, 22, 3) of the part into the world."""
        turned = rotate(about_axis(1, np.array(self.heading)), joints.astype(np.float64))
        return np.asarray(turned + self.spot, dtype=np.float32)
