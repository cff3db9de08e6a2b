"""The papers' metrics in numpy, on embeddings of motions and captions.

Definitions follow Guo et al. (2022), which both papers evaluate with, and GraphMotion's supplement E; n clips, e joint
width. Distances are Euclidean.

How clean a motion is, whatever it shows. joints: (frames, 22, 3) metres at 20 frames per second."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from kinegraph.arrays import FloatArray
from numpy.typing import NDArray

from kinegraph.motion.skeleton import JOINT_INDEX, bone_lengths

Embeddings = NDArray[np.floating]


def distances(a: Embeddings, b: Embeddings) -> NDArray[np.float64]:
    """(n, e), (m, e) -> (n, m)."""
    difference = np.asarray(a, dtype=np.float64)[:, None] - np.asarray(b, dtype=np.float64)[None]
    return np.asarray(np.linalg.norm(difference, axis=-1))


def r_precision(texts: Embeddings, motions: Embeddings, top: int = 3) -> NDArray[np.float64]:
    """Share of texts whose own motion is among the nearest 1, 2, ... `top` motions: (top,).

    texts and motions: (n, e), row i belongs to row i. A motion that is exactly as near as the right one counts against
    it, so that a model which answers everything alike scores nothing.
    """
    table = distances(texts, motions)
    own = np.diag(table)[:, None]
    rank = (table <= own).sum(axis=1) - 1
    return np.array([(rank < place).mean() for place in range(1, top + 1)])


def label_groups(labels: Sequence[str], size: int, rng: np.random.Generator) -> list[NDArray[np.int64]]:
    """Row numbers in groups of `size` distinct labels (of all labels, where there are fewer), one row per label.

    Every row is used about once: labels are dealt out of shuffled piles until too few are left for a group.
    """
    piles: dict[str, list[int]] = {}
    for row in rng.permutation(len(labels)):
        piles.setdefault(labels[row], []).append(int(row))
    size = min(size, len(piles))
    groups = []
    while True:
        # the longest piles first, ties by chance: otherwise frequent labels are left over
        left = [name for name in piles if piles[name]]
        if len(left) < size:
            return groups
        order = sorted(left, key=lambda name: (-len(piles[name]), rng.random()))
        groups.append(np.array([piles[name].pop() for name in order[:size]], dtype=np.int64))


def matching_distance(texts: Embeddings, motions: Embeddings) -> float:
    """MM-Dist: mean distance of each motion to its own text."""
    return float(np.linalg.norm(np.asarray(texts) - np.asarray(motions), axis=-1).mean())


def frechet(
    mean_a: NDArray[np.float64], cov_a: NDArray[np.float64], mean_b: NDArray[np.float64], cov_b: NDArray[np.float64]
) -> float:
    """|m_a - m_b|^2 + tr(C_a + C_b - 2 (C_a C_b)^1/2), Gaussians with means (e,) and covariances (e, e)."""
    values, vectors = np.linalg.eigh(cov_a)
    root = vectors * np.sqrt(values.clip(min=0.0)) @ vectors.T
    # tr (C_a C_b)^1/2 = tr (R C_b R)^1/2 with R = C_a^1/2, which is symmetric
    cross = np.sqrt(np.linalg.eigvalsh(root @ cov_b @ root).clip(min=0.0)).sum()
    # rounding may leave a hair below zero
    return max(0.0, float(((mean_a - mean_b) ** 2).sum() + np.trace(cov_a) + np.trace(cov_b) - 2.0 * cross))


def frechet_distance(a: Embeddings, b: Embeddings) -> float:
    """FID of two sets (n, e) and (m, e)."""
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    return frechet(a.mean(axis=0), np.cov(a, rowvar=False), b.mean(axis=0), np.cov(b, rowvar=False))


def diversity(motions: Embeddings, rng: np.random.Generator, pairs: int = 300) -> float:
    """Mean distance of motions drawn in pairs; at most n // 2 disjoint pairs."""
    order = rng.permutation(len(motions))
    count = min(pairs, len(motions) // 2)
    first, second = motions[order[:count]], motions[order[count : 2 * count]]
    return float(np.linalg.norm(np.asarray(first) - np.asarray(second), axis=-1).mean())


def multimodality(takes: Embeddings, rng: np.random.Generator, pairs: int = 10) -> float:
    """Mean distance between takes of one caption; takes: (captions, takes per caption, e)."""
    found = []
    for one in np.asarray(takes):
        order = rng.permutation(len(one))
        count = min(pairs, len(one) // 2)
        found.append(np.linalg.norm(one[order[:count]] - one[order[count : 2 * count]], axis=-1).mean())
    return float(np.mean(found))


def bootstrap(
    statistic: Callable[[NDArray[np.int64]], float], count: int, rng: np.random.Generator, draws: int = 200
) -> tuple[float, float]:
    """95 % percentile interval of a statistic of rows, drawing `count` rows with replacement each time."""
    values = [statistic(rng.integers(0, count, count)) for _ in range(draws)]
    low, high = np.percentile(values, [2.5, 97.5])
    return float(low), float(high)


FPS = 20
SOLE = 0.05
"""Metres: a toe below this height stands on the floor."""


def jerk(joints: FloatArray) -> float:
    """Mean length of the third derivative of the joints' positions, m/s^3."""
    third = np.diff(joints.astype(np.float64), n=3, axis=0) * FPS**3
    return float(np.linalg.norm(third, axis=-1).mean())


def foot_skate(joints: FloatArray) -> float:
    """Mean horizontal speed of the toes while they are below 5 cm, m/s; NaN if they never are."""
    toes = joints[:, [JOINT_INDEX["left_foot"], JOINT_INDEX["right_foot"]]].astype(np.float64)
    speed = np.linalg.norm(np.diff(toes[..., [0, 2]], axis=0), axis=-1) * FPS
    down = np.maximum(toes[1:, :, 1], toes[:-1, :, 1]) < SOLE
    return float(speed[down].mean()) if down.any() else float("nan")


def hand_speed(joints: FloatArray) -> float:
    """Mean speed of the busier wrist around the pelvis, m/s."""
    wrists = joints[:, [JOINT_INDEX["left_wrist"], JOINT_INDEX["right_wrist"]]] - joints[:, [JOINT_INDEX["pelvis"]]]
    speed = np.linalg.norm(np.diff(wrists.astype(np.float64), axis=0), axis=-1) * FPS
    return float(speed.mean(axis=0).max())


def bone_error(joints: FloatArray, lengths: NDArray[np.float64]) -> float:
    """Mean absolute difference of the bones to `lengths` (21,), millimetres."""
    return float(np.abs(bone_lengths(joints) - lengths).mean() * 1000)
