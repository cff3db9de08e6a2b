"""Do generated clips do what their caption says? Counted beside captured clips of the same label.

    python -m kinegraph_benchmarks.quality.behaviour --data DATA/bandai --out behaviour.json

Every prompt of `behaviours.py` is generated with the same seeds, as long as the median captured clip of its label. A
class passes at half the captured rate or more, all gated classes together at 0.9 of it on average.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph import KinegraphError, MotionPipeline
from kinegraph.motion.skeleton import bone_lengths
from kinegraph_benchmarks.common.behaviour_prompts import BEHAVIOURS, Behaviour
from kinegraph_training import metrics
from kinegraph_training.data.clips import MotionClip, read_split

SPLITS = ("train", "val", "dev_test")


def captured(clips: list[MotionClip], behaviour: Behaviour) -> list[MotionClip]:
    """Captured clips of the behaviour's label."""
    return [clip for clip in clips if clip.content == behaviour.content and behaviour.style in (None, clip.style)]


def generate(
    pipe: MotionPipeline, behaviour: Behaviour, seconds: float, seeds: int
) -> list[tuple[str, int, np.ndarray]]:
    """(prompt, seed, joints) of every prompt and seed."""
    return [
        (prompt, seed, pipe.generate(prompt, seconds=seconds, seed=seed).joints)
        for prompt in behaviour.prompts
        for seed in range(seeds)
    ]


def cleanliness(motions: list[np.ndarray], lengths: np.ndarray) -> dict[str, float]:
    """Means over clips."""
    return {
        "jerk_m_s3": float(np.mean([metrics.jerk(joints) for joints in motions])),
        "foot_skate_m_s": float(np.nanmean([metrics.foot_skate(joints) for joints in motions])),
        "bone_error_mm": float(np.mean([metrics.bone_error(joints, lengths) for joints in motions])),
    }


def measure(
    pipe: MotionPipeline, behaviour: Behaviour, clips: list[MotionClip], seeds: int, lengths: np.ndarray
) -> dict[str, Any]:
    """One row of the table."""
    real = captured(clips, behaviour)
    shortest, longest = pipe.manifest.seconds_limits
    median = float(np.median([len(clip.joints) for clip in real])) / pipe.manifest.fps
    seconds = min(max(median, shortest), longest)
    made = generate(pipe, behaviour, seconds, seeds)
    held = [behaviour.holds(joints) for _, _, joints in made]
    real_rate = float(np.mean([behaviour.holds(clip.joints) for clip in real]))
    rate = float(np.mean(held))
    return {
        "name": behaviour.name,
        "gated": behaviour.gated,
        "style": behaviour.style,
        "seconds": seconds,
        "captured_clips": len(real),
        "captured_rate": real_rate,
        "generated_clips": len(made),
        "generated_rate": rate,
        # At most 1: being better than the captured clips at one class makes up for no other.
        "ratio": min(rate / real_rate, 1.0) if real_rate else None,
        "captured": cleanliness([clip.joints for clip in real], lengths),
        "generated": cleanliness([joints for _, _, joints in made], lengths),
        "failed": [
            {"prompt": prompt, "seed": seed} for (prompt, seed, _), ok in zip(made, held, strict=True) if not ok
        ],
    }


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Means over the gated classes, each weighing the same, and whether they pass."""
    gated = [row for row in rows if row["gated"]]
    ratios = [row["ratio"] for row in gated]

    def mean(side: str) -> dict[str, float]:
        return {name: float(np.mean([row[side][name] for row in gated])) for name in gated[0][side]}

    return {
        "classes": len(gated),
        "captured_rate": float(np.mean([row["captured_rate"] for row in gated])),
        "generated_rate": float(np.mean([row["generated_rate"] for row in gated])),
        "mean_ratio": float(np.mean(ratios)),
        "lowest_ratio": float(min(ratios)),
        "passes": bool(np.mean(ratios) >= 0.9 and min(ratios) >= 0.5),
        "captured": mean("captured"),
        "generated": mean("generated"),
    }


def table(rows: list[dict[str, Any]], total: dict[str, Any]) -> str:
    """Markdown."""
    lines = ["| behaviour | captured | generated | ratio | jerk | skate | bones |", "|---|---|---|---|---|---|---|"]
    for row in rows:
        note = "" if row["gated"] else " (reported only)"
        ratio = "-" if row["ratio"] is None else f"{row['ratio']:.2f}"
        lines.append(
            f"| {row['name']}{note} | {row['captured_rate']:.2f} of {row['captured_clips']}"
            f" | {row['generated_rate']:.2f} of {row['generated_clips']} | {ratio} | {_pairs(row)} |"
        )
    lines.append(
        f"| **gated classes, mean** | {total['captured_rate']:.2f} | {total['generated_rate']:.2f}"
        f" | {total['mean_ratio']:.2f} (lowest {total['lowest_ratio']:.2f}) | {_pairs(total)} |"
    )
    lines.append("\nJerk in m/s^3, skating of standing toes in m/s, bone-length error in mm: generated (captured).")
    return "\n".join(lines)


def _pairs(row: dict[str, Any]) -> str:
    made, real = row["generated"], row["captured"]
    return " | ".join(
        f"{made[name]:.{digits}f} ({real[name]:.{digits}f})"
        for name, digits in (("jerk_m_s3", 0), ("foot_skate_m_s", 2), ("bone_error_mm", 1))
    )


def main() -> int:
    """0: passes; 1: does not; 2: wrong input."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of the captured motion (bandai)")
    parser.add_argument("--bundle", type=Path, help="folder of a bundle; the default bundle without it")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--out", type=Path, help="write everything as JSON")
    options = parser.parse_args()
    try:
        pipe = MotionPipeline.load(options.bundle)
        clips = [clip for split in SPLITS for clip in read_split(options.data, split)]
        lengths = np.mean([bone_lengths(clip.joints).mean(0) for clip in clips], axis=0)
        rows = []
        for behaviour in BEHAVIOURS:
            rows.append(measure(pipe, behaviour, clips, options.seeds, lengths))
            print(f"{behaviour.name}: {rows[-1]['generated_rate']:.2f}", file=sys.stderr)
    except KinegraphError as error:
        print(f"behaviour: error: {error}", file=sys.stderr)
        return 2
    total = summary(rows)
    print(table(rows, total))
    if options.out:
        bundle = f"{pipe.manifest.name} {pipe.manifest.version}"
        result = {"bundle": bundle, "seeds": options.seeds, "summary": total, "behaviours": rows}
        options.out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return 0 if total["passes"] else 1


if __name__ == "__main__":
    sys.exit(main())
