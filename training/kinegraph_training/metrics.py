"""Metrics in numpy: the papers' metrics on embeddings of captions and motions, and measures of how clean a motion is.

The papers' metrics follow Guo et al. (2022), which both papers evaluate with, and GraphMotion's supplement E. Distances
are Euclidean; n clips, e width of an embedding. Measures of a motion take joints (frames, 22, 3) in metres at `FPS`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import FloatArray
from kinegraph.motion.skeleton import FEET, JOINT_INDEX, bone_lengths
from kinegraph_training.layouts import layout_of

Embeddings = NDArray[np.floating]

FPS = 20
GROUND_HEIGHT = 0.05
"""Metres: a toe below this height stands on the floor."""


def distances(a: Embeddings, b: Embeddings) -> NDArray[np.float64]:
    """Compute all distances between two sets: (n, e), (m, e) -> (n, m)."""
    difference = np.asarray(a, dtype=np.float64)[:, None] - np.asarray(b, dtype=np.float64)[None]
    return np.asarray(np.linalg.norm(difference, axis=-1))


def r_precision(texts: Embeddings, motions: Embeddings, top: int = 3) -> NDArray[np.float64]:
    """Compute the share of texts whose own motion is among the nearest 1, 2, ... `top` motions.

    A motion that is exactly as near as the right one counts against it, so that a model that answers everything alike
    scores 0.

    Args:
        texts: (n, e).
        motions: (n, e); row i belongs to text i.
        top: largest rank that is reported.

    Returns:
        (top,) R@1, R@2, ...
    """
    table = distances(texts, motions)
    matching = np.diag(table)[:, None]
    rank = (table <= matching).sum(axis=1) - 1
    return np.array([(rank < k).mean() for k in range(1, top + 1)])


def label_groups(labels: Sequence[str], size: int, rng: np.random.Generator) -> list[NDArray[np.int64]]:
    """Divide rows into groups of `size` distinct labels, one row per label.

    Every row is used about once: rows are dealt from shuffled piles, one per label, until too few piles are left for a
    group. With fewer than `size` labels, groups hold all of them.
    """
    piles: dict[str, list[int]] = {}
    for row in rng.permutation(len(labels)):
        piles.setdefault(labels[row], []).append(int(row))
    size = min(size, len(piles))
    groups = []
    while True:
        left = [name for name in piles if piles[name]]
        if len(left) < size:
            return groups
        # The longest piles first, ties in random order: otherwise rows of frequent labels are left over.
        order = sorted(left, key=lambda name: (-len(piles[name]), rng.random()))
        groups.append(np.array([piles[name].pop() for name in order[:size]], dtype=np.int64))


def matching_distance(texts: Embeddings, motions: Embeddings) -> float:
    """Compute MM-Dist: the mean distance of each motion to its own text."""
    return float(np.linalg.norm(np.asarray(texts) - np.asarray(motions), axis=-1).mean())


def gaussian_frechet(
    mean_a: NDArray[np.float64], cov_a: NDArray[np.float64], mean_b: NDArray[np.float64], cov_b: NDArray[np.float64]
) -> float:
    """Compute |m_a - m_b|^2 + tr(C_a + C_b - 2 (C_a C_b)^1/2) of two Gaussians.

    Args:
        mean_a: m_a, (e,).
        cov_a: C_a, (e, e).
        mean_b: m_b, (e,).
        cov_b: C_b, (e, e).
    """
    values, vectors = np.linalg.eigh(cov_a)
    root = vectors * np.sqrt(values.clip(min=0.0)) @ vectors.T
    # tr (C_a C_b)^1/2 = tr (R C_b R)^1/2 with R = C_a^1/2, which is symmetric
    cross = np.sqrt(np.linalg.eigvalsh(root @ cov_b @ root).clip(min=0.0)).sum()
    # Rounding may leave the result slightly below 0.
    return max(0.0, float(((mean_a - mean_b) ** 2).sum() + np.trace(cov_a) + np.trace(cov_b) - 2.0 * cross))


def frechet_distance(a: Embeddings, b: Embeddings) -> float:
    """Compute the FID of two sets (n, e) and (m, e)."""
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    return gaussian_frechet(a.mean(axis=0), np.cov(a, rowvar=False), b.mean(axis=0), np.cov(b, rowvar=False))


def diversity(motions: Embeddings, rng: np.random.Generator, pairs: int = 300) -> float:
    """Compute the mean distance of motions in random disjoint pairs, at most n // 2 of them."""
    order = rng.permutation(len(motions))
    count = min(pairs, len(motions) // 2)
    first, second = motions[order[:count]], motions[order[count : 2 * count]]
    return float(np.linalg.norm(np.asarray(first) - np.asarray(second), axis=-1).mean())


def multimodality(takes: Embeddings, rng: np.random.Generator, pairs: int = 10) -> float:
    """Compute the mean distance between takes (captions, takes per caption, e) of the same caption."""
    means = []
    for motions in np.asarray(takes):
        order = rng.permutation(len(motions))
        count = min(pairs, len(motions) // 2)
        difference = motions[order[:count]] - motions[order[count : 2 * count]]
        means.append(np.linalg.norm(difference, axis=-1).mean())
    return float(np.mean(means))


def bootstrap(
    statistic: Callable[[NDArray[np.int64]], float], count: int, rng: np.random.Generator, draws: int = 200
) -> tuple[float, float]:
    """Estimate the 95 % percentile interval of a statistic by resampling.

    Args:
        statistic: of an array of row numbers.
        count: rows; each draw takes as many with replacement.
        rng: of the draws.
        draws: values of the statistic that the interval is taken from.
    """
    values = [statistic(rng.integers(0, count, count)) for _ in range(draws)]
    low, high = np.percentile(values, [2.5, 97.5])
    return float(low), float(high)


def jerk(joints: FloatArray) -> float:
    """Compute the mean length of the third derivative of the joints' positions, m/s^3."""
    third = np.diff(joints.astype(np.float64), n=3, axis=0) * FPS**3
    return float(np.linalg.norm(third, axis=-1).mean())


def foot_skate(joints: FloatArray) -> float:
    """Compute the mean horizontal speed of the toes while they are on the floor, m/s; NaN if they never are."""
    toes = joints[:, [JOINT_INDEX["left_foot"], JOINT_INDEX["right_foot"]]].astype(np.float64)
    speed = np.linalg.norm(np.diff(toes[..., [0, 2]], axis=0), axis=-1) * FPS
    down = np.maximum(toes[1:, :, 1], toes[:-1, :, 1]) < GROUND_HEIGHT
    return float(speed[down].mean()) if down.any() else float("nan")


def hand_speed(joints: FloatArray) -> float:
    """Compute the mean speed of the faster wrist relative to the pelvis, m/s."""
    wrists = joints[:, [JOINT_INDEX["left_wrist"], JOINT_INDEX["right_wrist"]]] - joints[:, [JOINT_INDEX["pelvis"]]]
    speed = np.linalg.norm(np.diff(wrists.astype(np.float64), axis=0), axis=-1) * FPS
    return float(speed.mean(axis=0).max())


def bone_error(joints: FloatArray, lengths: NDArray[np.float64]) -> float:
    """Compute the mean absolute difference of the bones to `lengths` (21,), in millimetres."""
    return float(np.abs(bone_lengths(joints) - lengths).mean() * 1000)


def reconstruction_scores(predicted: FloatArray, target: FloatArray) -> dict[str, float]:
    """Compare a decoded clip with its source.

    These are the scores of learning curves. Their skate is that of all ankles and toes that are low in the later frame,
    0 if none are; benchmarks measure `foot_skate`, of toes that are low in both frames.

    Args:
        predicted: features (frames, width) of any layout, not normalised.
        target: as predicted.

    Returns:
        `local_mm` and `global_mm`: mean joint error with the root held and with it; `jerk` in m/s^3 and `skate` in m/s
        of the decoded clip.
    """
    in_place = [rows.copy() for rows in (predicted, target)]
    for rows in in_place:
        rows[:, :3] = 0.0
    to_joints = layout_of(predicted.shape[1]).to_joints
    local = [to_joints(rows) for rows in in_place]
    world = [to_joints(rows) for rows in (predicted, target)]
    feet = list(FEET)
    speed = np.linalg.norm(np.diff(world[0][:, feet][..., [0, 2]], axis=0), axis=-1) * FPS
    low = world[0][1:, feet, 1] < GROUND_HEIGHT
    return {
        "local_mm": 1000 * float(np.linalg.norm(local[0] - local[1], axis=-1).mean()),
        "global_mm": 1000 * float(np.linalg.norm(world[0] - world[1], axis=-1).mean()),
        "jerk": float(np.linalg.norm(np.diff(world[0], n=3, axis=0), axis=-1).mean()) * FPS**3,
        "skate": float(speed[low].mean()) if low.any() else 0.0,
    }
