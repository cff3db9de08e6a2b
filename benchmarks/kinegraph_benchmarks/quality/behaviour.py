"""Measure how often generated clips do what their caption says, beside captured clips of the same label.

    python -m kinegraph_benchmarks.quality.behaviour --data DATA/bandai --out behaviour.json

Every prompt of `common.behaviour_prompts` is generated with the same seeds, as long as the median captured clip of its
label. A class passes at half the captured rate or more, all gated classes together at 0.9 of it on average.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinegraph import KinegraphError, MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph.motion.skeleton import bone_lengths
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.behaviour_prompts import BEHAVIOURS, Behaviour
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_training import metrics
from kinegraph_training.data.clips import MotionClip, read_split

SPLITS = ("train", "val", "dev_test")


def captured_clips(clips: list[MotionClip], behaviour: Behaviour) -> list[MotionClip]:
    """Select the captured clips of a behaviour's label."""
    return [clip for clip in clips if clip.action == behaviour.action and behaviour.style in (None, clip.style)]


def median_seconds(pipe: MotionPipeline, clips: list[MotionClip]) -> float:
    """Compute the median length of clips in seconds, limited to what the bundle can generate."""
    shortest, longest = pipe.manifest.seconds_limits
    median = float(np.median([len(clip.joints) for clip in clips])) / pipe.manifest.fps
    return min(max(median, shortest), longest)


def generate_clips(
    pipe: MotionPipeline, behaviour: Behaviour, seconds: float, seeds: int
) -> list[tuple[str, int, FloatArray]]:
    """Generate every prompt with every seed: (prompt, seed, joints)."""
    return [
        (prompt, seed, pipe.generate(prompt, seconds=seconds, seed=seed).joints)
        for prompt in behaviour.prompts
        for seed in range(seeds)
    ]


def motion_quality(motions: list[FloatArray], lengths: NDArray[np.float64]) -> dict[str, float]:
    """Average jerk, foot skate and bone error over clips.

    Args:
        motions: joints (frames, 22, 3) of each clip.
        lengths: (21,) bone lengths to compare with, metres.
    """
    return {
        "jerk_m_s3": float(np.mean([metrics.jerk(joints) for joints in motions])),
        "foot_skate_m_s": float(np.nanmean([metrics.foot_skate(joints) for joints in motions])),
        "bone_error_mm": float(np.mean([metrics.bone_error(joints, lengths) for joints in motions])),
    }


def measure_behaviour(
    pipe: MotionPipeline, behaviour: Behaviour, clips: list[MotionClip], seeds: int, lengths: NDArray[np.float64]
) -> dict[str, Any]:
    """Measure one behaviour: one row of the table."""
    real = captured_clips(clips, behaviour)
    seconds = median_seconds(pipe, real)
    generated = generate_clips(pipe, behaviour, seconds, seeds)
    held = [behaviour.holds(joints) for _, _, joints in generated]
    real_rate = float(np.mean([behaviour.holds(clip.joints) for clip in real]))
    rate = float(np.mean(held))
    return {
        "name": behaviour.name,
        "gated": behaviour.gated,
        "style": behaviour.style,
        "seconds": seconds,
        "captured_clips": len(real),
        "captured_rate": real_rate,
        "generated_clips": len(generated),
        "generated_rate": rate,
        # At most 1: being better than the captured clips at one class does not make up for another.
        "ratio": min(rate / real_rate, 1.0) if real_rate else None,
        "captured": motion_quality([clip.joints for clip in real], lengths),
        "generated": motion_quality([joints for _, _, joints in generated], lengths),
        "failed": [
            {"prompt": prompt, "seed": seed} for (prompt, seed, _), ok in zip(generated, held, strict=True) if not ok
        ],
    }


def summarise(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Average the gated classes, each weighing the same, and decide whether they pass."""
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


def markdown_table(rows: list[dict[str, Any]], total: dict[str, Any]) -> str:
    """Format rows and their summary as Markdown."""
    lines = ["| behaviour | captured | generated | ratio | jerk | skate | bones |", "|---|---|---|---|---|---|---|"]
    for row in rows:
        note = "" if row["gated"] else " (reported only)"
        ratio = "-" if row["ratio"] is None else f"{row['ratio']:.2f}"
        lines.append(
            f"| {row['name']}{note} | {row['captured_rate']:.2f} of {row['captured_clips']}"
            f" | {row['generated_rate']:.2f} of {row['generated_clips']} | {ratio} | {_quality_cells(row)} |"
        )
    lines.append(
        f"| **gated classes, mean** | {total['captured_rate']:.2f} | {total['generated_rate']:.2f}"
        f" | {total['mean_ratio']:.2f} (lowest {total['lowest_ratio']:.2f}) | {_quality_cells(total)} |"
    )
    lines.append("\nJerk in m/s^3, skating of standing toes in m/s, bone-length error in mm: generated (captured).")
    return "\n".join(lines)


def _quality_cells(row: dict[str, Any]) -> str:
    """Format jerk, foot skate and bone error: generated (captured)."""
    ours, real = row["generated"], row["captured"]
    return " | ".join(
        f"{ours[name]:.{digits}f} ({real[name]:.{digits}f})"
        for name, digits in (("jerk_m_s3", 0), ("foot_skate_m_s", 2), ("bone_error_mm", 1))
    )


def main() -> int:
    """Run the command line: 0 if the classes pass, 1 if they do not, 2 for wrong input."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "data", "bundle", "out", optional=("out",), seeds=10)
    options = parser.parse_args()
    try:
        pipe = MotionPipeline.load(options.bundle)
        clips = [clip for split in SPLITS for clip in read_split(options.data, split)]
        lengths = np.mean([bone_lengths(clip.joints).mean(0) for clip in clips], axis=0)
        rows = []
        for behaviour in BEHAVIOURS:
            rows.append(measure_behaviour(pipe, behaviour, clips, options.seeds, lengths))
            print(f"{behaviour.name}: {rows[-1]['generated_rate']:.2f}", file=sys.stderr)
    except KinegraphError as error:
        print(f"behaviour: error: {error}", file=sys.stderr)
        return 2
    total = summarise(rows)
    bundle = f"{pipe.manifest.name} {pipe.manifest.version}"
    result = {"bundle": bundle, "seeds": options.seeds, "summary": total, "behaviours": rows}
    write_report(options.out, result, markdown_table(rows, total) + "\n")
    return 0 if total["passes"] else 1


if __name__ == "__main__":
    sys.exit(main())
