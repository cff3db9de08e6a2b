"""Measure whether a take is the clip of its seed: distance of the joints of `takes` from those of `generate`.

    python -m kinegraph_benchmarks.quality.take_equality --out take_equality.json

Takes run clip by clip unless they share the runs of the models, which is faster. In an int8 bundle one scale spans a
run, so that clips that share one come out a little differently; what that costs is measured here. Writes JSON, and a
Markdown table beside it.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from kinegraph import MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_report

SENTENCES: Final = (
    ("a person walks forward", 4.0),
    ("a person runs forward", 3.0),
    ("an old person walks slowly and turns left", 6.0),
    ("a person waves the right hand", 6.0),
    ("a person raises both hands", 2.5),
    ("a person bows", 4.0),
    ("a person walks forward while waving both hands", 6.0),
    ("a person walks forward, then bows", 8.0),
)
"""Sentences and their lengths in seconds."""
COUNTS: Final = (2, 4, 8)
"""Takes of one call."""
EQUAL_MM: Final = 0.1
"""Goal of takes that share no run: millimetres at most."""


def joint_distances(clips: Sequence[FloatArray], alone: Sequence[FloatArray]) -> dict[str, float]:
    """Measure the mean and the largest distance of joints (frames, 22, 3) from those generated alone, mm."""
    distances = [1000 * np.linalg.norm(a - b, axis=-1) for a, b in zip(clips, alone, strict=True)]
    return {
        "mean_mm": float(np.mean([distance.mean() for distance in distances])),
        "worst_mm": float(max(distance.max() for distance in distances)),
    }


def measure_sentence(pipe: MotionPipeline, sentence: str, seconds: float, count: int) -> dict[str, Any]:
    """Compare `count` takes of a sentence, each way, with the clips of their seeds; also the seconds of each call."""
    seed = 40
    alone = [pipe.generate(sentence, seconds=seconds, seed=seed + take).joints for take in range(count)]
    row: dict[str, Any] = {"sentence": sentence, "seconds": seconds, "takes": count}
    for name, shared in (("default", False), ("shared_run", True)):
        start = time.perf_counter()
        clips = pipe.takes(sentence, count, seconds=seconds, seed=seed, shared_run=shared)
        took = time.perf_counter() - start
        row[name] = {**joint_distances([clip.joints for clip in clips], alone), "took_s": took}
    return row


def summarise(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Average and find the worst over sentences and numbers of takes, each way."""
    total: dict[str, Any] = {
        name: {
            "mean_mm": float(np.mean([row[name]["mean_mm"] for row in rows])),
            "worst_mm": float(max(row[name]["worst_mm"] for row in rows)),
            "took_s": float(np.sum([row[name]["took_s"] for row in rows])),
        }
        for name in ("default", "shared_run")
    }
    return {**total, "met": total["default"]["worst_mm"] <= EQUAL_MM}


def markdown_table(bundle: str, rows: Sequence[dict[str, Any]], total: dict[str, Any]) -> str:
    """Format a result as Markdown."""
    lines = [
        f"{bundle}: distance of joints of a take from the clip of its seed, mm, mean (worst)",
        "",
        "| sentence | length, s | takes | by default | sharing a run |",
        "|---|---|---|---|---|",
    ]
    for row in rows:
        lines.append(f"| {row['sentence']} | {row['seconds']:g} | {row['takes']} | {_distances(row)} |")
    lines.append(f"| **all** | | | {_distances(total)} |")
    met = "met" if total["met"] else "not met"
    ratio = total["default"]["took_s"] / total["shared_run"]["took_s"]
    lines += ["", f"Goal of the default: {EQUAL_MM} mm at most, {met}. Sharing a run took 1 / {ratio:.2f} of the time."]
    return "\n".join(lines) + "\n"


def _distances(row: dict[str, Any]) -> str:
    return " | ".join(f"{row[name]['mean_mm']:.2f} ({row[name]['worst_mm']:.2f})" for name in ("default", "shared_run"))


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "bundle", "out")
    options = parser.parse_args()
    pipe = MotionPipeline.load(options.bundle, threads=1)
    rows = [measure_sentence(pipe, text, seconds, count) for text, seconds in SENTENCES for count in COUNTS]
    total = summarise(rows)
    bundle = f"{pipe.manifest.name} {pipe.manifest.version}"
    write_report(options.out, {"bundle": bundle, "summary": total, "rows": rows}, markdown_table(bundle, rows, total))


if __name__ == "__main__":
    main()
