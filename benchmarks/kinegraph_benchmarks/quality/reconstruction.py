"""What the autoencoders keep of captured motion, per level: GraphMotion's Table D, with recognition and clean movement.

    python -m kinegraph_benchmarks.quality.reconstruction --data DATA/bandai --run runs/edge --out reconstruction.json

No diffusion here: nothing generated can be better than this. Writes JSON, and a Markdown table beside it.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from kinegraph.motion.features import features_from_joints, joints_from_features
from kinegraph_benchmarks.common.evaluator import Evaluator
from kinegraph_benchmarks.common.label_classifier import Recogniser
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.scores import Reference, grouped_r_precision, is_wave, kept_labels, means
from kinegraph_training import metrics
from kinegraph_training.config import LEVELS
from kinegraph_training.data.clips import MotionClip, read_split
from kinegraph_training.latents import TrainedVae, read_vae
from kinegraph_training.metrics import frechet_distance
from kinegraph_training.train_vae import reconstruction_scores
from kinegraph_training.vae_batches import padded

SPLITS = ("val", "dev_test", "dev_compositional")
MIN_FRAMES, MAX_FRAMES = 16, 196


@torch.no_grad()
def reconstructed(trained: TrainedVae, features: NDArray[np.float32]) -> NDArray[np.float32]:
    """(frames, F) features there and back, from the mean of the posterior."""
    rows = ((features - trained.mean) / trained.std).astype(np.float32)
    batch, mask = padded([rows], 2 * trained.vae.config.frames_per_token)
    decoded = trained.vae.decode(trained.vae.encode(batch, mask)[0], mask)[0, : len(rows)].numpy()
    return (decoded * trained.std + trained.mean).astype(np.float32)


def level_scores(
    trained: TrainedVae, clips: Sequence[MotionClip], evaluator: Evaluator, recogniser: Recogniser
) -> dict[str, float]:
    """Numbers of one level on one split."""
    sources = [features_from_joints(clip.joints)[:MAX_FRAMES] for clip in clips]
    results = [reconstructed(trained, rows) for rows in sources]
    errors = [reconstruction_scores(made, rows) for made, rows in zip(results, sources, strict=True)]
    motions, captured = ([joints_from_features(rows) for rows in part] for part in (results, sources))
    embedded, real = evaluator.motions(motions), evaluator.motions(captured)
    texts = evaluator.captions([clip.captions[0] for clip in clips])
    reference = Reference(clips, real)
    hits = grouped_r_precision(texts, embedded, reference.labels, np.random.default_rng(0))
    found = {name: float(np.mean([one[name] for one in errors])) for name in ("local_mm", "global_mm")}
    found["fid"] = frechet_distance(embedded, real)
    found |= {"r_precision_1": float(hits[0]), **means(kept_labels(motions, clips, recogniser))}
    for name, measure in (("jerk", metrics.jerk), ("foot_skate", metrics.foot_skate)):
        made, own = (float(np.nanmean([measure(joints) for joints in part])) for part in (motions, captured))
        found[f"{name}_ratio"] = made / own
    waves = [number for number, clip in enumerate(clips) if is_wave(clip)]
    speeds = [np.mean([metrics.hand_speed(part[number]) for number in waves]) for part in (motions, captured)]
    found["wave_speed_ratio"] = float(speeds[0] / speeds[1])
    return found


def table(result: dict[str, dict[str, dict[str, float]]]) -> str:
    """Markdown."""
    names = list(result[SPLITS[0]][LEVELS[0]])
    lines = ["| split | level | " + " | ".join(names) + " |", "|---|---|" + "---|" * len(names)]
    for split, levels in result.items():
        for level, found in levels.items():
            lines.append(f"| {split} | {level} | " + " | ".join(f"{found[name]:.3g}" for name in names) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of the captured motion (bandai)")
    parser.add_argument("--run", type=Path, required=True, help="training run with the three autoencoders")
    parser.add_argument("--out", type=Path, required=True, help="JSON file; a .md file is written beside it")
    arguments = parser.parse_args()
    # clip by clip, more threads only wait for one another: beside a busy core for minutes
    torch.set_num_threads(1)
    evaluator, recogniser = Evaluator(), Recogniser(read_split(arguments.data, "train"))
    levels = {level: read_vae(arguments.run / f"vae_{level}" / "last.ckpt") for level in LEVELS}
    result = {}
    for split in SPLITS:
        clips = [clip for clip in read_split(arguments.data, split) if len(clip.joints) >= MIN_FRAMES]
        result[split] = {level: level_scores(vae, clips, evaluator, recogniser) for level, vae in levels.items()}
    write_report(arguments.out, result, table(result))


if __name__ == "__main__":
    main()
