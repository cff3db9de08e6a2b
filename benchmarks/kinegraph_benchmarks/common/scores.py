"""All numbers of one set of motions for the captions of a split; `evaluate.py` says them of generated clips, of the
captured ones, and in comparison."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from kinegraph.arrays import FloatArray
from numpy.typing import NDArray

from kinegraph_benchmarks.common.behaviour_prompts import CONTENTS, RARE
from kinegraph_benchmarks.common.caption_claims import claims
from kinegraph_benchmarks.common.evaluator import Evaluator
from kinegraph_benchmarks.common.label_classifier import Recogniser
from kinegraph_training import metrics
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.metrics import diversity, frechet_distance, label_groups, matching_distance, r_precision
from kinegraph_training.synthetic.compositions import resampled

GROUP = 32
DRAWS = 20
TWIN = 0.02
"""Metres of mean joint distance below which a clip has a near twin in training."""
PREDICATES = {behaviour.content: behaviour.holds for behaviour in CONTENTS + RARE}


@dataclass(frozen=True)
class Judges:
    """What metrics; none of it comes from the generator."""

    evaluator: Evaluator
    recogniser: Recogniser
    bone_lengths: NDArray[np.float64]


@dataclass(frozen=True)
class Reference:
    """The captured clips of a split, embedded once."""

    clips: Sequence[MotionClip]
    embeddings: NDArray[np.float32]

    @property
    def labels(self) -> list[str]:
        """Content-style pair of each clip."""
        return [f"{clip.content}/{clip.style}" for clip in self.clips]


@dataclass(frozen=True)
class Scored:
    """One motion per clip of a reference, n of them."""

    numbers: dict[str, float]
    embeddings: NDArray[np.float32]
    """(n, e) of the motions."""
    texts: NDArray[np.float32]
    """(n, e) of the captions."""
    kept: dict[str, NDArray[np.float64]]
    """See `kept_labels`."""


def scores(
    motions: Sequence[FloatArray],
    captions: Sequence[str],
    reference: Reference,
    judges: Judges,
    rng: np.random.Generator,
) -> Scored:
    """All numbers of one motion per clip of the reference."""
    embedded, texts = judges.evaluator.motions(motions), judges.evaluator.captions(captions)
    hits = grouped_r_precision(texts, embedded, reference.labels, rng)
    found = {f"r_precision_{place}": float(hit) for place, hit in enumerate(hits, start=1)}
    found["fid"] = frechet_distance(embedded, reference.embeddings)
    half, other = np.array_split(rng.permutation(len(embedded)), 2)
    # Clips that neither side shares: the same number for captured motion is the floor that it can be compared with.
    found["fid_of_halves"] = frechet_distance(embedded[half], reference.embeddings[other])
    found["mm_dist"] = matching_distance(texts, embedded)
    found["diversity"] = diversity(embedded, rng)
    kept = kept_labels(motions, reference.clips, judges.recogniser)
    found |= means(kept) | claims_kept(motions, captions)
    found["jerk"] = float(np.mean([metrics.jerk(joints) for joints in motions]))
    found["foot_skate"] = float(np.nanmean([metrics.foot_skate(joints) for joints in motions]))
    waving = [joints for joints, clip in zip(motions, reference.clips, strict=True) if is_wave(clip)]
    if waving:
        found["wave_speed"] = float(np.mean([metrics.hand_speed(joints) for joints in waving]))
    found["bone_error_mm"] = float(np.mean([metrics.bone_error(joints, judges.bone_lengths) for joints in motions]))
    return Scored(found, embedded, texts, kept)


def is_wave(clip: MotionClip) -> bool:
    """Whether the clip waves a hand: what a model that draws the mean of all that may happen loses first."""
    return clip.content.startswith("wave")


def grouped_r_precision(
    texts: NDArray[np.float32], motions: NDArray[np.float32], labels: Sequence[str], rng: np.random.Generator
) -> NDArray[np.float64]:
    """R-precision top 1, 2, 3 in groups of distinct labels, mean over `DRAWS` ways to group: (3,)."""
    groups = [rows for _ in range(DRAWS) for rows in label_groups(labels, GROUP, rng)]
    found: NDArray[np.float64] = np.mean([r_precision(texts[rows], motions[rows]) for rows in groups], axis=0)
    return found


def claims_kept(motions: Sequence[FloatArray], captions: Sequence[str]) -> dict[str, float]:
    """Share of the claims of captions that their motions keep."""
    kept: dict[str, list[bool]] = {"steps": [], "degrees": [], "height": []}
    for joints, caption in zip(motions, captions, strict=True):
        for claim in claims(caption):
            kept[claim.kind].append(claim.holds(joints))
    return {f"claims_{kind}": float(np.mean(values)) for kind, values in kept.items() if values}


def kept_labels(
    motions: Sequence[FloatArray], clips: Sequence[MotionClip], recogniser: Recogniser
) -> dict[str, NDArray[np.float64]]:
    """Per clip (n,) 1 where its motion does what its content says (nan: no predicate says) and where its content and
    its style are recognised, else 0."""
    does = [
        float(PREDICATES[clip.content](joints)) if clip.content in PREDICATES else np.nan
        for joints, clip in zip(motions, clips, strict=True)
    ]
    found = {"behaviour": np.array(does)}
    for name in ("content", "style"):
        seen = recogniser(motions, name)
        found[name] = np.array([float(one == getattr(clip, name)) for one, clip in zip(seen, clips, strict=True)])
    return found


def means(kept: dict[str, NDArray[np.float64]], rows: Sequence[int] | None = None) -> dict[str, float]:
    """Share of clips that keep each label, of all or of some rows."""
    some = {name: values if rows is None else values[rows] for name, values in kept.items()}
    return {name: float(np.nanmean(values)) for name, values in some.items() if not np.isnan(values).all()}


def by_pair(kept: dict[str, NDArray[np.float64]], reference: Reference) -> dict[str, dict[str, float]]:
    """`means` of each content-style pair: where that of a split is lost."""
    rows: dict[str, list[int]] = {}
    for row, label in enumerate(reference.labels):
        rows.setdefault(label, []).append(row)
    return {pair: means(kept, own) for pair, own in sorted(rows.items())}


def has_twin(clips: Sequence[MotionClip], train: Sequence[MotionClip], frames: int = 32) -> list[bool]:
    """Whether a training clip of the same content and style is nearer than `TWIN`, both resampled to `frames`."""
    known: dict[tuple[str, str], list[FloatArray]] = {}
    for clip in train:
        known.setdefault((clip.content, clip.style), []).append(resampled(clip.joints, frames))
    found = []
    for clip in clips:
        own = resampled(clip.joints, frames)
        others = known.get((clip.content, clip.style), [])
        found.append(any(np.linalg.norm(own - other, axis=-1).mean() < TWIN for other in others))
    return found


def summarised(rows: Sequence[dict[str, float]]) -> dict[str, dict[str, float]]:
    """Mean over repeats, with 1.96 standard errors as the papers print it."""
    found: dict[str, dict[str, Any]] = {}
    for name in dict.fromkeys(name for row in rows for name in row):
        values = np.array([row[name] for row in rows if name in row])
        spread = float(1.96 * values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0
        found[name] = {"mean": float(values.mean()), "plus_minus": spread}
    return found
