"""Recognise which action and which style a motion shows, with a linear classifier on statistics of the movement.

It is trained on captured clips only, and on nothing that a network has learnt: an opinion independent of the
evaluator. The model is a ridge regression onto one-hot labels, solved in closed form.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import FloatArray
from kinegraph.motion.features import features_from_joints
from kinegraph_training.data.clips import MotionClip

PENALTY = 1.0
"""Ridge penalty."""

LABELS = {"content": attrgetter("action"), "style": attrgetter("style")}
"""Labels of a clip by the name that reports give them."""


def movement_statistics(joints: FloatArray) -> NDArray[np.float64]:
    """Summarise a motion by statistics that do not depend on its length.

    Per feature: mean, standard deviation, 10th and 90th percentile, and mean and largest change per frame.

    Args:
        joints: (frames, 22, 3), metres.
    """
    features = features_from_joints(joints).astype(np.float64)
    change = np.abs(np.diff(features, axis=0))
    low, high = np.percentile(features, [10, 90], axis=0)
    return np.concatenate([features.mean(0), features.std(0), low, high, change.mean(0), change.max(0)])


class LabelClassifier:
    """Classifier of the two labels of a clip, "content" (its action) and "style", trained on labelled clips.

    Args:
        clips: labelled.
        balance: a clip counts 1 / (clips of its action) ** balance; 0 counts all alike, and rare actions little.
    """

    def __init__(self, clips: Sequence[MotionClip], balance: float = 0.0) -> None:
        rows = np.stack([movement_statistics(clip.joints) for clip in clips])
        self._mean, self._std = rows.mean(0), rows.std(0) + 1e-3
        self.labels = {name: sorted({label_of(clip) for clip in clips}) for name, label_of in LABELS.items()}
        design = self._design_matrix(rows)
        counts = Counter(clip.action for clip in clips)
        weight = np.array([float(counts[clip.action]) ** -balance for clip in clips])
        weighted = design * (weight / weight.mean())[:, None]
        gram = weighted.T @ design + PENALTY * np.eye(design.shape[1])
        self._weights = {}
        for name, labels in self.labels.items():
            target = np.array([[LABELS[name](clip) == label for label in labels] for clip in clips], dtype=float)
            self._weights[name] = np.linalg.solve(gram, weighted.T @ target)

    def __call__(self, motions: Sequence[FloatArray], name: str) -> list[str]:
        """Recognise the "content" or the "style" of each motion."""
        scores = (
            self._design_matrix(np.stack([movement_statistics(joints) for joints in motions])) @ self._weights[name]
        )
        return [self.labels[name][best] for best in scores.argmax(axis=1)]

    def _design_matrix(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Standardise statistics and append the intercept's column of ones."""
        return np.concatenate([(rows - self._mean) / self._std, np.ones((len(rows), 1))], axis=1)
