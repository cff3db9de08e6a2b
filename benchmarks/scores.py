"""All numbers of one set of motions for the captions of a split; `evaluate.py` says them of generated clips, of the
captured ones, and in comparison."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from behaviours import CONTENTS, RARE
from caption_claims import claims
from evaluator import Evaluator
from numpy.typing import NDArray
from recogniser import Recogniser

from kinegraph_training import measures
from kinegraph_training.compositions import resampled
from kinegraph_training.data import MotionClip
from kinegraph_training.metrics import diversity, frechet_distance, label_groups, matching_distance, r_precision

Joints = NDArray[np.float32]
GROUP = 32
DRAWS = 20
TWIN = 0.02
"""Metres of mean joint distance below which a clip has a near twin in training."""
PREDICATES = {behaviour.content: behaviour.holds for behaviour in CONTENTS + RARE}


@dataclass(frozen=True)
class Judges:
    """What measures; none of it comes from the generator."""

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


def scores(
    motions: Sequence[Joints], captions: Sequence[str], reference: Reference, judges: Judges, rng: np.random.Generator
) -> tuple[dict[str, float], NDArray[np.float32], NDArray[np.float32]]:
    """Numbers of one motion per clip of the reference; also the embeddings (n, e) of motions and of captions."""
    embedded, texts = judges.evaluator.motions(motions), judges.evaluator.captions(captions)
    hits = grouped_r_precision(texts, embedded, reference.labels, rng)
    found = {f"r_precision_{place}": float(hit) for place, hit in enumerate(hits, start=1)}
    found["fid"] = frechet_distance(embedded, reference.embeddings)
    half, other = np.array_split(rng.permutation(len(embedded)), 2)
    # Clips that neither side shares: the same number for captured motion is the floor that it can be compared with.
    found["fid_of_halves"] = frechet_distance(embedded[half], reference.embeddings[other])
    found["mm_dist"] = matching_distance(texts, embedded)
    found["diversity"] = diversity(embedded, rng)
    found |= behaviour_scores(motions, captions, reference.clips) | recognised(
        motions, reference.clips, judges.recogniser
    )
    found["jerk"] = float(np.mean([measures.jerk(joints) for joints in motions]))
    found["foot_skate"] = float(np.nanmean([measures.foot_skate(joints) for joints in motions]))
    waving = [joints for joints, clip in zip(motions, reference.clips, strict=True) if is_wave(clip)]
    if waving:
        found["wave_speed"] = float(np.mean([measures.hand_speed(joints) for joints in waving]))
    found["bone_error_mm"] = float(np.mean([measures.bone_error(joints, judges.bone_lengths) for joints in motions]))
    return found, embedded, texts


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


def behaviour_scores(
    motions: Sequence[Joints], captions: Sequence[str], clips: Sequence[MotionClip]
) -> dict[str, float]:
    """Share of motions that do what their label says, and of the claims of their captions that they keep."""
    held = [
        PREDICATES[clip.content](joints)
        for joints, clip in zip(motions, clips, strict=True)
        if clip.content in PREDICATES
    ]
    kept: dict[str, list[bool]] = {"steps": [], "degrees": [], "height": []}
    for joints, caption in zip(motions, captions, strict=True):
        for claim in claims(caption):
            kept[claim.kind].append(claim.holds(joints))
    found = {f"claims_{kind}": float(np.mean(values)) for kind, values in kept.items() if values}
    return {"behaviour": float(np.mean(held)), **found}


def recognised(motions: Sequence[Joints], clips: Sequence[MotionClip], recogniser: Recogniser) -> dict[str, float]:
    """How often content and style are recognised as those of the caption's clip."""
    found = {}
    for name in ("content", "style"):
        seen = recogniser(motions, name)
        found[name] = float(np.mean([one == getattr(clip, name) for one, clip in zip(seen, clips, strict=True)]))
    return found


def by_pair(motions: Sequence[Joints], reference: Reference, recogniser: Recogniser) -> dict[str, dict[str, float]]:
    """Behaviour and recognition of each content-style pair: where a mean over a split is lost."""
    rows: dict[str, list[int]] = {}
    for row, label in enumerate(reference.labels):
        rows.setdefault(label, []).append(row)
    found = {}
    for pair, own in sorted(rows.items()):
        made, theirs = [motions[row] for row in own], [reference.clips[row] for row in own]
        found[pair] = recognised(made, theirs, recogniser)
        if theirs[0].content in PREDICATES:
            found[pair]["behaviour"] = float(np.mean([PREDICATES[theirs[0].content](joints) for joints in made]))
    return found


def has_twin(clips: Sequence[MotionClip], train: Sequence[MotionClip], frames: int = 32) -> list[bool]:
    """Whether a training clip of the same content and style is nearer than `TWIN`, both resampled to `frames`."""
    known: dict[tuple[str, str], list[Joints]] = {}
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
