"""Does holding standing feet pay? The same generated clips with and without it, beside captured ones of the same label.

    python -m kinegraph_benchmarks.quality.foot_fix --data DATA/bandai --out foot_fix.json

It is on by default if standing toes slide less and nothing jerks more, over all gated behaviours of `behaviours.py`.
Writes JSON, and a Markdown table beside it.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from kinegraph import MotionPipeline
from kinegraph.motion.postprocess import SIDES, contacts, lock_feet
from kinegraph.motion.skeleton import JOINT_INDEX
from kinegraph_benchmarks.common.behaviour_prompts import BEHAVIOURS, Behaviour
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.quality.behaviour import SPLITS, captured
from kinegraph_training import metrics
from kinegraph_training.data.clips import MotionClip, read_split

TOES: Final = (JOINT_INDEX["left_foot"], JOINT_INDEX["right_foot"])
LEGS: Final = [joint for _, *below in SIDES for joint in below]
"""Knees, ankles and toes: all that the correction moves."""
MEASURES: Final = {
    "standing_m_s": "standing toes, m/s",
    "foot_skate_m_s": "toes below 5 cm, m/s",
    "jerk_m_s3": "jerk, m/s³",
    "leg_jerk_m_s3": "jerk of legs, m/s³",
}


def standing(joints: metrics.Joints, original: metrics.Joints) -> float:
    """Mean speed over the floor, m/s, of toes within the contacts of the motion before correction; NaN without any."""
    speeds = [
        np.linalg.norm(np.diff(joints[start:end, toe][:, [0, 2]].astype(np.float64), axis=0), axis=-1) * metrics.FPS
        for toe in TOES
        for start, end in contacts(original[:, toe].astype(np.float64), metrics.FPS)
    ]
    return float(np.concatenate(speeds).mean()) if speeds else float("nan")


def measured(motions: Sequence[metrics.Joints], originals: Sequence[metrics.Joints]) -> dict[str, float]:
    """Means over clips; contacts are those of the originals."""
    pairs = list(zip(motions, originals, strict=True))
    return {
        "standing_m_s": float(np.nanmean([standing(joints, original) for joints, original in pairs])),
        "foot_skate_m_s": float(np.nanmean([metrics.foot_skate(joints) for joints in motions])),
        "jerk_m_s3": float(np.mean([metrics.jerk(joints) for joints in motions])),
        "leg_jerk_m_s3": float(np.mean([metrics.jerk(joints[:, LEGS]) for joints in motions])),
    }


def row(pipe: MotionPipeline, behaviour: Behaviour, clips: list[MotionClip], seeds: int) -> dict[str, Any]:
    """One behaviour: captured, as the model makes it, and with feet held."""
    real = [clip.joints for clip in captured(clips, behaviour)]
    shortest, longest = pipe.manifest.seconds_limits
    seconds = min(max(float(np.median([len(joints) for joints in real])) / metrics.FPS, shortest), longest)
    made = [
        clip.joints
        for prompt in behaviour.prompts
        for clip in pipe.takes(prompt, seeds, seconds=seconds, seed=0, foot_fix=False)
    ]
    held = [lock_feet(joints, metrics.FPS) for joints in made]
    return {
        "behaviour": behaviour.name,
        "gated": behaviour.gated,
        "clips": len(made),
        "captured": measured(real, real),
        "without": measured(made, made),
        "with": measured(held, made),
    }


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Means over gated behaviours, each weighing the same, and whether it pays."""
    gated = [each for each in rows if each["gated"]]
    found: dict[str, Any] = {
        side: {name: float(np.nanmean([each[side][name] for each in gated])) for name in MEASURES}
        for side in ("captured", "without", "with")
    }
    ratio = {name: found["with"][name] / found["without"][name] for name in MEASURES}
    pays = ratio["standing_m_s"] < 1 and all(ratio[name] <= 1 for name in MEASURES)
    return {**found, "clips": sum(each["clips"] for each in gated), "ratio": ratio, "on_by_default": pays}


def table(rows: Sequence[dict[str, Any]], total: dict[str, Any]) -> str:
    """Markdown."""
    lines = ["| behaviour | clips | " + " | ".join(MEASURES.values()) + " |", "|---" * (len(MEASURES) + 2) + "|"]
    for each in rows:
        note = "" if each["gated"] else " (reported only)"
        lines.append(f"| {each['behaviour']}{note} | {each['clips']} | {_cells(each)} |")
    lines.append(f"| **gated, mean** | {total['clips']} | {_cells(total)} |")
    ratios = " | ".join(f"{total['ratio'][name]:.3f}" for name in MEASURES)
    lines.append(f"| **with / without** | | {ratios} |")
    verdict = "pays and is on" if total["on_by_default"] else "does not pay and must be off"
    lines.append(f"\nWithout → with feet held (captured clips of the same label). It {verdict} by default.\n")
    return "\n".join(lines)


def _cells(each: dict[str, Any]) -> str:
    digits = {"standing_m_s": 3, "foot_skate_m_s": 3, "jerk_m_s3": 1, "leg_jerk_m_s3": 1}
    return " | ".join(
        f"{each['without'][name]:.{count}f} → {each['with'][name]:.{count}f} ({each['captured'][name]:.{count}f})"
        for name, count in digits.items()
    )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of the captured motion (bandai)")
    parser.add_argument("--bundle", type=Path, help="folder of a bundle; the default bundle without it")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--out", type=Path, required=True, help="JSON file; a .md file is written beside it")
    given = parser.parse_args()
    pipe = MotionPipeline.load(given.bundle)
    clips = [clip for split in SPLITS for clip in read_split(given.data, split)]
    rows = [row(pipe, behaviour, clips, given.seeds) for behaviour in BEHAVIOURS]
    total = summary(rows)
    write_report(given.out, {"rows": rows, "summary": total}, table(rows, total))


if __name__ == "__main__":
    main()
