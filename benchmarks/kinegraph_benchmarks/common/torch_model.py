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


class LatentRun:
    """Latent denoisers of a training run."""

    def __init__(self, run: Path) -> None:
        self.trained, self._vae = read_run(run)

    def joints(
        self, graph: GraphArrays, frames: int, seed: int, steps: list[int] | None, guidance: float
    ) -> FloatArray:
        """Sample the joints (frames, 22, 3) of an encoded graph; other arguments as in `TorchModel.generate`."""
        latents = self.trained.hierarchy.latents
        if steps is not None:
            counts = dict(zip(latents, steps, strict=True))
        else:
            counts = {level: STEPS[level] for level in latents} if len(latents) > 1 else {LEVELS[-1]: ONE_STAGE_STEPS}
        plans = [LevelPlan(level, shape.tokens, shape.width, counts[level]) for level, shape in latents.items()]
        request = SamplingRequest(
            frames, initial_noise(seed, plans), counts, dict.fromkeys(latents, guidance), GUIDANCE_BASE
        )
        return torch_joints(self.trained, graph, request, self._vae.mean, self._vae.std)


class FramesRun:
    """Denoiser of skeleton space of a training run."""

    def __init__(self, run: Path) -> None:
        self.trained = read_frames(run / FRAMES / "last.ckpt")
        self._vae = read_vae(run / f"vae_{LEVELS[-1]}" / "last.ckpt")

    @torch.no_grad()
    def joints(
        self, graph: GraphArrays, frames: int, seed: int, steps: list[int] | None, guidance: float
    ) -> FloatArray:
        """Sample the joints (frames, 22, 3) of an encoded graph; other arguments as in `TorchModel.generate`."""
        part = self.trained.part(FRAMES_STEPS if steps is None else steps[0], guidance)
        nodes = self.trained.hierarchy.encode(as_batch(graph))[0]
        return sample_frames(self.trained.denoiser, graph, nodes, part, seed, frames, self._vae.mean, self._vae.std)


class TorchModel:
    """Generator of clips from a training run (see `sample_cache.Model`).

    It samples the run's latent denoisers, or its network of skeleton space where it has no others.

    Args:
        run: folder with checkpoints and tables.npz.
        text_files: folder of the tokenizer, the text encoder and the parser; None takes those of installed bundles.
    """

    fps = FPS
    seconds_limits = (16 / FPS, 196 / FPS)

    def __init__(self, run: Path, text_files: Path | None = None) -> None:
        self.name = run.name
        latent, frames = (run / stage / "last.ckpt" for stage in ("denoisers", FRAMES))
        in_frames = frames.is_file() and not latent.is_file()
        self.run: LatentRun | FramesRun = FramesRun(run) if in_frames else LatentRun(run)
        self.stamp = hashlib.sha256((frames if in_frames else latent).read_bytes()).hexdigest()
        self._encoder = CaptionEncoder(text_files or text_files_folder())
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
        graph = self._encode(caption)
        joints = self.run.joints(graph, round(seconds * FPS), seed, steps, guidance)
        return TorchClip(lock_feet(enforce_bone_lengths(joints, self._bones), FPS))

    @torch.no_grad()
    def _encode(self, caption: str | SemanticGraph) -> GraphArrays:
        """Encode a caption as the run's denoisers were trained: its graph, or its plain tokens."""
        if self.run.trained.hierarchy.config.condition == "tokens":
            words = caption if isinstance(caption, str) else caption.caption
            return tokens_as_graph(self._encoder.hidden_states(words))
        return self._encoder.encode(caption)
