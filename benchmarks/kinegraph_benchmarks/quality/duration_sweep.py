"""Does a sentence mean the same at any length? Contents of `behaviours.py`, generated at lengths a user may ask for.

    python -m kinegraph_benchmarks.quality.duration_sweep --data DATA/bandai --out lengths.json

Captured clips of an action are all about as long as one another, so a model may learn that a clip of four seconds is a
turn, whatever its sentence says. Walks and runs that name no turn have to end within 45 degrees of where they faced.
Writes JSON, and a Markdown table beside it.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from kinegraph import MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph_benchmarks.common.behaviour_prompts import CONTENTS, Behaviour
from kinegraph_benchmarks.common.predicates import net_turn
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.quality.behaviour import SPLITS, captured
from kinegraph_training.data.clips import MotionClip, read_split

SECONDS: Final = (2.0, 3.0, 4.0, 6.0, 8.0)
STRAIGHT: Final = frozenset(("walk", "run"))
"""Contents that name no turn."""


def holds(behaviour: Behaviour, joints: FloatArray) -> bool:
    """Whether a clip does what its sentence says, and does not turn where it says nothing of a turn."""
    straight = behaviour.content not in STRAIGHT or abs(net_turn(joints)) < 45.0
    return straight and bool(behaviour.holds(joints))


def row(pipe: MotionPipeline, behaviour: Behaviour, clips: list[MotionClip], seeds: int) -> dict[str, Any]:
    """One behaviour: the rate of captured clips and their lengths, and that of generated ones per length."""
    real = captured(clips, behaviour)
    lengths = np.array([len(clip.joints) for clip in real]) / pipe.manifest.fps
    return {
        "behaviour": behaviour.name,
        "captured": float(np.mean([holds(behaviour, clip.joints) for clip in real])),
        "captured_seconds": [float(part) for part in np.quantile(lengths, [0.1, 0.5, 0.9])],
        "clips": len(behaviour.prompts) * seeds,
        "generated": {
            f"{seconds:g}": float(
                np.mean(
                    [
                        holds(behaviour, clip.joints)
                        for prompt in behaviour.prompts
                        for clip in pipe.takes(prompt, seeds, seconds=seconds, seed=0)
                    ]
                )
            )
            for seconds in SECONDS
        },
    }


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Means over behaviours, each weighing the same."""
    lengths = {name: float(np.mean([each["generated"][name] for each in rows])) for name in rows[0]["generated"]}
    return {"captured": float(np.mean([each["captured"] for each in rows])), "generated": lengths}


def table(rows: Sequence[dict[str, Any]], total: dict[str, Any]) -> str:
    """Markdown."""
    names = list(total["generated"])
    lines = [
        "| behaviour | captured clips last, s | captured | " + " | ".join(f"{name} s" for name in names) + " |",
        "|---" * (3 + len(names)) + "|",
    ]
    for each in rows:
        shortest, median, longest = each["captured_seconds"]
        rates = " | ".join(f"{each['generated'][name]:.2f}" for name in names)
        span = f"{median:.1f} ({shortest:.1f} to {longest:.1f})"
        lines.append(f"| {each['behaviour']} | {span} | {each['captured']:.2f} | {rates} |")
    means = " | ".join(f"{total['generated'][name]:.3f}" for name in names)
    lines.append(f"| **mean** | | {total['captured']:.3f} | {means} |")
    return "\n".join(lines) + f"\n\n{rows[0]['clips']} generated clips a cell; lengths are median and 10 to 90 %.\n"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of the captured motion (bandai)")
    parser.add_argument("--bundle", type=Path, help="folder of a bundle; the default bundle without it")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--out", type=Path, required=True, help="JSON file; a .md file is written beside it")
    given = parser.parse_args()
    pipe = MotionPipeline.load(given.bundle)
    clips = [clip for split in SPLITS for clip in read_split(given.data, split)]
    rows = [row(pipe, behaviour, clips, given.seeds) for behaviour in CONTENTS]
    total = summary(rows)
    bundle = f"{pipe.manifest.name} {pipe.manifest.version}"
    write_report(given.out, {"bundle": bundle, "rows": rows, "summary": total}, table(rows, total))


if __name__ == "__main__":
    main()
