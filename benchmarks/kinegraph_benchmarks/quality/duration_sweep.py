"""Measure whether a sentence means the same at any length: the actions of `common.behaviour_prompts` at 2 to 8 seconds.

    python -m kinegraph_benchmarks.quality.duration_sweep --data DATA/bandai --out lengths.json

Captured clips of an action all have about the same length, so a model may learn that a clip of four seconds is a turn,
whatever its sentence says. Walks and runs that name no turn have to end within 45 degrees of where they faced. Writes
JSON, and a Markdown table beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from kinegraph import MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.behaviour_prompts import ACTIONS, Behaviour
from kinegraph_benchmarks.common.predicates import net_turn
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.quality.behaviour import SPLITS, captured_clips
from kinegraph_training.data.clips import MotionClip, read_split

SECONDS: Final = (2.0, 3.0, 4.0, 6.0, 8.0)
STRAIGHT: Final = frozenset(("walk", "run"))
"""Actions that name no turn."""


def holds(behaviour: Behaviour, joints: FloatArray) -> bool:
    """Tell whether a clip does what its sentence says, and does not turn where it names no turn."""
    straight = behaviour.action not in STRAIGHT or abs(net_turn(joints)) < 45.0
    return straight and bool(behaviour.holds(joints))


def measure_lengths(pipe: MotionPipeline, behaviour: Behaviour, clips: list[MotionClip], seeds: int) -> dict[str, Any]:
    """Measure one behaviour: the rate and the lengths of captured clips, and the rate of generated ones per length."""
    real = captured_clips(clips, behaviour)
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


def summarise(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Average the rates over behaviours, each weighing the same."""
    rates = {length: float(np.mean([row["generated"][length] for row in rows])) for length in rows[0]["generated"]}
    return {"captured": float(np.mean([row["captured"] for row in rows])), "generated": rates}


def markdown_table(rows: Sequence[dict[str, Any]], total: dict[str, Any]) -> str:
    """Format rows and their summary as Markdown."""
    names = list(total["generated"])
    lines = [
        "| behaviour | captured clips last, s | captured | " + " | ".join(f"{name} s" for name in names) + " |",
        "|---" * (3 + len(names)) + "|",
    ]
    for row in rows:
        shortest, median, longest = row["captured_seconds"]
        rates = " | ".join(f"{row['generated'][name]:.2f}" for name in names)
        span = f"{median:.1f} ({shortest:.1f} to {longest:.1f})"
        lines.append(f"| {row['behaviour']} | {span} | {row['captured']:.2f} | {rates} |")
    means = " | ".join(f"{total['generated'][name]:.3f}" for name in names)
    lines.append(f"| **mean** | | {total['captured']:.3f} | {means} |")
    return "\n".join(lines) + f"\n\n{rows[0]['clips']} generated clips a cell; lengths are median and 10 to 90 %.\n"


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "data", "bundle", "out", seeds=10)
    options = parser.parse_args()
    pipe = MotionPipeline.load(options.bundle)
    clips = [clip for split in SPLITS for clip in read_split(options.data, split)]
    rows = [measure_lengths(pipe, behaviour, clips, options.seeds) for behaviour in ACTIONS]
    total = summarise(rows)
    bundle = f"{pipe.manifest.name} {pipe.manifest.version}"
    write_report(options.out, {"bundle": bundle, "rows": rows, "summary": total}, markdown_table(rows, total))


if __name__ == "__main__":
    main()
