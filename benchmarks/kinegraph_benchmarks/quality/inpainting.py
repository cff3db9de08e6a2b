"""Compare two ways to meet constraints and to keep parts of a clip: held in skeleton space, and pulled in latent space.

    python -m kinegraph_benchmarks.quality.inpainting --bundle BUNDLE --data DATA/bandai --out inpainting.json

    ... --cases N                   of each kind (50)
    ... --seeds N                   of each edit (3)

The bundle needs skeleton space. What captured clips do (`common.constraint_cases`), also two of their poses at the ends
of one clip, is asked for with the same sentences and seeds in both spaces, before and after the correction in the
joints; edits are those of `quality.edits`. Jerk and skate are ratios to the plain clip of the same space, the Frechet
distance is to captured clips, and time is CPU time of one thread, as a ratio to the plain clip of latent space. Writes
JSON, and a Markdown table beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from kinegraph import MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import FRAMES
from kinegraph.options import LATENT
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.constraint_cases import Case, make_cases, on_common_body
from kinegraph_benchmarks.common.evaluator import FOLDER, Evaluator
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.quality.constraints import SPLIT, frechet, run_case, summarise, without_joints
from kinegraph_benchmarks.quality.edits import EDITS, run_edit
from kinegraph_training.data.clips import MotionClip, read_split

KINDS: Final = ("keyframe", "start", "end", "keyframe + straight", "hand", "loop", "drawn path")
"""Of `constraint_cases.KINDS`: whole poses, places of a hand and of the root, and loops."""
BETWEEN: Final = "between"
WAYS: Final = {LATENT: "pulled, latent", FRAMES: "held, skeleton"}
FIRST_SEED: Final = 95_000
"""Of edits."""


def pose_cases(clips: Sequence[MotionClip], count: int) -> dict[str, list[Case]]:
    """Make the cases of `KINDS`, and in-betweens of a start and an end."""
    cases = {kind: of_kind for kind, of_kind in make_cases(clips, count).items() if kind in KINDS}
    if "start" in cases and "end" in cases:
        cases[BETWEEN] = [
            replace(start, kind=BETWEEN, constraints=(*start.constraints, *end.constraints))
            for start, end in zip(cases["start"], cases["end"], strict=False)
        ]
    return cases


def compare_case(pipe: MotionPipeline, case: Case) -> dict[str, Any]:
    """Make a case in both spaces: a row of `quality.constraints.run_case` each, with times beside the latent clip."""
    rows = {space: run_case(pipe, case, space=space) for space in WAYS}
    plain = rows[LATENT]["plain"]["cpu"]
    for row in rows.values():
        row["time"] = {arm: row[arm]["cpu"] / plain for arm in ("plain", "alone", "corrected")}
    return rows


def summarise_kind(rows: Sequence[Mapping[str, Any]], captured: FloatArray, evaluator: Evaluator) -> dict[str, Any]:
    """Summarise the cases of one kind, in both spaces."""
    summary: dict[str, Any] = {}
    for space in WAYS:
        own = [row[space] for row in rows]
        times = {arm: float(np.median([row["time"][arm] for row in own])) for arm in own[0]["time"]}
        summary[space] = summarise(own) | {"time": times, "frechet": frechet(own, captured, evaluator)}
    return summary


def compare_edits(pipe: MotionPipeline, seeds: int) -> dict[str, Any]:
    """Run all edits in both spaces."""
    rows: dict[str, list[dict[str, Any]]] = {space: [] for space in WAYS}
    for number, edit in enumerate(EDITS):
        for seed in range(seeds):
            for space, of_space in rows.items():
                of_space.append(run_edit(pipe, edit, FIRST_SEED + 100 * number + seed, space))
    pulled = [row["cpu"] for row in rows[LATENT]]
    return {
        space: {
            "edits": len(of_space),
            "kept": float(np.mean([row["kept"] for row in of_space])),
            "kept_worst": max(row["kept"] for row in of_space),
            "rate": float(np.mean([row["holds"] for row in of_space])),
            "time_of_pulled": float(np.median([row["cpu"] / cpu for row, cpu in zip(of_space, pulled, strict=True)])),
        }
        for space, of_space in rows.items()
    }


def markdown_table(result: Mapping[str, Any]) -> str:
    """Format a result as Markdown."""
    heads = ("kind", "way", "plain", "alone", "corrected", "jerk", "skate", "Frechet plain, corrected")
    lines = [
        f"{result['bundle']}, {result['cases']} cases a kind; misses in cm, mean (95 %)",
        "",
        "| " + " | ".join([*heads, "text plain, corrected", "time plain, corrected"]) + " |",
        "|---" * 10 + "|",
    ]
    for kind, spaces in result["kinds"].items():
        for space, row in spaces.items():
            cells = [
                f"{100 * row[arm]['miss_mean']:.1f} ({100 * row[arm]['miss_p95']:.1f})"
                for arm in ("plain", "alone", "corrected")
            ]
            cells += [f"{row['corrected']['jerk']:.2f} x", f"{row['corrected']['skate']:.2f} x"]
            for values, digits in ((row["frechet"], 3), (rates_of(row), 2), (row["time"], 1)):
                cells.append(f"{values['plain']:.{digits}f}, {values['corrected']:.{digits}f}")
            lines.append(f"| {kind} | {WAYS[space]} | " + " | ".join(cells) + " |")
    lines += ["", "| edits | moved, mm | at worst, mm | the new sentence holds | time, of pulled |", "|---" * 5 + "|"]
    for space, row in result["edits"].items():
        moved = f"{1000 * row['kept']:.1f} | {1000 * row['kept_worst']:.1f}"
        lines.append(f"| {WAYS[space]} | {moved} | {row['rate']:.2f} | {row['time_of_pulled']:.2f} |")
    return "\n".join(lines) + "\n"


def rates_of(summary: Mapping[str, Any]) -> dict[str, float]:
    """Take how often the sentence holds, by arm."""
    return {arm: summary[arm]["rate"] for arm in ("plain", "corrected")}


def measure(
    pipe: MotionPipeline, clips: Sequence[MotionClip], count: int, seeds: int, evaluator: Evaluator
) -> dict[str, Any]:
    """Compare all kinds of constraints, and edits; see `main`."""
    captured = evaluator.embed_motions([clip.joints for clip in clips])
    kinds: dict[str, Any] = {}
    for kind, cases in pose_cases(clips, count).items():
        rows = [compare_case(pipe, case) for case in cases]
        kinds[kind] = summarise_kind(rows, captured, evaluator)
        for space, summary in kinds[kind].items():
            summary["rows"] = [without_joints(row[space]) for row in rows]
    return {
        "bundle": f"{pipe.manifest.name} {pipe.manifest.version}",
        "cases": count,
        "kinds": kinds,
        "edits": compare_edits(pipe, seeds),
    }


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--cases", type=int, default=50, help="cases of each kind (50)")
    add_arguments(parser, "data", "bundle", "out", seeds=3)
    parser.add_argument("--evaluator", type=Path, default=FOLDER, help="folder that export_evaluator wrote")
    options = parser.parse_args()
    pipe = MotionPipeline.load(options.bundle, threads=1)
    for space in WAYS:  # opens the sessions; a bundle without skeleton space ends here
        pipe.generate("a person walks forward", seconds=1, seed=1, space=space)
    clips = on_common_body(read_split(options.data, SPLIT))
    result = measure(pipe, clips, options.cases, options.seeds, Evaluator(options.evaluator))
    write_report(options.out, result, markdown_table(result))


if __name__ == "__main__":
    main()
