"""Which action and which style a motion shows, by a linear classifier on plain statistics of the movement.

Trained on recorded clips only, and on nothing a network has learnt: an opinion independent of the evaluator. A ridge
regression onto one-hot labels, solved in closed form.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from kinegraph.motion.features import features_from_joints
from kinegraph_training.data.clips import MotionClip

PENALTY = 1.0


def statistics(joints: NDArray[np.float32]) -> NDArray[np.float64]:
    """Mean, spread and 10th and 90th percentile of every feature, and of how fast each changes; length has no say."""
    features = features_from_joints(joints).astype(np.float64)
    change = np.abs(np.diff(features, axis=0))
    low, high = np.percentile(features, [10, 90], axis=0)
    return np.concatenate([features.mean(0), features.std(0), low, high, change.mean(0), change.max(0)])


class Recogniser:
    """Content and style of motions."""

    def __init__(self, clips: Sequence[MotionClip]) -> None:
        rows = np.stack([statistics(clip.joints) for clip in clips])
        self._mean, self._std = rows.mean(0), rows.std(0) + 1e-3
        self.labels = {name: sorted({getattr(clip, name) for clip in clips}) for name in ("content", "style")}
        design = self._design(rows)
        gram = design.T @ design + PENALTY * np.eye(design.shape[1])
        self._weights = {}
        for name, labels in self.labels.items():
            target = np.array([[getattr(clip, name) == label for label in labels] for clip in clips], dtype=float)
            self._weights[name] = np.linalg.solve(gram, design.T @ target)

    def __call__(self, motions: Sequence[NDArray[np.float32]], name: str) -> list[str]:
        """The "content" or the "style" of each motion."""
        scores = self._design(np.stack([statistics(joints) for joints in motions])) @ self._weights[name]
        return [self.labels[name][best] for best in scores.argmax(axis=1)]

    def _design(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate([(rows - self._mean) / self._std, np.ones((len(rows), 1))], axis=1)
