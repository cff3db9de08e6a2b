"""Measure two texts one after the other: joined, continued from the last pose, or composed in one run (Eq. 11).

    python -m kinegraph_benchmarks.quality.temporal_composition --data DATA/bandai \
        --held-out DATA/held_out_pairs.json --out temporal_composition.json

    ... --clips N                   of the set (all)
    ... --seeds N                   of each (1)

EnergyMoGen's Table 5 in kind: captured clips of two actions, joined as in training (`common.two_action_set`), say what
is asked for and how long each part is. A row is a way to make both: "blend", "continue" and "energy" of
`MotionPipeline.sequence`, and one sentence of both. Each part's own motion is judged beside its caption (R-precision,
in groups), the whole beside the captured ones (FID), and the frames around the change by their transition distance.
"within captured" counts the changes whose distance is within the 95 % of captured motion. Rows "each alone" are parts
made by themselves and joined as the captured ones are, which tells what a space does and what Eq. 11 costs in it. A
bundle without skeleton space has no row "energy". Writes JSON, and a Markdown table beside it.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from kinegraph import MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import FRAMES
from kinegraph.options import LATENT, SEQUENCE_METHODS
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.evaluator import FOLDER, Evaluator
from kinegraph_benchmarks.common.predicates import FPS
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.sample_cache import long_enough
from kinegraph_benchmarks.common.scores import average_repeats
from kinegraph_benchmarks.common.two_action_scores import score_two_actions, transition_distance
from kinegraph_benchmarks.common.two_action_set import TwoActionClip, build_two_action_set
from kinegraph_training.data.clips import MotionClip, read_split
from kinegraph_training.synthetic.compositions import BLEND, HeldOut, stitch_clips

SPLITS: Final = ("val", "dev_test")
ONE_SENTENCE: Final = "one sentence"
EACH_ALONE: Final = {"each alone, latent": LATENT, "each alone, skeleton": FRAMES}
QUANTILE: Final = 0.95
COLUMNS: Final = (
    "crop_r_precision_1", "crop_r_precision_3", "motion_text_score", "motion_motion_score", "fid",
    "transition_distance", "within_captured", "both_hold", "jerk", "foot_skate",
)  # fmt: skip


def make_pair(pipe: MotionPipeline, item: TwoActionClip, method: str, seed: int) -> FloatArray:
    """Make both texts of an item, each as long as its captured part: joints (frames, 22, 3) of the item's length.

    Args:
        pipe: the bundle.
        item: two actions in order.
        method: of `MotionPipeline.sequence`, `ONE_SENTENCE`, or of `EACH_ALONE`.
        seed: of the first part.
    """
    frames = len(item.joints)
    if method == ONE_SENTENCE:
        (seconds,) = possible_seconds(pipe, [frames])
        return pipe.compose([item.caption], seconds=seconds, seed=seed).joints[:frames]
    if method in EACH_ALONE:
        lengths = possible_seconds(pipe, [len(part) for part in item.parts])
        calls = zip(item.texts, lengths, (seed, seed + 1), strict=True)
        space = EACH_ALONE[method]
        return stitch_clips(
            *(pipe.generate(text, seconds=length, seed=own, space=space).joints for text, length, own in calls)
        )[:frames]
    lengths = possible_seconds(pipe, [item.cut, frames - item.cut])
    return pipe.sequence(item.texts, seconds=lengths, seed=seed, method=method).joints[:frames]


def possible_seconds(pipe: MotionPipeline, frames: Sequence[int]) -> list[float]:
    """Convert numbers of frames to seconds, as near as the bundle can make them."""
    shortest, longest = pipe.manifest.seconds_limits
    return [min(max(count / FPS, shortest), longest) for count in frames]


def captured_limit(clips: Sequence[MotionClip]) -> float:
    """Compute the `QUANTILE` of transition distances of captured clips, of windows as long as around a change."""
    distances = [
        transition_distance(clip.joints, cut)
        for clip in clips
        for cut in range(BLEND, max(len(clip.joints) - BLEND, BLEND + 1), 2 * BLEND)
    ]
    return float(np.quantile(distances, QUANTILE))


def measure_method(
    pipe: MotionPipeline, items: Sequence[TwoActionClip], method: str, seeds: int, evaluator: Evaluator, limit: float
) -> dict[str, Any]:
    """Make all items by one method, with several seeds each, and score them."""
    rng = np.random.default_rng(4)
    rows = []
    for take in range(seeds):
        motions = [make_pair(pipe, item, method, 1000 * take + 2 * row) for row, item in enumerate(items)]
        scores = score_two_actions(items, motions, evaluator, rng)
        rows.append(scores | {"within_captured": share_within(items, motions, limit)})
    return average_repeats(rows)


def share_within(items: Sequence[TwoActionClip], motions: Sequence[FloatArray], limit: float) -> float:
    """Compute the share of motions whose change from one action to the other is no larger than a limit, metres."""
    pairs = zip(items, motions, strict=True)
    return float(np.mean([transition_distance(joints, item.cut) <= limit for item, joints in pairs]))


def markdown_table(result: Mapping[str, Any]) -> str:
    """Format a result as Markdown."""
    lines = [
        f"{result['bundle']}, evaluator {result['evaluator']}: {result['clips']} captions of two actions in order,"
        f" {result['seeds']} seeds; transition distance of captured clips up to {100 * result['limit']:.2f} cm (95 %)",
        "",
        "| | " + " | ".join(name.replace("_", " ") for name in COLUMNS) + " |",
        "|---" * (1 + len(COLUMNS)) + "|",
    ]
    for name, scores in result["rows"].items():
        cells = [f"{scores[key]['mean']:.3f}" if key in scores else "-" for key in COLUMNS]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def measure(
    pipe: MotionPipeline, clips: Sequence[MotionClip], items: Sequence[TwoActionClip], seeds: int, evaluator: Evaluator
) -> dict[str, Any]:
    """Measure all methods that a bundle has, beside the captured motion."""
    limit, rng = captured_limit(clips), np.random.default_rng(4)
    captured = [item.joints for item in items]
    own = score_two_actions(items, captured, evaluator, rng) | {"within_captured": share_within(items, captured, limit)}
    rows: dict[str, Any] = {"captured, joined": average_repeats([own])}
    left_out = () if pipe.manifest.frames_part is not None else ("energy", "each alone, skeleton")
    for method in (name for name in (*EACH_ALONE, ONE_SENTENCE, *SEQUENCE_METHODS) if name not in left_out):
        rows[method] = measure_method(pipe, items, method, seeds, evaluator, limit)
        print(f"{method}: FID {rows[method]['fid']['mean']:.3f}", file=sys.stderr)
    return {
        "bundle": f"{pipe.manifest.name} {pipe.manifest.version}",
        "evaluator": evaluator.version,
        "clips": len(items),
        "seeds": seeds,
        "limit": limit,
        "rows": rows,
    }


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--clips", type=int, help="of the set (all)")
    add_arguments(parser, "data", "held_out", "bundle", "out", seeds=1)
    parser.add_argument("--evaluator", type=Path, default=FOLDER, help="folder that export_evaluator wrote")
    options = parser.parse_args()
    clips = [clip for split in SPLITS for clip in long_enough(read_split(options.data, split))]
    items = build_two_action_set(clips, HeldOut.read(options.held_out), "in_order")[: options.clips]
    pipe = MotionPipeline.load(options.bundle, threads=1)
    result = measure(pipe, clips, items, options.seeds, Evaluator(options.evaluator))
    write_report(options.out, result, markdown_table(result))


if __name__ == "__main__":
    main()
