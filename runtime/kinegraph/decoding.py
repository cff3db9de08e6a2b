"""From a latent to joints in metres, and to clips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import onnxruntime

from kinegraph.arrays import FloatArray, require_finite
from kinegraph.bundle.contract import LEVELS
from kinegraph.bundle.manifest import Manifest
from kinegraph.bundle.sessions import Sessions
from kinegraph.clip import Clip
from kinegraph.motion.features import joints_from_features
from kinegraph.motion.humanml3d import joints_from_humanml3d
from kinegraph.motion.postprocess import enforce_bone_lengths, lock_feet
from kinegraph.options import GenerateOptions

_TO_JOINTS: Final = {"joints-137": joints_from_features, "humanml3d-263": joints_from_humanml3d}


@dataclass(frozen=True)
class Decoders:
    """From the latent of a level to clips."""

    sessions: Sessions
    manifest: Manifest
    bones: FloatArray | None
    """(21,) metres, as in `decode`."""

    def clips(
        self, latent: FloatArray, wishes: Sequence[GenerateOptions], captions: Sequence[str], level: str = LEVELS[-1]
    ) -> list[Clip]:
        """Latents (B, C, z) of a level as B clips, their feet held where that is wished for."""
        frames, fps = [each.frames for each in wishes], self.manifest.fps
        motions = decode(self.sessions.decoder_of(level), self.manifest, self.bones, latent, frames)
        bundle = f"{self.manifest.name} {self.manifest.version}"
        return [
            Clip(lock_feet(joints, fps) if each.foot_fix else joints, fps, each.seed, caption, bundle)
            for joints, each, caption in zip(motions, wishes, captions, strict=True)
        ]


def decode(
    decoder: onnxruntime.InferenceSession,
    manifest: Manifest,
    bones: FloatArray | None,
    latent: FloatArray,
    frames: Sequence[int],
) -> list[FloatArray]:
    """Joints (frames, 22, 3) of every sample.

    Args:
        decoder: session of the decoder.
        manifest: of its bundle.
        bones: (21,) metres that all bones get; None keeps each at its median length in the clip.
        latent: (B, C, z) of the finest level.
        frames: of each sample.

    Raises:
        NonFiniteError: the decoder produced NaN or infinity.
    """
    group = manifest.frames.per_token
    longest = -(-max(frames) // group) * group
    frame_mask = np.zeros((len(frames), longest), dtype=np.float32)
    for row, count in enumerate(frames):
        frame_mask[row, :count] = 1.0
    (features,) = decoder.run(["features"], {"latent": latent, "frame_mask": frame_mask})
    mean, std = (np.array(part, dtype=np.float32) for part in (manifest.features.mean, manifest.features.std))
    raw = require_finite(features, "the decoder") * std + mean
    to_joints = _TO_JOINTS[manifest.features.layout]
    motions = [to_joints(rows[:count]) for rows, count in zip(raw, frames, strict=True)]
    return [enforce_bone_lengths(joints, bones) for joints in motions]
