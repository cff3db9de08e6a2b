"""Features of clips in shards, computed when a clip is drawn: nothing of them is kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, overload

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from kinegraph.arrays import FloatArray
from kinegraph_training.data.clips import StoredClips
from kinegraph_training.layouts import FeatureLayout, measure_normalisation

MEASURED: Final = 20_000
"""Clips that a normalisation is measured on, evenly spread: 40 hours of 7 s tell it to the third digit."""


@dataclass(frozen=True)
class StoredFeatures(Sequence[FloatArray]):
    """Normalised features of clips, (frames, width) each."""

    clips: StoredClips
    layout: FeatureLayout
    mean: FloatArray
    """(width,) of the normalisation."""
    std: FloatArray
    """(width,) of the normalisation."""
    longest: int | None = None
    """Frames that clips are cut to."""

    @classmethod
    def measured(cls, clips: StoredClips, layout: FeatureLayout) -> StoredFeatures:
        """Measure the normalisation of the clips on up to `MEASURED` of them."""
        some = clips.select(np.unique(np.linspace(0, len(clips) - 1, min(len(clips), MEASURED)).astype(np.int64)))
        shown = tqdm(some, desc="normalisation", unit="clip", disable=None)
        mean, std = measure_normalisation((layout.from_joints(clip.joints) for clip in shown), layout)
        return cls(clips, layout, mean, std)

    @property
    def lengths(self) -> NDArray[np.int64]:
        """Rows of each clip, (clips,)."""
        frames = self.clips.frames if self.longest is None else np.minimum(self.clips.frames, self.longest)
        return np.asarray(frames - self.layout.lost)

    def under(self, mean: FloatArray, std: FloatArray) -> StoredFeatures:
        """Return the same features under another normalisation, (width,) each."""
        return replace(self, mean=mean, std=std)

    def select(self, indices: NDArray[np.int64]) -> StoredFeatures:
        """Return the features of some of the clips."""
        return replace(self, clips=self.clips.select(indices))

    def __len__(self) -> int:
        return len(self.clips)

    @overload
    def __getitem__(self, index: int) -> FloatArray: ...
    @overload
    def __getitem__(self, index: slice) -> StoredFeatures: ...
    def __getitem__(self, index: int | slice) -> FloatArray | StoredFeatures:
        if isinstance(index, slice):
            return self.select(np.arange(len(self))[index])
        rows = self.layout.from_joints(self.clips[index].joints[: self.longest])
        return np.asarray((rows - self.mean) / self.std, dtype=np.float32)
