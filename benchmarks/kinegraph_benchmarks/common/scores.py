"""Score a set of motions, one for each captured clip of a split: the papers' metrics, recognition, claims, cleanliness.

Generated motions and the captured ones themselves are scored in the same way and compared by `quality.evaluate`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import FloatArray
from kinegraph_benchmarks.common.behaviour_prompts import ACTIONS, RARE
from kinegraph_benchmarks.common.caption_claims import parse_claims
from kinegraph_benchmarks.common.evaluator import Evaluator
from kinegraph_benchmarks.common.label_classifier import LABELS, LabelClassifier
from kinegraph_training import metrics
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.metrics import (
    distances,
    diversity,
    frechet_distance,
    label_groups,
    matching_distance,
    r_precision,
)
from kinegraph_training.synthetic.compositions import resample_linear

GROUP = 32
"""Captions among which R-precision looks for the right one."""
DRAWS = 20
"""Ways of grouping that R-precision is averaged over."""
TWIN = 0.02
"""Mean joint distance, metres, below which a clip has a near twin in training."""
PREDICATES = {behaviour.action: behaviour.holds for behaviour in ACTIONS + RARE}


@dataclass(frozen=True)
class Judges:
    """Models and measures that score motions; none of them comes from the generator."""

    evaluator: Evaluator
    classifier: LabelClassifier
    bone_lengths: NDArray[np.float64]
    """(21,) metres, mean of the training clips."""


@dataclass(frozen=True)
class Reference:
    """Captured clips of a split, n of them, embedded once."""

    clips: Sequence[MotionClip]
    embeddings: FloatArray
    """(n, e)"""

    @property
    def labels(self) -> list[str]:
        """Action and style of each clip, "action/style"; of one without labels its id, so that it is like no other."""
        return [f"{clip.action}/{clip.style}" if clip.action or clip.style else clip.id for clip in self.clips]


@dataclass(frozen=True)
class MotionScores:
    """Scores of one motion per clip of a reference, n of them."""

    metrics: dict[str, float]
    motion_embeddings: FloatArray
    """(n, e)"""
    caption_embeddings: FloatArray
    """(n, e)"""
    label_hits: dict[str, NDArray[np.float64]]
    """See `label_hits`."""


def score_motions(
    motions: Sequence[FloatArray],
    captions: Sequence[str],
    reference: Reference,
    judges: Judges,
    rng: np.random.Generator,
) -> MotionScores:
    """Score one motion per clip of the reference.

    Args:
        motions: joints (frames, 22, 3) of each, metres, 20 frames per second.
        captions: what each was asked for.
        reference: the captured clips, in the same order.
        judges: see `Judges`.
        rng: draws groups and pairs.
    """
    embedded, texts = judges.evaluator.embed_motions(motions), judges.evaluator.embed_captions(captions)
    hits = grouped_r_precision(texts, embedded, reference.labels, rng)
    values = {f"r_precision_{top}": float(hit) for top, hit in enumerate(hits, start=1)}
    values["fid"] = frechet_distance(embedded, reference.embeddings)
    half, other = np.array_split(rng.permutation(len(embedded)), 2)
    if min(len(half), len(other)) > 1:  # a single clip has no covariance
        # Clips that the two sides do not share: for captured motion this is the floor to compare with.
        values["fid_of_halves"] = frechet_distance(embedded[half], reference.embeddings[other])
    values["mm_dist"] = matching_distance(texts, embedded)
    values["diversity"] = diversity(embedded, rng)
    kept = label_hits(motions, reference.clips, judges.classifier)
    values |= mean_rates(kept) | claim_rates(motions, captions)
    values["jerk"] = float(np.mean([metrics.jerk(joints) for joints in motions]))
    skating = np.array([metrics.foot_skate(joints) for joints in motions])
    if not np.isnan(skating).all():  # some foot stands
        values["foot_skate"] = float(np.nanmean(skating))
    waving = [joints for joints, clip in zip(motions, reference.clips, strict=True) if is_wave(clip)]
    if waving:
        values["wave_speed"] = float(np.mean([metrics.hand_speed(joints) for joints in waving]))
    values["bone_error_mm"] = float(np.mean([metrics.bone_error(joints, judges.bone_lengths) for joints in motions]))
    return MotionScores(values, embedded, texts, kept)


def is_wave(clip: MotionClip) -> bool:
    """Tell whether a clip waves a hand.

    Waving is what a model loses first if it draws the mean of all motions that fit a caption.
    """
    return clip.action.startswith("wave")


def grouped_r_precision(
    texts: FloatArray, motions: FloatArray, labels: Sequence[str], rng: np.random.Generator
) -> NDArray[np.float64]:
    """Compute R-precision in groups of distinct labels.

    Args:
        texts: (n, e) embeddings of captions.
        motions: (n, e) embeddings of motions, in the same order.
        labels: of the clips; a group holds each at most once.
        rng: draws the groups.

    Returns:
        (3,) top 1, 2 and 3, mean over `DRAWS` ways of grouping.
    """
    groups = [rows for _ in range(DRAWS) for rows in label_groups(labels, GROUP, rng)]
    precision: NDArray[np.float64] = np.mean([r_precision(texts[rows], motions[rows]) for rows in groups], axis=0)
    return precision


def caption_hits(
    texts: FloatArray, motions: FloatArray, labels: Sequence[str], rng: np.random.Generator
) -> NDArray[np.float64]:
    """Compute for each motion how often its own caption is the nearest, in groups of distinct labels.

    The other way round than `grouped_r_precision`, and by motion: what a clip looks like most among `GROUP` captions.

    Args:
        texts, motions, labels, rng: see `grouped_r_precision`.

    Returns:
        (n,) shares of `DRAWS` ways of grouping; NaN for a motion that no group held.
    """
    hits, drawn = np.zeros(len(motions)), np.zeros(len(motions))
    for _ in range(DRAWS):
        for rows in label_groups(labels, GROUP, rng):
            table = distances(texts[rows], motions[rows])
            hits[rows] += (table <= np.diag(table)).sum(axis=0) == 1
            drawn[rows] += 1
    with np.errstate(invalid="ignore"):
        return hits / drawn


def claim_rates(motions: Sequence[FloatArray], captions: Sequence[str]) -> dict[str, float]:
    """Compute the share of claims of captions that their motions keep, by kind of claim."""
    kept: dict[str, list[bool]] = {"steps": [], "degrees": [], "height": []}
    for joints, caption in zip(motions, captions, strict=True):
        for claim in parse_claims(caption):
            kept[claim.kind].append(claim.holds(joints))
    return {f"claims_{kind}": float(np.mean(values)) for kind, values in kept.items() if values}


def label_hits(
    motions: Sequence[FloatArray], clips: Sequence[MotionClip], classifier: LabelClassifier
) -> dict[str, NDArray[np.float64]]:
    """Compare what each motion shows with the labels of its clip.

    Returns:
        Per clip (n,) 1 for yes and 0 for no. "behaviour": the predicate of its action holds (nan where there is none);
        "content" and "style": the classifier recognises its action and its style; neither where no clip has a label.
    """
    does = [
        float(PREDICATES[clip.action](joints)) if clip.action in PREDICATES else np.nan
        for joints, clip in zip(motions, clips, strict=True)
    ]
    hits = {"behaviour": np.array(does)}
    for name in ("content", "style"):
        expected = [LABELS[name](clip) for clip in clips]
        if any(expected):
            shown = classifier(motions, name)
            hits[name] = np.array([float(a == b) for a, b in zip(shown, expected, strict=True)])
    return hits


def mean_rates(hits: dict[str, NDArray[np.float64]], rows: Sequence[int] | None = None) -> dict[str, float]:
    """Compute the share of clips that keep each label, over all rows of `label_hits` or some."""
    selected = {name: values if rows is None else values[rows] for name, values in hits.items()}
    return {name: float(np.nanmean(values)) for name, values in selected.items() if not np.isnan(values).all()}


def rates_by_label(hits: dict[str, NDArray[np.float64]], reference: Reference) -> dict[str, dict[str, float]]:
    """Compute `mean_rates` of each pair of action and style, to see where the rates of a split are lost.

    Clips without labels have none.
    """
    rows_of: dict[str, list[int]] = {}
    for row, label in enumerate(reference.labels):
        rows_of.setdefault(label, []).append(row)
    rates = {label: mean_rates(hits, rows) for label, rows in sorted(rows_of.items())}
    return {label: rate for label, rate in rates.items() if rate}


def has_near_twin(clips: Sequence[MotionClip], train: Sequence[MotionClip], frames: int = 32) -> list[bool]:
    """Tell for each clip whether a training clip of the same labels is nearer than `TWIN`, both of `frames` frames."""
    known: dict[tuple[str, str], list[FloatArray]] = {}
    for clip in train:
        known.setdefault((clip.action, clip.style), []).append(resample_linear(clip.joints, frames))
    twins = []
    for clip in clips:
        joints = resample_linear(clip.joints, frames)
        others = known.get((clip.action, clip.style), [])
        twins.append(any(np.linalg.norm(joints - other, axis=-1).mean() < TWIN for other in others))
    return twins


def average_repeats(rows: Sequence[dict[str, float]]) -> dict[str, dict[str, float]]:
    """Average metrics over repeats.

    Args:
        rows: metrics of each repeat by name; a name may be missing in some.

    Returns:
        By name "mean" and "plus_minus", 1.96 standard errors, as the papers print them.
    """
    averages: dict[str, dict[str, Any]] = {}
    for name in dict.fromkeys(name for row in rows for name in row):
        values = np.array([row[name] for row in rows if name in row])
        interval = float(1.96 * values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0
        averages[name] = {"mean": float(values.mean()), "plus_minus": interval}
    return averages
