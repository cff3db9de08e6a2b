"""Measure whether locking standing feet pays: the same clips with and without it, beside captured ones of the label.

    python -m kinegraph_benchmarks.quality.foot_fix --data DATA/bandai --out foot_fix.json

It is on by default if standing toes slide less and nothing jerks more, over all gated behaviours of
`common.behaviour_prompts`.
Writes JSON, and a Markdown table beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from kinegraph import MotionPipeline
from kinegraph.motion.postprocess import LEGS, find_contacts, lock_feet
from kinegraph.motion.skeleton import JOINT_INDEX
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.behaviour_prompts import BEHAVIOURS, Behaviour
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.quality.behaviour import SPLITS, captured_clips, median_seconds
from kinegraph_training import metrics
from kinegraph_training.data.clips import MotionClip, read_split

TOES: Final = (JOINT_INDEX["left_foot"], JOINT_INDEX["right_foot"])
LEG_JOINTS: Final = [joint for _, *below in LEGS for joint in below]
"""Knees, ankles and toes: all joints that the correction moves."""
METRICS: Final = {
    "standing_m_s": "standing toes, m/s",
    "foot_skate_m_s": "toes below 5 cm, m/s",
    "jerk_m_s3": "jerk, m/s³",
    "leg_jerk_m_s3": "jerk of legs, m/s³",
}


def standing_toe_speed(joints: metrics.Joints, original: metrics.Joints) -> float:
    """Measure how fast toes slide over the floor while they stand, m/s.

    Args:
        joints: (frames, 22, 3), metres.
        original: the motion before correction, whose contacts say when a toe stands.

    Returns:
        Mean over both toes and all contacts; NaN without any.
    """
    speeds = [
        np.linalg.norm(np.diff(joints[start:end, toe][:, [0, 2]].astype(np.float64), axis=0), axis=-1) * metrics.FPS
        for toe in TOES
        for start, end in find_contacts(original[:, toe].astype(np.float64), metrics.FPS)
    ]
    return float(np.concatenate(speeds).mean()) if speeds else float("nan")


def mean_metrics(motions: Sequence[metrics.Joints], originals: Sequence[metrics.Joints]) -> dict[str, float]:
    """Average `METRICS` over clips; contacts are those of the originals."""
    pairs = list(zip(motions, originals, strict=True))
    return {
        "standing_m_s": float(np.nanmean([standing_toe_speed(joints, original) for joints, original in pairs])),
        "foot_skate_m_s": float(np.nanmean([metrics.foot_skate(joints) for joints in motions])),
        "jerk_m_s3": float(np.mean([metrics.jerk(joints) for joints in motions])),
        "leg_jerk_m_s3": float(np.mean([metrics.jerk(joints[:, LEG_JOINTS]) for joints in motions])),
    }


def measure_behaviour(
    pipe: MotionPipeline, behaviour: Behaviour, clips: list[MotionClip], seeds: int
) -> dict[str, Any]:
    """Measure one behaviour: captured clips, clips as the model generates them, and the same with feet locked."""
    captured = captured_clips(clips, behaviour)
    seconds = median_seconds(pipe, captured)
    real = [clip.joints for clip in captured]
    generated = [
        clip.joints
        for prompt in behaviour.prompts
        for clip in pipe.takes(prompt, seeds, seconds=seconds, seed=0, foot_fix=False)
    ]
    locked = [lock_feet(joints, metrics.FPS) for joints in generated]
    return {
        "behaviour": behaviour.name,
        "gated": behaviour.gated,
        "clips": len(generated),
        "captured": mean_metrics(real, real),
        "without": mean_metrics(generated, generated),
        "with": mean_metrics(locked, generated),
    }


def summarise(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Average gated behaviours, each weighing the same, and decide whether the correction pays."""
    gated = [row for row in rows if row["gated"]]
    means: dict[str, Any] = {
        side: {name: float(np.nanmean([row[side][name] for row in gated])) for name in METRICS}
        for side in ("captured", "without", "with")
    }
    ratio = {name: means["with"][name] / means["without"][name] for name in METRICS}
    pays = ratio["standing_m_s"] < 1 and all(ratio[name] <= 1 for name in METRICS)
    return {**means, "clips": sum(row["clips"] for row in gated), "ratio": ratio, "on_by_default": pays}


def markdown_table(rows: Sequence[dict[str, Any]], total: dict[str, Any]) -> str:
    """Format rows and their summary as Markdown."""
    lines = ["| behaviour | clips | " + " | ".join(METRICS.values()) + " |", "|---" * (len(METRICS) + 2) + "|"]
    for row in rows:
        note = "" if row["gated"] else " (reported only)"
        lines.append(f"| {row['behaviour']}{note} | {row['clips']} | {_cells(row)} |")
    lines.append(f"| **gated, mean** | {total['clips']} | {_cells(total)} |")
    ratios = " | ".join(f"{total['ratio'][name]:.3f}" for name in METRICS)
    lines.append(f"| **with / without** | | {ratios} |")
    verdict = "pays and is on" if total["on_by_default"] else "does not pay and must be off"
    lines.append(f"\nWithout → with feet held (captured clips of the same label). It {verdict} by default.\n")
    return "\n".join(lines)


def _cells(row: dict[str, Any]) -> str:
    """Format each metric: without -> with the correction (captured)."""
    digits = {"standing_m_s": 3, "foot_skate_m_s": 3, "jerk_m_s3": 1, "leg_jerk_m_s3": 1}
    return " | ".join(
        f"{row['without'][name]:.{count}f} → {row['with'][name]:.{count}f} ({row['captured'][name]:.{count}f})"
        for name, count in digits.items()
    )


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "data", "bundle", "out", seeds=5)
    options = parser.parse_args()
    pipe = MotionPipeline.load(options.bundle)
    clips = [clip for split in SPLITS for clip in read_split(options.data, split)]
    rows = [measure_behaviour(pipe, behaviour, clips, options.seeds) for behaviour in BEHAVIOURS]
    total = summarise(rows)
    write_report(options.out, {"rows": rows, "summary": total}, markdown_table(rows, total))


if __name__ == "__main__":
    main()
