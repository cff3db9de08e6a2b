"""Batches of the skeleton-space denoiser: groups of frames and caption graphs, of clips of similar length.

Shapes: b samples, c groups of frames, g frames of a group, f features, z = g f, n nodes.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from kinegraph.bundle.contract import FRAMES
from kinegraph_training.config import FrameConfig
from kinegraph_training.data.caption_cache import CaptionGraphs, CaptionStates
from kinegraph_training.dataset import Dataset
from kinegraph_training.denoiser_batches import DenoiserBatch, DenoiserBatches
from kinegraph_training.models.frame_denoiser import group_frames
from kinegraph_training.vae_batches import pad_clips


@dataclass(frozen=True)
class FrameBatch(DenoiserBatch):
    """Batch of b samples whose only level is `contract.FRAMES`."""

    token_mask: Tensor
    """(b, c) 1 on groups of frames, 0 on padding."""

    def to(self, device: torch.device) -> FrameBatch:
        """Move all tensors to a device."""
        return FrameBatch(**vars(super().to(device)), token_mask=self.token_mask.to(device))


class FrameBatches(DenoiserBatches):
    """Collate function as `DenoiserBatches`; clips are cut to whole groups of frames."""

    def __init__(
        self,
        dataset: Dataset,
        config: FrameConfig,
        graphs: CaptionGraphs | CaptionStates,
        *,
        seed: int,
        augment: bool,
        masked: CaptionGraphs | None = None,
    ) -> None:
        super().__init__(dataset, {}, graphs, seed=seed, augment=augment, masked=masked)
        self.config = config

    def __call__(self, indices: list[int]) -> FrameBatch:
        graph, bias, _ = self._draw_graphs(indices)
        group = self.config.frames_per_token
        clips = [self.dataset.features[index] for index in indices]
        features, mask = pad_clips([rows[: len(rows) // group * group] for rows in clips], group)
        batch = FrameBatch(
            graph=graph,
            node_bias=bias,
            latents={FRAMES: self.config.scale * group_frames(features, group)},
            coarse={},
            coarse_bias=torch.zeros(len(indices)),
            frames=mask.sum(dim=1).long(),
            token_mask=mask[:, ::group],
        )
        return self._drop_conditions(batch) if self.augment else batch
