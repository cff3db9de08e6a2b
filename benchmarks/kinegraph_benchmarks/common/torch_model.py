"""A training run sampled in torch, so that models which are for comparison only (GraphMotion's `concat`, one-stage
latent diffusion, ablations) are measured by the same `evaluate.py` as a bundle."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from kinegraph.bundle.contract import LEVELS
from kinegraph.bundle.reader import DEFAULT_BUNDLE
from kinegraph.bundle.tables import bones_of
from kinegraph.conditioning import GraphArrays
from kinegraph.diffusion.sampling import LevelPlan, initial_noise
from kinegraph.graph import SemanticGraph
from kinegraph.motion.postprocess import enforce_bone_lengths, lock_feet
from kinegraph_export.checkpoints import read_run
from kinegraph_export.pipeline_parity import Request, torch_joints
from kinegraph_training.bundle_tables import read_tables
from kinegraph_training.data.caption_cache import CaptionEncoder, plain_tokens

FPS = 20
STEPS = {"motion": 15, "action": 15, "specific": 20}
ONE_STAGE_STEPS = 50
"""All steps of the three levels, for a model that has only one."""
GUIDANCE = 2.5
GUIDANCE_BASE = "coarse"


@dataclass(frozen=True)
class TorchClip:
    """What `evaluate.py` reads of a clip."""

    joints: NDArray[np.float32]


class TorchModel:
    """Stands in for a pipeline: `generate`, `seconds_limits`, `fps`, `name`, `stamp`."""

    fps = FPS
    seconds_limits = (16 / FPS, 196 / FPS)

    def __init__(self, run: Path, text_files: Path = DEFAULT_BUNDLE) -> None:
        self.name = run.name
        checkpoint = run / "denoisers" / "last.ckpt"
        self.stamp = hashlib.sha256(checkpoint.read_bytes()).hexdigest()
        self._trained, self._own = read_run(run)
        self._encoder = CaptionEncoder(text_files)
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
        """As `MotionPipeline.generate`, the noise drawn in the same way; steps in the order of the model's levels."""
        latents = self._trained.hierarchy.latents
        if steps is not None:
            counts = dict(zip(latents, steps, strict=True))
        else:
            counts = {level: STEPS[level] for level in latents} if len(latents) > 1 else {LEVELS[-1]: ONE_STAGE_STEPS}
        plans = [LevelPlan(level, shape.tokens, shape.width, counts[level]) for level, shape in latents.items()]
        request = Request(
            round(seconds * FPS), initial_noise(seed, plans), counts, dict.fromkeys(latents, guidance), GUIDANCE_BASE
        )
        joints = torch_joints(self._trained, self._condition(caption), request, self._own.mean, self._own.std)
        return TorchClip(lock_feet(enforce_bone_lengths(joints, self._bones), FPS))

    @torch.no_grad()
    def _condition(self, caption: str | SemanticGraph) -> GraphArrays:
        if self._config.condition == "tokens":
            words = caption if isinstance(caption, str) else caption.caption
            return plain_tokens(self._encoder.hidden(words))
        return self._encoder(caption)
