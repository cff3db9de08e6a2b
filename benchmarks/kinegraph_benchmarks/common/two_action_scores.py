"""Score motions that hold two actions, in the way of EnergyMoGen (section 5.1) and STMC.

Each action's own part of the motion (its crop) is judged beside that action's caption and captured clip.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.motion.skeleton import facing_angle
from kinegraph_benchmarks.common.evaluator import Evaluator
from kinegraph_benchmarks.common.scores import grouped_r_precision
from kinegraph_benchmarks.common.two_action_set import TwoActionClip
from kinegraph_training import metrics
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.metrics import frechet_distance
from kinegraph_training.synthetic.compositions import BLEND, rotate_about_y


def as_motion_clips(items: Sequence[TwoActionClip]) -> list[MotionClip]:
    """Convert items to clips with one caption each, which a model can be asked for."""
    return [
        MotionClip(f"{item.kind}_{row}", item.joints, (item.caption,), item.actions, item.style)
        for row, item in enumerate(items)
    ]


def tmr_score(a: FloatArray, b: FloatArray) -> float:
    """Compute the TMR score: mean cosine of matching unit vectors (n, e), moved from -1..1 to 0..1."""
    return float((1.0 + (a * b).sum(axis=1)).mean() / 2.0)


def transition_distance(joints: FloatArray, cut: int | None) -> float:
    """Measure the mean distance of the joints between consecutive frames, metres (TEACH, transition distance).

    Every frame is placed at the origin and turned to face +Z first, so that travelling and turning do not count.

    Args:
        joints: (frames, 22, 3).
        cut: frame around which to measure, `BLEND` frames to each side; None for the whole motion.
    """
    local = rotate_about_y(joints - joints[:, :1], -facing_angle(joints))
    change = np.linalg.norm(np.diff(local, axis=0), axis=-1).mean(axis=1)
    return float(change[max(cut - BLEND, 0) : cut + BLEND].mean() if cut is not None else change.mean())


def score_two_actions(
    items: Sequence[TwoActionClip], motions: Sequence[FloatArray], evaluator: Evaluator, rng: np.random.Generator
) -> dict[str, float]:
    """Score one motion (frames, 22, 3) per item, of the item's length."""
    crops = [crop for item, joints in zip(items, motions, strict=True) for crop in item.crops(joints)]
    labels = [f"{action}/{item.style}" for item in items for action in item.actions]
    embedded = evaluator.embed_motions(crops)
    texts = evaluator.embed_captions([text for item in items for text in item.texts])
    parts = evaluator.embed_motions([part for item in items for part in item.parts])
    hits = grouped_r_precision(texts, embedded, labels, rng)
    whole, captured = (evaluator.embed_motions(clips) for clips in (motions, [item.joints for item in items]))
    pairs = list(zip(items, motions, strict=True))
    cuts = [item.cut if item.kind == "in_order" else None for item in items]
    return {
        "both_hold": float(np.mean([item.holds(joints) for item, joints in pairs])),
        "crop_r_precision_1": float(hits[0]),
        "crop_r_precision_3": float(hits[2]),
        "motion_text_score": tmr_score(embedded, texts),
        "motion_motion_score": tmr_score(embedded, parts),
        "fid": frechet_distance(whole, captured),
        "transition_distance": float(np.mean([transition_distance(m, c) for m, c in zip(motions, cuts, strict=True)])),
        "jerk": float(np.mean([metrics.jerk(joints) for joints in motions])),
        "foot_skate": float(np.nanmean([metrics.foot_skate(joints) for joints in motions])),
    }


def rates_by_training(items: Sequence[TwoActionClip], motions: Sequence[FloatArray]) -> dict[str, Any]:
    """Compute `both_hold` apart for pairs of actions that training joins and for those that it never does."""
    rates = {}
    for name, held_out in (("joined_in_training", False), ("held_out", True)):
        holds = [item.holds(joints) for item, joints in zip(items, motions, strict=True) if item.held_out == held_out]
        rates[name] = {"clips": len(holds), "both_hold": float(np.mean(holds)) if holds else None}
    return rates
