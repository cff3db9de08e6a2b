"""Measure whether a sequence keeps every part: what each does, how long it takes, how calm the joins are, and memory.

    python -m kinegraph_benchmarks.quality.sequences --data DATA/bandai --out sequences.json

    ... --method continue           how the parts follow one another (blend)
    ... --eight                     20 drawn sequences of 8 different parts each

Each part of 20 sequences must do in its own time what its sentence says as often as the same sentence alone, generated
with the same length and seed. Joins are compared with captured windows of the actions on both sides. Memory is that of
a fresh process after sequences of 4, 16 and 64 parts. Writes JSON, and a Markdown table beside it.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from kinegraph import MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import FRAMES
from kinegraph.motion import blending
from kinegraph.options import LATENT, SEQUENCE_METHODS
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.predicates import FPS
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.window_actions import ACTIONS, check_windows
from kinegraph_benchmarks.quality.behaviour import SPLITS
from kinegraph_training.data.clips import MotionClip, read_split

SEQUENCES: Final[tuple[tuple[str, ...], ...]] = (
    ("walk", "wave right", "bow"),
    ("walk", "turn left", "walk"),
    ("bow", "wave both", "walk"),
    ("run", "turn right", "raise-up both"),
    ("raise-up left", "raise-up right", "raise-up both"),
    ("walk", "wave right", "walk", "bow"),
    ("run", "walk", "turn left", "wave left"),
    ("turn right", "turn left", "walk", "run"),
    ("wave left", "wave right", "wave both", "bow"),
    ("walk", "raise-up right", "turn right", "run", "bow"),
    ("bow", "walk", "turn left", "raise-up left", "walk"),
    ("run", "walk", "run", "walk", "wave both"),
    ("wave right", "turn left", "raise-up both", "bow", "walk"),
    ("walk", "bow", "turn right", "wave left", "run", "raise-up right"),
    ("turn left", "run", "raise-up left", "walk", "bow", "wave right"),
    ("raise-up both", "walk", "turn left", "turn left", "run", "bow"),
    ("walk", "turn right", "walk", "turn right", "walk", "turn right", "walk"),
    ("bow", "raise-up right", "walk", "wave both", "run", "turn left", "bow"),
    ("walk", "run", "bow", "wave left", "turn right", "raise-up both", "walk", "wave right"),
    ("run", "turn left", "raise-up left", "bow", "walk", "turn right", "wave both", "walk"),
)
"""Parts of each sequence, keys of `ACTIONS`."""
EIGHT: Final[tuple[tuple[str, ...], ...]] = tuple(
    tuple(np.random.default_rng(row).permutation(list(ACTIONS))[:8].tolist()) for row in range(20)
)
"""Sequences of 8 different parts, drawn."""
KEPT: Final = 0.95
"""Goal: rate of the parts in their sequence, of their rate alone."""
LENGTH_TOLERANCE: Final = 0.5
"""Goal: seconds by which a part may miss its length."""
JOIN_SECONDS: Final = 1.5
"""Length of the window around a join that is compared with captured windows: it holds the longest blend."""
QUANTILE: Final = 0.95
MEMORY_PARTS: Final = (4, 16, 64)

MEMORY_SCRIPT: Final = """
import sys
from kinegraph import MotionPipeline

bundle, threads, method, *counts = sys.argv[1:]
pipe = MotionPipeline.load(bundle or None, threads=int(threads))
texts = ["a person walks forward", "a person bows"]
for count in map(int, counts):
    frames = pipe.sequence([texts[part % 2] for part in range(count)], seconds=4, seed=1, method=method).frames
    lines = open("/proc/self/status").read().splitlines()
    sizes = [next(line.split()[1] for line in lines if line.startswith(name)) for name in ("VmRSS", "VmHWM")]
    print(count, frames, *sizes)
"""
"""Prints parts, frames, and kilobytes of resident memory after each sequence and at most so far."""


@contextmanager
def recorded_joins() -> Iterator[list[float]]:
    """Record how far the middle of each blend is from where its parts should meet, in frames."""
    offsets: list[float] = []
    original = blending.best_blend

    def recording(first: FloatArray, second: FloatArray, fps: float, *, end: int, start: int) -> blending.Blend:
        blend = original(first, second, fps, end=end, start=start)
        offsets.append(blend.start + blend.frames / 2 - end)
        return blend

    blending.best_blend = recording  # type: ignore[assignment]
    try:
        yield offsets
    finally:
        blending.best_blend = original


def peak_motion(joints: FloatArray) -> tuple[float, float, float]:
    """Measure the largest acceleration, m/s^2, velocity, m/s, and jerk, m/s^3, of any joint."""
    speeds = np.linalg.norm(np.diff(joints.astype(np.float64), axis=0), axis=-1) * FPS
    jerks = np.linalg.norm(np.diff(joints.astype(np.float64), n=3, axis=0), axis=-1) * FPS**3
    acceleration = float(blending.peak_accelerations(joints, FPS).max(initial=0.0))
    return acceleration, float(speeds.max(initial=0.0)), float(jerks.max(initial=0.0))


def captured_limits(clips: Sequence[MotionClip]) -> dict[str, tuple[float, ...]]:
    """Measure the 95 % quantile of `peak_motion` over captured windows of `JOIN_SECONDS`, by name of the action."""
    frames = round(JOIN_SECONDS * FPS)
    limits = {}
    for name, action in ACTIONS.items():
        motions = [clip.joints for clip in clips if clip.action == action.label]
        peaks = [
            peak_motion(joints[start : start + frames])
            for joints in motions
            for start in range(0, max(len(joints) - frames, 0) + 1, frames // 2)
        ]
        limits[name] = tuple(np.quantile(peaks, QUANTILE, axis=0).tolist())
    return limits


def measure_sequence(
    pipe: MotionPipeline,
    names: Sequence[str],
    seed: int,
    limits: Mapping[str, tuple[float, ...]],
    method: str = "blend",
) -> dict[str, Any]:
    """Generate a sequence and each of its parts alone, and compare them.

    Args:
        pipe: the bundle.
        names: parts, keys of `ACTIONS`.
        seed: of the sequence; part k alone has seed + k, in the space of the method.
        limits: of `captured_limits`.
        method: of `MotionPipeline.sequence`.
    """
    actions = [ACTIONS[name] for name in names]
    space = FRAMES if method == "energy" else LATENT
    start = time.process_time()
    with recorded_joins() as offsets:
        clip = pipe.sequence(
            [action.sentence for action in actions],
            seconds=[action.seconds for action in actions],
            seed=seed,
            method=method,
        )
    seconds = time.process_time() - start
    offsets = offsets or [0.0] * (len(names) - 1)  # without blends, parts begin where they shall
    bounds = [0, *np.cumsum([round(action.seconds * FPS) for action in actions]).tolist()]
    shifts = [0.0, *offsets, float(clip.frames - bounds[-1])]
    crops = [clip.joints[start:end] for start, end in pairwise(bounds)]
    parts, alone_seconds = [], 0.0
    for index, (name, action) in enumerate(zip(names, actions, strict=True)):
        start = time.process_time()
        alone = pipe.generate(action.sentence, seconds=action.seconds, seed=seed + index, space=space).joints
        alone_seconds += time.process_time() - start
        others = [action.holds(crop) for other, crop in zip(names, crops, strict=True) if other != name]
        parts.append(
            {
                "name": name,
                "alone": action.holds(alone),
                "in_sequence": action.holds(crops[index]),
                "in_other_parts": float(np.mean(others)),
                "length_error": abs(shifts[index + 1] - shifts[index]) / FPS,
            }
        )
    return {
        "seed": seed,
        "cpu": seconds,
        "cpu_alone": alone_seconds,
        "parts": parts,
        "joins": measure_joins(clip.joints, names, bounds, limits),
        "total_error": abs(clip.frames - bounds[-1]) / FPS,
    }


def measure_joins(
    joints: FloatArray, names: Sequence[str], bounds: Sequence[int], limits: Mapping[str, tuple[float, ...]]
) -> list[dict[str, Any]]:
    """Compare the joins of a sequence (frames, 22, 3) with captured motion; parts begin at `bounds`, frames."""
    half = round(JOIN_SECONDS * FPS / 2)
    joins = []
    for before, after, bound in zip(names, names[1:], bounds[1:], strict=False):
        peaks = peak_motion(joints[max(bound - half, 0) : bound + half])
        allowed = np.maximum(limits[before], limits[after])
        joins.append({"between": [before, after], "of_captured": (np.array(peaks) / allowed).tolist()})
    return joins


def measure_memory(bundle: str | Path | None, method: str = "blend") -> list[dict[str, float]]:
    """Measure memory after sequences of `MEMORY_PARTS` parts, one after another in one fresh process."""
    words = [sys.executable, "-c", MEMORY_SCRIPT, str(bundle or ""), "1", method, *map(str, MEMORY_PARTS)]
    lines = subprocess.run(words, capture_output=True, text=True, check=True).stdout.split("\n")
    rows = [[int(word) for word in line.split()] for line in lines if line]
    return [
        {"parts": parts, "seconds": frames / FPS, "resident_mb": resident / 1024, "peak_mb": peak / 1024}
        for parts, frames, resident, peak in rows
    ]


def summarise(runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Summarise sequences: rates of the parts by name and together, lengths, and joins."""
    parts = [part for run in runs for part in run["parts"]]
    joins = np.array([join["of_captured"] for run in runs for join in run["joins"]])

    def rates(chosen: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        alone, within = (float(np.mean([part[key] for part in chosen])) for key in ("alone", "in_sequence"))
        held = [part["in_sequence"] for part in chosen if part["alone"]]
        return {
            "parts": len(chosen),
            "alone": alone,
            "in_sequence": within,
            "ratio": within / alone if alone else None,
            "kept": float(np.mean(held)) if held else None,
            "in_other_parts": float(np.mean([part["in_other_parts"] for part in chosen])),
        }

    total = rates(parts)
    length_error = max(part["length_error"] for part in parts)
    total_error = max(run["total_error"] for run in runs)
    calm = (joins <= 1.0).mean(axis=0)
    return {
        "by_action": {name: rates(chosen) for name in ACTIONS if (chosen := [p for p in parts if p["name"] == name])},
        "all": total,
        "length_error_s": length_error,
        "total_error_s": total_error,
        "joins": len(joins),
        "acceleration_within": float(calm[0]),
        "velocity_within": float(calm[1]),
        "jerk_within": float(calm[2]),
        "acceleration_of_captured": np.quantile(joins[:, 0], [0.5, 0.95, 1.0]).tolist(),
        "velocity_of_captured": np.quantile(joins[:, 1], [0.5, 0.95, 1.0]).tolist(),
        "jerk_of_captured": np.quantile(joins[:, 2], [0.5, 0.95, 1.0]).tolist(),
        "time": float(np.median([run["cpu"] / run["cpu_alone"] for run in runs])),
        "met": {
            "parts": bool(total["ratio"] is not None and total["ratio"] >= KEPT),
            "lengths": bool(max(length_error, total_error) <= LENGTH_TOLERANCE),
            "joins": bool(calm.min() >= QUANTILE),
        },
    }


def markdown_table(result: Mapping[str, Any]) -> str:
    """Format a result as Markdown."""
    total, windows = result["summary"], result["captured_windows"]
    lines = [
        f"{result['bundle']}, method {result['method']}: {len(SEQUENCES)} sequences of {result['lengths']} parts, "
        f"{result['seeds']} seeds",
        "",
        "| part | length, s | captured windows: own, other actions | parts | alone | in sequence | ratio | kept"
        " | in other parts |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, row in [*total["by_action"].items(), ("**all**", total["all"])]:
        seconds = f"{ACTIONS[name].seconds:g}" if name in ACTIONS else ""
        window = f"{windows[name]['met']:.2f}, {windows[name]['wrong']:.3f}" if name in windows else ""
        rates = ("alone", "in_sequence", "ratio", "kept", "in_other_parts")
        cells = " | ".join("-" if row[key] is None else f"{row[key]:.3f}" for key in rates)
        lines.append(f"| {name} | {seconds} | {window} | {row['parts']} | {cells} |")
    lines += [
        "",
        "Kept: share of the parts that hold alone that hold in their sequence, too. In other parts: how often the"
        " predicate holds in the time of another action, to see that it is not blind.",
        "",
    ]
    lines += ["| | measured | goal | met |", "|---|---|---|---|"]
    for what, value, goal, is_met in (
        ("parts, rate in sequence of rate alone", total["all"]["ratio"], KEPT, total["met"]["parts"]),
        *(
            (f"{length}, worst error, s", total[key], LENGTH_TOLERANCE, total[key] <= LENGTH_TOLERANCE)
            for length, key in (("length of a part", "length_error_s"), ("whole length", "total_error_s"))
        ),
        *(
            (f"joins with {name} within captured 95 %", total[key], QUANTILE, total[key] >= QUANTILE)
            for name, key in ((name, f"{name}_within") for name in ("acceleration", "velocity", "jerk"))
        ),
    ):
        lines.append(f"| {what} | {value:.3f} | {goal} | {'yes' if is_met else 'no'} |")

    def triple(values: Sequence[float]) -> str:
        return " / ".join(f"{value:.2f}" for value in values)

    lines += [
        "",
        f"{total['joins']} joins; median / 95 % / worst of the captured 95 % quantile: acceleration "
        f"{triple(total['acceleration_of_captured'])}, velocity {triple(total['velocity_of_captured'])}, jerk "
        f"{triple(total['jerk_of_captured'])}. A sequence takes {total['time']:.1f} times as long as its parts alone.",
        "",
        "| parts | length, s | resident memory after, MB | peak so far, MB |",
        "|---|---|---|---|",
    ]
    for row in result["memory"]:
        lines.append(f"| {row['parts']} | {row['seconds']:.0f} | {row['resident_mb']:.0f} | {row['peak_mb']:.0f} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "data", "bundle", "out", seeds=3)
    parser.add_argument("--method", default="blend", choices=SEQUENCE_METHODS, help="of the sequences (blend)")
    parser.add_argument("--eight", action="store_true", help="sequences of 8 parts, instead of 3 to 8")
    options = parser.parse_args()
    sequences = EIGHT if options.eight else SEQUENCES
    pipe = MotionPipeline.load(options.bundle, threads=1)
    clips = [clip for split in SPLITS for clip in read_split(options.data, split)]
    limits = captured_limits(clips)
    runs = [
        # parts have seeds of their own: sequences are as far apart as they are long
        measure_sequence(pipe, names, 1000 * seed + 10 * row, limits, options.method)
        for row, names in enumerate(sequences)
        for seed in range(options.seeds)
    ]
    result = {
        "bundle": f"{pipe.manifest.name} {pipe.manifest.version}",
        "seeds": options.seeds,
        "method": options.method,
        "lengths": "8" if options.eight else "3 to 8",
        "captured_windows": check_windows(clips, list(ACTIONS)),
        "captured_limits": limits,
        "summary": summarise(runs),
        "memory": measure_memory(options.bundle, options.method),
        "runs": runs,
    }
    write_report(options.out, result, markdown_table(result))


if __name__ == "__main__":
    main()
