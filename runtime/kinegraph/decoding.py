"""From latents to clips: decoder, features to joints, bone lengths, size of turns, foot locking."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import onnxruntime

from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import LEVELS
from kinegraph.bundle.manifest import Manifest
from kinegraph.bundle.sessions import Sessions, run_model
from kinegraph.clip import Clip
from kinegraph.motion.features import joints_from_features
from kinegraph.motion.humanml3d import joints_from_humanml3d
from kinegraph.motion.kit_ml import joints_from_kit
from kinegraph.motion.postprocess import enforce_bone_lengths, lock_feet
from kinegraph.motion.turning import hold_back_turn, turn_by, turned_to
from kinegraph.options import GenerateOptions

_JOINTS_FROM: Final[Mapping[str, Callable[[FloatArray], FloatArray]]] = {
    "joints-137": joints_from_features,
    "humanml3d-263": joints_from_humanml3d,
    "kit-251": joints_from_kit,
}
NEAR_TURN: Final = 0.1
"""Share of a turn by which it may differ from what is said without a note."""


@dataclass(frozen=True)
class MotionDecoder:
    """The decoders of a bundle, and the body whose bones it knows."""

    sessions: Sessions
    manifest: Manifest
    bones: FloatArray | None
    """(21,) metres, see `decode_joints`."""

    def decode(
        self,
        latents: FloatArray,
        options: Sequence[GenerateOptions],
        captions: Sequence[str],
        level: str = LEVELS[-1],
    ) -> list[Clip]:
        """Decode latents (B, C, z) of a level into B clips; feet are locked where the options want it.

        Raises:
            ModelError, NonFiniteError: see `bundle.sessions.run_model`.
        """
        frames, fps = [sample.frames for sample in options], self.manifest.fps
        motions = self.joints(latents, frames, level)
        bundle = f"{self.manifest.name} {self.manifest.version}"
        clips = []
        for joints, sample, caption in zip(motions, options, captions, strict=True):
            turned = turn_as_said(joints, fps, sample)
            held = lock_feet(turned, fps) if sample.foot_fix else turned
            clips.append(Clip(held, fps, sample.seed, caption, bundle, notes=tell_turn(turned, sample)))
        return clips

    def joints(self, latents: FloatArray, frames: Sequence[int], level: str) -> list[FloatArray]:
        """Decode latents of a level into the joints of every sample, see `decode_joints`."""
        return decode_joints(self.sessions.decoder_of(level), self.manifest, self.bones, latents, frames)


def turn_as_said(joints: FloatArray, fps: float, options: GenerateOptions) -> FloatArray:
    """Turn a motion as far as its sentence says.

    Networks turn to the side that they are asked for, but two to three times as far as captured people do
    (`kinegraph_benchmarks.quality.turns`).

    Args:
        joints: (frames, 22, 3) metres, from the origin on and facing +Z.
        fps: frames a second.
        options: of the motion, with its turn if there is one.
    """
    if options.turn is None:
        return joints
    turn = turn_by if options.turn.is_said else hold_back_turn
    return turn(joints, fps, options.turn.degrees, options.turn.side, options.shown)


def tell_turn(joints: FloatArray, options: GenerateOptions) -> tuple[str, ...]:
    """Tell where a motion (frames, 22, 3) does not turn as far as its sentence says, as a note."""
    if options.turn is None or not options.turn.is_said:
        return ()
    asked = options.turn.degrees
    if abs(turned_to(joints, options.turn.side, options.shown) - asked) <= NEAR_TURN * asked:
        return ()
    made = turned_to(joints, 1, options.shown)
    side = "left" if made > 0 else "right"
    return (f"{asked:g} degrees are asked for, and the turn is {abs(made):.0f} to the {side}; try another seed",)


def decode_joints(
    decoder: onnxruntime.InferenceSession,
    manifest: Manifest,
    bones: FloatArray | None,
    latents: FloatArray,
    frames: Sequence[int],
) -> list[FloatArray]:
    """Decode latents into joints (frames, 22, 3) of every sample: metres, Y up, facing +Z at the start.

    Args:
        decoder: session of the decoder.
        manifest: of its bundle.
        bones: (21,) metres that all bones get; None keeps each at its median length in the clip.
        latents: (B, C, z) of the decoder's level.
        frames: of each sample.

    Raises:
        ModelError, NonFiniteError: see `bundle.sessions.run_model`.
    """
    return joints_of_features(decode_features(decoder, manifest, latents, frames), manifest, bones)


def joints_of_features(
    features: Sequence[FloatArray], manifest: Manifest, bones: FloatArray | None
) -> list[FloatArray]:
    """Convert features (frames, F) of every sample, not normalised, to joints; see `decode_joints`."""
    joints_from = _JOINTS_FROM[manifest.features.layout]
    return [enforce_bone_lengths(joints_from(rows), bones) for rows in features]


def decode_features(
    decoder: onnxruntime.InferenceSession, manifest: Manifest, latents: FloatArray, frames: Sequence[int]
) -> list[FloatArray]:
    """Decode latents into features (frames, F) of every sample, not normalised; arguments as for `decode_joints`.

    Raises:
        ModelError, NonFiniteError: see `bundle.sessions.run_model`.
    """
    group = manifest.frames.per_token
    longest = -(-max(frames) // group) * group  # rounded up to whole groups of frames
    frame_mask = np.zeros((len(frames), longest), dtype=np.float32)
    for row, count in enumerate(frames):
        frame_mask[row, :count] = 1.0
    inputs = {"latent": latents, "frame_mask": frame_mask}
    (normalised,) = run_model(decoder, ["features"], inputs, "the decoder")
    mean, std = (np.array(part, dtype=np.float32) for part in (manifest.features.mean, manifest.features.std))
    features = normalised * std + mean
    return [rows[:count] for rows, count in zip(features, frames, strict=True)]
