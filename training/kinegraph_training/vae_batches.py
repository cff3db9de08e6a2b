"""Batches of clips of like length: a fixed budget of frames, so that padding stays small and memory level."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from kinegraph.arrays import FloatArray
from torch import Tensor, distributed
from torch.utils.data import Sampler


def rank_and_world() -> tuple[int, int]:
    """Which of the processes that train together this is, and how many there are."""
    if not (distributed.is_available() and distributed.is_initialized()):
        return 0, 1
    return distributed.get_rank(), distributed.get_world_size()


class FrameBudgetSampler(Sampler[list[int]]):
    """Batches sorted by jittered length; the same seed and epoch give the same batches (so a resumed run goes on).

    Processes that train together get equal shares of them: who had one more would wait for the others for ever.
    """

    def __init__(self, lengths: list[int], budget: int, seed: int) -> None:
        self.lengths = np.array(lengths)
        self.budget = budget
        self.seed = seed
        self.epoch = 0

    def set_epoch(self, epoch: int) -> None:
        """Called by Lightning before each epoch."""
        self.epoch = epoch

    def __iter__(self) -> Iterator[list[int]]:
        return iter(self.share(*rank_and_world()))

    def __len__(self) -> int:
        return len(self.batches()) // rank_and_world()[1]

    def share(self, rank: int, world: int) -> list[list[int]]:
        """Every world-th batch of an epoch; what is left over at its end is left out."""
        batches = self.batches()
        return batches[rank : len(batches) - len(batches) % world : world]

    def batches(self) -> list[list[int]]:
        """Indices per batch, in training order."""
        rng = np.random.Generator(np.random.PCG64([self.seed, self.epoch]))
        order = np.argsort(self.lengths * (1 + 0.15 * rng.standard_normal(len(self.lengths))), kind="stable")
        batches: list[list[int]] = []
        current: list[int] = []
        longest = 0
        for index in order:
            longest = max(longest, int(self.lengths[index]))
            if current and longest * (len(current) + 1) > self.budget:
                batches.append(current)
                current, longest = [], int(self.lengths[index])
            current.append(int(index))
        batches.append(current)
        return [batches[i] for i in rng.permutation(len(batches))]


def padded(clips: list[FloatArray], multiple: int) -> tuple[Tensor, Tensor]:
    """(b, l, f) zero-padded to a multiple, and the frame mask (b, l)."""
    frames = -(-max(map(len, clips)) // multiple) * multiple
    features = np.zeros((len(clips), frames, clips[0].shape[1]), dtype=np.float32)
    mask = np.zeros((len(clips), frames), dtype=np.float32)
    for row, clip in enumerate(clips):
        features[row, : len(clip)] = clip
        mask[row, : len(clip)] = 1.0
    return torch.from_numpy(features), torch.from_numpy(mask)


def cropped(features: FloatArray, rng: np.random.Generator, *, min_frames: int, max_frames: int) -> FloatArray:
    """Half of the clips are cut to 50-100 % of their length; all to at most `max_frames`."""
    frames = len(features)
    length = frames if rng.random() < 0.5 else int(frames * rng.uniform(0.5, 1.0))
    length = int(np.clip(length, min(min_frames, frames), max_frames))
    start = int(rng.integers(0, frames - length + 1))
    return features[start : start + length]
