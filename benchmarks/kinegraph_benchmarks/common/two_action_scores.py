"""Numbers of motions that hold two actions, as EnergyMoGen (section 5.1) and STMC take them: each action's own part of
the motion is judged beside that action's caption and captured clip."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from kinegraph.arrays import FloatArray
from numpy.typing import NDArray

from kinegraph.motion.skeleton import facing_angle
from kinegraph_benchmarks.common.scores import Judges, grouped_r_precision
from kinegraph_benchmarks.common.two_action_set import Composed
from kinegraph_training import metrics
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.metrics import frechet_distance
from kinegraph_training.synthetic.compositions import BLEND, rotated_y


def as_clips(items: Sequence[Composed]) -> list[MotionClip]:
    """What a model is asked for."""
    return [
        MotionClip(f"{one.kind}_{row}", one.joints, (one.caption,), "+".join(one.contents), one.style)
        for row, one in enumerate(items)
    ]


def score(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    """TMR score: mean cosine of matching unit vectors (n, e), moved to 0..1."""
    return float((1.0 + (a * b).sum(axis=1)).mean() / 2.0)


def transition_distance(joints: FloatArray, cut: int | None) -> float:
    """Mean distance of the joints between consecutive frames, metres, each frame placed at the origin and facing +Z;
    within `BLEND` frames of the cut, or over the whole motion (TEACH)."""
    local = rotated_y(joints - joints[:, :1], -facing_angle(joints))
    change = np.linalg.norm(np.diff(local, axis=0), axis=-1).mean(axis=1)
    return float(change[max(cut - BLEND, 0) : cut + BLEND].mean() if cut is not None else change.mean())


def composed_scores(
    items: Sequence[Composed], motions: Sequence[FloatArray], judges: Judges, rng: np.random.Generator
) -> dict[str, float]:
    """Of one motion per item, as long as it."""
    crops = [crop for one, joints in zip(items, motions, strict=True) for crop in one.crops(joints)]
    labels = [f"{content}/{one.style}" for one in items for content in one.contents]
    embedded = judges.evaluator.motions(crops)
    texts = judges.evaluator.captions([text for one in items for text in one.texts])
    parts = judges.evaluator.motions([part for one in items for part in one.parts])
    hits = grouped_r_precision(texts, embedded, labels, rng)
    whole, captured = (judges.evaluator.motions(one) for one in (motions, [item.joints for item in items]))
    pairs = list(zip(items, motions, strict=True))
    cuts = [one.cut if one.kind == "in_order" else None for one in items]
    return {
        "both_hold": float(np.mean([one.holds(joints) for one, joints in pairs])),
        "crop_r_precision_1": float(hits[0]),
        "crop_r_precision_3": float(hits[2]),
        "motion_text_score": score(embedded, texts),
        "motion_motion_score": score(embedded, parts),
        "fid": frechet_distance(whole, captured),
        "transition_distance": float(np.mean([transition_distance(m, c) for m, c in zip(motions, cuts, strict=True)])),
        "jerk": float(np.mean([metrics.jerk(joints) for joints in motions])),
        "foot_skate": float(np.nanmean([metrics.foot_skate(joints) for joints in motions])),
    }


def by_training(items: Sequence[Composed], motions: Sequence[FloatArray]) -> dict[str, Any]:
    """`both_hold` apart for pairs of actions that training joins and for those it never does."""
    found = {}
    for name, held in (("joined_in_training", False), ("held_out", True)):
        holds = [one.holds(joints) for one, joints in zip(items, motions, strict=True) if one.held_out == held]
        found[name] = {"clips": len(holds), "both_hold": float(np.mean(holds)) if holds else None}
    return found
