"""Sample a training run in torch, so that models for comparison only are measured by the same `quality.evaluate`.

Such models are GraphMotion's `concat`, one-stage latent diffusion, MDM's network, and ablations: they are not exported
to a bundle.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import torch

from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import FRAMES, LEVELS
from kinegraph.bundle.reader import text_files_folder
from kinegraph.bundle.tables import bones_of
from kinegraph.conditioning import GraphArrays
from kinegraph.diffusion.sampling import LevelPlan, initial_noise
from kinegraph.graph import SemanticGraph
from kinegraph.motion.postprocess import enforce_bone_lengths, lock_feet
from kinegraph_export.add_frames import GUIDANCE as FRAMES_GUIDANCE
from kinegraph_export.add_frames import STEPS as FRAMES_STEPS
from kinegraph_export.add_frames import read_frames, sample_frames
from kinegraph_export.checkpoints import read_run
from kinegraph_export.pipeline_parity import SamplingRequest, as_batch, torch_joints
from kinegraph_training.bundle_tables import read_tables
from kinegraph_training.data.caption_cache import CaptionEncoder, tokens_as_graph
from kinegraph_training.latents import read_vae

FPS = 20
STEPS = {"motion": 15, "action": 15, "specific": 20}
ONE_STAGE_STEPS = 50
"""Steps of a model that has only one level: as many as the three levels have together."""
GUIDANCE = 2.5
GUIDANCE_BASE = "coarse"


@dataclass(frozen=True)
class TorchClip:
    """A generated clip, as far as benchmarks read it."""

    joints: FloatArray
    """(frames, 22, 3) metres."""


class TorchModel:
    """Generator of clips from a training run (see `sample_cache.Model`).

    Args:
        run: folder with checkpoints and tables.npz.
        text_files: folder of the tokenizer, the text encoder and the parser; None takes those of installed bundles.
    """

    fps = FPS
    seconds_limits = (16 / FPS, 196 / FPS)

    def __init__(self, run: Path, text_files: Path | None = None) -> None:
        self.name = run.name
        checkpoint = run / "denoisers" / "last.ckpt"
        self.stamp = hashlib.sha256(checkpoint.read_bytes()).hexdigest()
        self._trained, self._vae = read_run(run)
        self._encoder = CaptionEncoder(text_files or text_files_folder())
        self._config = self._trained.hierarchy.config
        self._bones = bones_of(read_tables(run))

    def generate(
        self,
        caption: str | SemanticGraph,
        *,
        seconds: float,
        seed: int,
        steps: list[int] | None = None,
        guidance: float = GUIDANCE,
    ) -> TorchClip:
        """Generate a clip as `MotionPipeline.generate` does, with the same noise for a seed.

        Args:
            caption: a sentence or its graph.
            seconds: length.
            seed: of the noise.
            steps: diffusion steps, in the order of the model's levels.
            guidance: scale, the same at every level.
        """
        latents = self._trained.hierarchy.latents
        if steps is not None:
            counts = dict(zip(latents, steps, strict=True))
        else:
            counts = {level: STEPS[level] for level in latents} if len(latents) > 1 else {LEVELS[-1]: ONE_STAGE_STEPS}
        plans = [LevelPlan(level, shape.tokens, shape.width, counts[level]) for level, shape in latents.items()]
        request = SamplingRequest(
            round(seconds * FPS), initial_noise(seed, plans), counts, dict.fromkeys(latents, guidance), GUIDANCE_BASE
        )
        joints = torch_joints(self._trained, self._encode(caption), request, self._vae.mean, self._vae.std)
        return TorchClip(lock_feet(enforce_bone_lengths(joints, self._bones), FPS))

    @torch.no_grad()
    def _encode(self, caption: str | SemanticGraph) -> GraphArrays:
        return encode_caption(self._encoder, caption, self._config.condition)


class TorchFrames:
    """Generator of clips from a training run of skeleton space, as `TorchModel` for latent space."""

    fps = FPS
    seconds_limits = (16 / FPS, 196 / FPS)

    def __init__(self, run: Path, text_files: Path | None = None) -> None:
        self.name = run.name
        checkpoint = run / FRAMES / "last.ckpt"
        self.stamp = hashlib.sha256(checkpoint.read_bytes()).hexdigest()
        self._trained = read_frames(checkpoint)
        self._vae = read_vae(run / f"vae_{LEVELS[-1]}" / "last.ckpt")
        self._encoder = CaptionEncoder(text_files or text_files_folder())
        self._bones = bones_of(read_tables(run))

    @torch.no_grad()
    def generate(
        self,
        caption: str | SemanticGraph,
        *,
        seconds: float,
        seed: int,
        steps: list[int] | None = None,
        guidance: float = FRAMES_GUIDANCE,
    ) -> TorchClip:
        """Generate a clip; arguments as in `TorchModel.generate`, `steps` of one level."""
        hierarchy, vae = self._trained.hierarchy, self._vae
        arrays = encode_caption(self._encoder, caption, hierarchy.config.condition)
        part = self._trained.part(FRAMES_STEPS if steps is None else steps[0], guidance)
        nodes = hierarchy.encode(as_batch(arrays))[0]
        denoiser = self._trained.denoiser
        joints = sample_frames(denoiser, arrays, nodes, part, seed, round(seconds * FPS), vae.mean, vae.std)
        return TorchClip(lock_feet(enforce_bone_lengths(joints, self._bones), FPS))


def load_run(run: Path) -> TorchModel | TorchFrames:
    """Load a training run: its latent denoisers, or those of skeleton space where it has no others."""
    is_latent = (run / "denoisers" / "last.ckpt").is_file() or not (run / FRAMES / "last.ckpt").is_file()
    return TorchModel(run) if is_latent else TorchFrames(run)


def encode_caption(encoder: CaptionEncoder, caption: str | SemanticGraph, condition: str) -> GraphArrays:
    """Encode a caption as denoisers were trained: its graph, or its plain tokens (`DenoiserConfig.condition`)."""
    if condition == "tokens":
        words = caption if isinstance(caption, str) else caption.caption
        return tokens_as_graph(encoder.hidden_states(words))
    return encoder.encode(caption)
