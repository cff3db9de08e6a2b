"""Measure edits and streams: what edits keep and change, and whether a stream stays in flat memory.

    python -m kinegraph_benchmarks.quality.edits --out edits.json

    ... --minutes N                 of the stream (10)

Each edit of `EDITS` takes a generated clip and keeps a part of it: how far what is kept has moved is measured here, not
taken from the clip, and the new sentence must hold. The stream runs in a fresh process: its memory is read after every
tenth of it. Writes JSON, and a Markdown table beside it.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from kinegraph import Clip, MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph.keeping import PARTS
from kinegraph.motion.energies import to_own_frames
from kinegraph.motion.skeleton import PELVIS, start_at_origin
from kinegraph.options import LATENT
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.everyday_rules import meets
from kinegraph_benchmarks.common.predicates import FPS
from kinegraph_benchmarks.common.report_io import write_report

Keep = str | tuple[float, float]
EDITS: Final[tuple[tuple[str, str, Keep, tuple[str, ...]], ...]] = (
    ("a person walks forward", "a person walks forward while waving the right hand", "legs", ("waves_right",)),
    ("a person walks forward", "a person walks forward while raising both hands", "legs", ("both_up",)),
    ("a person runs forward", "a person runs forward while raising the left hand", "legs", ("left_up",)),
    ("a person walks and turns left", "a person walks while waving the left hand", "legs", ("waves_left",)),
    ("a person stands", "a person waves both hands", "legs", ("waves_both",)),
    ("a person waves the right hand", "a person walks forward", "right arm", ("forward",)),
    ("a person walks forward", "a person bows", (0.0, 1.5), ("bows",)),
    ("a person walks forward", "a person raises the right hand", (0.0, 1.0), ("right_up",)),
)
"""Sentence of the clip, new sentence, what is kept, and rules of `everyday_rules` for the result."""
SECONDS: Final = 4.0
FIRST_SEED: Final = 90_000
KEPT_GOAL: Final = 0.01
"""Metres, mean over what is kept."""
TEXT_GOAL: Final = 0.8
MEMORY_GOAL: Final = 1.02
"""Largest resident memory of the second half of a stream, relative to that of the first."""
STREAM_SCRIPT: Final = """
import itertools, sys
from kinegraph import MotionPipeline

bundle, minutes = sys.argv[1], float(sys.argv[2])
pipe = MotionPipeline.load(bundle or None, threads=1)
texts = itertools.cycle(["a person walks forward", "a person bows", "a person runs forward", "a person turns left"])
frames = round(minutes * 60 * pipe.manifest.fps)
for count, joints in enumerate(itertools.islice(pipe.stream(texts, seconds=3, seed=1), frames), 1):
    if count % (frames // 10) == 0:
        lines = open("/proc/self/status").read().splitlines()
        size = next(line.split()[1] for line in lines if line.startswith("VmRSS"))
        print(count, size, float(abs(joints[0]).max()))
"""
"""Prints frames, kilobytes of resident memory and metres from the origin after every tenth of a stream."""


def kept_distance(before: FloatArray, after: FloatArray, keep: Keep) -> float:
    """Measure how far what is kept has moved: metres, mean over its joints and frames.

    Args:
        before, after: (frames, 22, 3) metres, the clip and its edit.
        keep: a part of the body or a span of seconds; arms count relative to the pelvis.
    """
    # the edit begins at the origin already; its first heading is that of its new shoulders
    old, new = start_at_origin(before).astype(np.float64), after.astype(np.float64)
    if isinstance(keep, tuple):
        begin, end = (round(moment * FPS) for moment in keep)
        return float(np.linalg.norm(new[begin:end] - old[begin:end], axis=-1).mean())
    joints = list(PARTS[keep])
    if PELVIS not in joints:
        old, new = (to_own_frames(motion)[0] for motion in (old, new))
    return float(np.linalg.norm(new[:, joints] - old[:, joints], axis=-1).mean())


def run_edit(
    pipe: MotionPipeline, edit: tuple[str, str, Keep, tuple[str, ...]], seed: int, space: str = LATENT
) -> dict[str, Any]:
    """Make one clip, edit it in a space of `options.SPACES`, and measure both."""
    text, new_text, keep, rules = edit
    clip: Clip = pipe.generate(text, seconds=SECONDS, seed=seed)
    start = time.process_time()
    edited = pipe.edit(clip, new_text, keep=[keep], seed=seed, space=space)
    seconds = time.process_time() - start
    return {
        "text": text,
        "new_text": new_text,
        "keep": keep,
        "seed": seed,
        "cpu": seconds,
        "kept": kept_distance(clip.joints, edited.joints, keep),
        "changed": float(np.linalg.norm(edited.joints - start_at_origin(clip.joints), axis=-1).mean()),
        "held_before": meets(clip.joints, rules),
        "holds": meets(edited.joints, rules),
    }


def measure_stream(bundle: str | Path | None, minutes: float) -> list[dict[str, float]]:
    """Run a stream in a fresh process; returns frames, memory and place after every tenth."""
    words = [sys.executable, "-c", STREAM_SCRIPT, str(bundle or ""), str(minutes)]
    lines = subprocess.run(words, capture_output=True, text=True, check=True).stdout.split("\n")
    rows = [line.split() for line in lines if line]
    return [{"seconds": int(row[0]) / FPS, "resident_mb": int(row[1]) / 1024, "away_m": float(row[2])} for row in rows]


def summarise(rows: Sequence[Mapping[str, Any]], stream: Sequence[Mapping[str, float]]) -> dict[str, Any]:
    """Summarise edits, all and for each new sentence, and the growth of a stream's memory."""
    sizes = [row["resident_mb"] for row in stream]
    half = len(sizes) // 2
    kept, holds = float(np.mean([row["kept"] for row in rows])), float(np.mean([row["holds"] for row in rows]))
    growth = max(sizes[half:]) / max(sizes[:half]) if half else None
    return {
        "edits": len(rows),
        "kept": kept,
        "kept_worst": max(row["kept"] for row in rows),
        "rate": holds,
        "rate_before": float(np.mean([row["held_before"] for row in rows])),
        "growth": growth,
        "met": {
            "kept": kept <= KEPT_GOAL,
            "text": holds >= TEXT_GOAL,
            "memory": growth is None or growth <= MEMORY_GOAL,
        },
    }


def markdown_table(result: Mapping[str, Any]) -> str:
    """Format a result as Markdown."""
    total = result["summary"]
    lines = [
        f"{result['bundle']}: {total['edits']} edits of clips of {SECONDS:g} s, seeds from {FIRST_SEED:,}",
        "",
        "| clip | new sentence | kept | moved, mm | holds before | holds after |",
        "|---" * 6 + "|",
    ]
    for text, new_text, keep, _ in EDITS:
        rows = [row for row in result["rows"] if (row["text"], row["new_text"]) == (text, new_text)]
        moved, before, after = (np.mean([row[key] for row in rows]) for key in ("kept", "held_before", "holds"))
        what = keep if isinstance(keep, str) else f"{keep[0]:g} to {keep[1]:g} s"
        lines.append(f"| {text} | {new_text} | {what} | {1000 * moved:.1f} | {before:.2f} | {after:.2f} |")
    lines += [
        "",
        f"Together: what is kept moved by {1000 * total['kept']:.1f} mm, {1000 * total['kept_worst']:.1f} mm at worst"
        f" (goal {1000 * KEPT_GOAL:g}); the new sentence holds in {total['rate']:.2f} (goal {TEXT_GOAL:g}), in"
        f" {total['rate_before']:.2f} of the clips before.",
        "",
        "| stream, s | resident memory, MB | from the origin, m |",
        "|---|---|---|",
    ]
    lines += [f"| {row['seconds']:.0f} | {row['resident_mb']:.1f} | {row['away_m']:.0f} |" for row in result["stream"]]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="of the stream (10)")
    add_arguments(parser, "bundle", "out", seeds=3)
    options = parser.parse_args()
    pipe = MotionPipeline.load(options.bundle, threads=1)
    rows = [
        run_edit(pipe, edit, FIRST_SEED + 100 * number + seed)
        for number, edit in enumerate(EDITS)
        for seed in range(options.seeds)
    ]
    stream = measure_stream(options.bundle, options.minutes)
    result = {
        "bundle": f"{pipe.manifest.name} {pipe.manifest.version}",
        "summary": summarise(rows, stream),
        "rows": rows,
        "stream": stream,
    }
    write_report(options.out, result, markdown_table(result))


if __name__ == "__main__":
    main()
