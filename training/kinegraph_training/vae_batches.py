"""Batches of clips of similar length, under a budget of frames that keeps padding small and memory constant."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, distributed
from torch.utils.data import Sampler

from kinegraph.arrays import FloatArray


def rank_and_world() -> tuple[int, int]:
    """Return the index of this process in distributed training, and the number of processes."""
    if not (distributed.is_available() and distributed.is_initialized()):
        return 0, 1
    return distributed.get_rank(), distributed.get_world_size()


class FrameBudgetSampler(Sampler[list[int]]):
    """Sampler of batches whose padded clips hold at most `budget` frames.

    Clips are sorted by jittered length. The same seed and epoch give the same batches, so that a resumed run continues
    as it would have. Processes of distributed training get equal shares: one with a batch more would wait for the
    others for ever.

    Args:
        lengths: frames of each clip.
        budget: frames of a batch.
        seed: of the order and the draws.
        weights: how often each clip is drawn, with replacement; None takes each once an epoch. The sum of lengths of
            an epoch, and so its number of batches, then vary a little.
    """

    def __init__(self, lengths: list[int], budget: int, seed: int, weights: NDArray[np.float64] | None = None) -> None:
        self.lengths = np.array(lengths)
        self.budget = budget
        self.seed = seed
        self.weights = None if weights is None else weights / weights.sum()
        self.epoch = 0

    @property
    def sampler(self) -> FrameBudgetSampler:
        """Return itself: Lightning tells the epoch to the sampler of a batch sampler, and to nothing else."""
        return self

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch whose batches come next."""
        self.epoch = epoch

    def __iter__(self) -> Iterator[list[int]]:
        return iter(self.share(*rank_and_world()))

    def __len__(self) -> int:
        return len(self.batches()) // rank_and_world()[1]

    def share(self, rank: int, world: int) -> list[list[int]]:
        """Return every world-th batch of the epoch, from `rank` on; the remainder at the end is left out."""
        batches = self.batches()
        return batches[rank : len(batches) - len(batches) % world : world]

    def batches(self) -> list[list[int]]:
        """Return the indices of every batch of the epoch, in training order."""
        rng = np.random.Generator(np.random.PCG64([self.seed, self.epoch]))
        count = len(self.lengths)
        drawn = np.arange(count) if self.weights is None else rng.choice(count, count, p=self.weights)
        order = drawn[np.argsort(self.lengths[drawn] * (1 + 0.15 * rng.standard_normal(count)), kind="stable")]
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


def pad_clips(clips: list[FloatArray], multiple: int) -> tuple[Tensor, Tensor]:
    """Stack sequences (frames, width), padded with zeros to a common multiple of frames.

    Returns:
        (b, l, width) and the mask (b, l), 1 for real frames.
    """
    frames = -(-max(map(len, clips)) // multiple) * multiple
    features = np.zeros((len(clips), frames, clips[0].shape[1]), dtype=np.float32)
    mask = np.zeros((len(clips), frames), dtype=np.float32)
    for row, clip in enumerate(clips):
        features[row, : len(clip)] = clip
        mask[row, : len(clip)] = 1.0
    return torch.from_numpy(features), torch.from_numpy(mask)


def random_crop(features: FloatArray, rng: np.random.Generator, *, min_frames: int, max_frames: int) -> FloatArray:
    """Crop half of the clips to 50-100 % of their length, and all to at most `max_frames`."""
    frames = len(features)
    length = frames if rng.random() < 0.5 else int(frames * rng.uniform(0.5, 1.0))
    length = int(np.clip(length, min(min_frames, frames), max_frames))
    start = int(rng.integers(0, frames - length + 1))
    return features[start : start + length]
