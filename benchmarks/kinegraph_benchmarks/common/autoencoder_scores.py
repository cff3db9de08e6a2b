"""Score what a motion autoencoder keeps of captured clips, without any diffusion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from kinegraph.arrays import FloatArray
from kinegraph.motion.features import features_from_joints, joints_from_features
from kinegraph_benchmarks.common.evaluator import Evaluator
from kinegraph_benchmarks.common.label_classifier import LabelClassifier
from kinegraph_benchmarks.common.scores import Reference, grouped_r_precision, is_wave, label_hits, mean_rates
from kinegraph_training import metrics
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.latents import TrainedVae
from kinegraph_training.metrics import frechet_distance, reconstruction_scores
from kinegraph_training.vae_batches import pad_clips

MAX_FRAMES = 196


@torch.no_grad()
def reconstruct(trained: TrainedVae, features: FloatArray) -> FloatArray:
    """Encode features (frames, F) to the mean of the posterior and decode them again."""
    rows = ((features - trained.mean) / trained.std).astype(np.float32)
    batch, mask = pad_clips([rows], 2 * trained.vae.config.frames_per_token)
    decoded = trained.vae.decode(trained.vae.encode(batch, mask)[0], mask)[0, : len(rows)].numpy()
    return (decoded * trained.std + trained.mean).astype(np.float32)


def score_autoencoder(
    trained: TrainedVae, clips: Sequence[MotionClip], evaluator: Evaluator, classifier: LabelClassifier
) -> dict[str, float]:
    """Score the autoencoder of one level on the clips of a split, by metric.

    Joint errors are in millimetres; a name that ends in `_ratio` is the reconstruction's value over the captured one.
    """
    sources = [features_from_joints(clip.joints)[:MAX_FRAMES] for clip in clips]
    results = [reconstruct(trained, features) for features in sources]
    errors = [reconstruction_scores(result, source) for result, source in zip(results, sources, strict=True)]
    motions, captured = ([joints_from_features(features) for features in part] for part in (results, sources))
    embedded, real = evaluator.embed_motions(motions), evaluator.embed_motions(captured)
    texts = evaluator.embed_captions([clip.captions[0] for clip in clips])
    hits = grouped_r_precision(texts, embedded, Reference(clips, real).labels, np.random.default_rng(0))
    scores = {name: float(np.mean([error[name] for error in errors])) for name in ("local_mm", "global_mm")}
    scores["fid"] = frechet_distance(embedded, real)
    scores |= {"r_precision_1": float(hits[0]), **mean_rates(label_hits(motions, clips, classifier))}
    for name, metric in (("jerk", metrics.jerk), ("foot_skate", metrics.foot_skate)):
        ours, theirs = (float(np.nanmean([metric(joints) for joints in part])) for part in (motions, captured))
        scores[f"{name}_ratio"] = ours / theirs
    waves = [number for number, clip in enumerate(clips) if is_wave(clip)]
    speeds = [np.mean([metrics.hand_speed(part[number]) for number in waves]) for part in (motions, captured)]
    scores["wave_speed_ratio"] = float(speeds[0] / speeds[1])
    return scores
