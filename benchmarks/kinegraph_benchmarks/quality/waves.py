"""Measure whether waves wave at every length: how often, how wide and how often to and fro, beside captured ones.

    python -m kinegraph_benchmarks.quality.waves --data DATA/bandai --out waves.json

Generates the waves and raises of `common.behaviour_prompts`, and waves beside walking, at 2 to 8 s. A wave is told
from a raise by the reversals of the hand's path while the hand is up (`common.predicates.hand_waves`). Captured waves
are cut to the same length from their start, so that raising the hand takes the same share of a clip. Writes JSON, and a
Markdown table beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from kinegraph import MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph_benchmarks.common import predicates as p
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.behaviour_prompts import ACTIONS
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.quality.behaviour import SPLITS
from kinegraph_training.data.clips import MotionClip, read_split

SECONDS: Final = (2.0, 3.0, 4.0, 6.0, 8.0)
HANDS: Final = ("left", "right", "both")
WALKING: Final = "a person walks forward while waving {hand}"


def hand_of(action: str) -> str:
    """Return the hand that a label names: "left", "right" or "both"."""
    return next(hand for hand in HANDS if hand in action)


def asked_hands(hand: str) -> tuple[str, ...]:
    """Return the sides that wave: one, or two for "both"."""
    return p.SIDES if hand == "both" else (hand,)


def wave_width(joints: FloatArray, hand: str) -> float:
    """Measure the median stroke of the waving hands, metres; of the smaller wave for "both", 0 without a stroke."""
    strokes = [p.wave_strokes(joints, side) for side in asked_hands(hand)]
    return min(float(np.median(lengths)) if len(lengths) else 0.0 for lengths in strokes)


def wide_reversals(joints: FloatArray, hand: str) -> int:
    """Count the reversals of at least `WIDE_STROKE` while the hand is up; those of the lesser wave for "both"."""
    return min(
        sum(len(p.turning_points(path[:, 0], p.WIDE_STROKE)) for path in p.raised_hand_paths(joints, side))
        for side in asked_hands(hand)
    )


def measure_clips(clips: Sequence[tuple[str, FloatArray]], holds: Callable[[str], p.Predicate]) -> dict[str, float]:
    """Average over clips.

    Args:
        clips: hand that should wave, and joints (frames, 22, 3), of each.
        holds: makes the predicate of a hand.
    """
    return {
        "clips": len(clips),
        "rate": float(np.mean([holds(hand)(joints) for hand, joints in clips])),
        "width_cm": float(np.median([100 * wave_width(joints, hand) for hand, joints in clips])),
        "reversals": float(np.mean([wide_reversals(joints, hand) for hand, joints in clips])),
    }


def generated_clips(pipe: MotionPipeline, kind: str, seconds: float, seeds: int) -> list[tuple[str, FloatArray]]:
    """Generate the waves ("wave") or raises ("raise-up") of `ACTIONS`, or waves beside walking ("walk")."""
    if kind == "walk":
        named = {"left": "the left hand", "right": "the right hand", "both": "both hands"}
        prompts = [(hand, WALKING.format(hand=named[hand])) for hand in HANDS]
    else:
        behaviours = [behaviour for behaviour in ACTIONS if behaviour.action.startswith(kind)]
        prompts = [(hand_of(behaviour.action), text) for behaviour in behaviours for text in behaviour.prompts]
    return [
        (hand, pipe.generate(text, seconds=seconds, seed=seed).joints)
        for hand, text in prompts
        for seed in range(seeds)
    ]


def captured_clips(clips: Sequence[MotionClip], seconds: float, style: str | None) -> list[tuple[str, FloatArray]]:
    """Cut the captured waves of a style, or of all, to their first seconds; those that are shorter stay whole."""
    waves = [clip for clip in clips if clip.action.startswith("wave") and style in (None, clip.style)]
    return [(hand_of(clip.action), clip.joints[: round(seconds * p.FPS)]) for clip in waves]


def measure_length(pipe: MotionPipeline, clips: Sequence[MotionClip], seconds: float, seeds: int) -> dict[str, Any]:
    """Measure captured and generated clips of one length: one row of the table."""
    raises = generated_clips(pipe, "raise-up", seconds, seeds)
    return {
        "seconds": seconds,
        "captured": measure_clips(captured_clips(clips, seconds, None), p.waves),
        "captured_normal": measure_clips(captured_clips(clips, seconds, "normal"), p.waves),
        "waves": measure_clips(generated_clips(pipe, "wave", seconds, seeds), p.waves),
        "walking": measure_clips(generated_clips(pipe, "walk", seconds, seeds), p.waves_beside),
        "raises": {
            "clips": len(raises),
            "wave": float(np.mean([any(p.hand_waves(joints, side) for side in p.SIDES) for _, joints in raises])),
        },
    }


def markdown_table(bundle: str, rows: Sequence[dict[str, Any]]) -> str:
    """Format a result as Markdown: rate, width and reversals of each group of clips."""
    groups = {
        "captured": "captured waves",
        "captured_normal": "captured, normal style",
        "waves": "generated waves",
        "walking": "generated, walking and waving",
    }
    lines = [f"{bundle}: rate of clips that wave, width of a stroke in cm, wide reversals a clip", ""]
    lines.append("| length | " + " | ".join(groups.values()) + " | generated raises that wave |")
    lines.append("|---" * (len(groups) + 2) + "|")
    for row in rows:
        cells = [
            f"{row[group]['rate']:.2f}, {row[group]['width_cm']:.0f} cm, {row[group]['reversals']:.1f}"
            for group in groups
        ]
        lines.append(f"| {row['seconds']:g} s | " + " | ".join(cells) + f" | {row['raises']['wave']:.2f} |")
    counts = ", ".join(f"{rows[-1][group]['clips']} {name}" for group, name in groups.items())
    lines += [
        "",
        f"Clips a cell: {counts}, {rows[-1]['raises']['clips']} generated raises.",
        "Captured clips are cut to their first seconds. A feminine wave is one of the wrist: its width is 2 cm.",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "data", "bundle", "out", seeds=10)
    options = parser.parse_args()
    pipe = MotionPipeline.load(options.bundle, threads=1)
    clips = [clip for split in SPLITS for clip in read_split(options.data, split)]
    rows = [measure_length(pipe, clips, seconds, options.seeds) for seconds in SECONDS]
    bundle = f"{pipe.manifest.name} {pipe.manifest.version}"
    write_report(options.out, {"bundle": bundle, "rows": rows}, markdown_table(bundle, rows))


if __name__ == "__main__":
    main()
