"""Measure a physical quantity against the weight of one edge, from 0 to 3 (GraphMotion, Figures 5 and 6).

    python -m kinegraph_benchmarks.quality.edit_curves --out edit_curves.json

Each curve weights one edge of one caption's graph, with the same seeds at every weight. A curve is met if its mean over
seeds is monotone (Spearman 0.8 or more, in the sense expected), and if it moves from weight 0 to 3 by the standard
deviation over seeds at weight 1 or more. `steepest` tells a cliff: the largest share of that way between two weights
that are 0.25 or 0.5 apart. Writes JSON, and a Markdown table beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinegraph import MotionPipeline, SemanticGraph
from kinegraph.arrays import FloatArray
from kinegraph.edits import with_weight
from kinegraph.motion.skeleton import JOINT_INDEX
from kinegraph_benchmarks.common import predicates as p
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_report

WEIGHTS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0)
MONOTONE = 0.8
"""Lowest Spearman correlation of a curve that is met."""
MOVED = 1.0
"""Least change from first to last weight, in standard deviations over seeds."""


@dataclass(frozen=True)
class Curve:
    """One edge and the quantity that its weight should move."""

    name: str
    caption: str
    node: str
    """Text of the node that the edge leads to."""
    quantity: Callable[[FloatArray], float]
    """Joints (frames, 22, 3) -> value in `unit`."""
    sense: int
    """+1: more weight, a larger quantity; -1: a smaller one."""
    unit: str


def wrist_above_other(side: str) -> Callable[[FloatArray], float]:
    """Make a quantity: mean height of that wrist less that of the other, metres."""
    other = "left" if side == "right" else "right"

    def difference(joints: FloatArray) -> float:
        heights = {wrist: joints[:, JOINT_INDEX[f"{wrist}_wrist"], 1].mean() for wrist in (side, other)}
        return float(heights[side] - heights[other])

    return difference


def seconds_walking(joints: FloatArray) -> float:
    """Measure for how long the pelvis moves faster than 0.4 m/s over the floor, seconds."""
    step = np.linalg.norm(np.diff(joints[:, 0][:, [0, 2]], axis=0), axis=1) * p.FPS
    return float((np.convolve(step, np.ones(5) / 5, mode="same") > 0.4).sum() / p.FPS)


def seconds_raised(joints: FloatArray) -> float:
    """Measure for how long a wrist is above the head, seconds."""
    wrists = joints[:, [JOINT_INDEX["left_wrist"], JOINT_INDEX["right_wrist"]], 1]
    return float((wrists.max(axis=1) > joints[:, JOINT_INDEX["head"], 1]).sum() / p.FPS)


def turn_to(side: int) -> Callable[[FloatArray], float]:
    """Make a quantity: change of heading, degrees, to the left (side 1) or to the right (-1)."""
    return lambda joints: side * p.net_turn(joints)


CURVES = (
    Curve("direction, left", "a person walks and turns to the left", "to the left", turn_to(1), 1, "degrees"),
    Curve("direction, right", "a person walks and turns to the right", "to the right", turn_to(-1), 1, "degrees"),
    Curve("manner, slower", "a person walks in an exhausted way", "in an exhausted way", p.speed, -1, "m/s"),
    Curve("manner, faster", "a person walks energetically", "energetically", p.speed, 1, "m/s"),
    Curve("body part, right", "a person waves with the right hand", "with the right hand", wrist_above_other("right"),
          1, "m"),
    Curve("body part, left", "a person raises the left hand", "the left hand", wrist_above_other("left"), 1, "m"),
    Curve("action, first", "a person walks and raises both hands", "walks", seconds_walking, 1, "s"),
    Curve("action, second", "a person walks and raises both hands", "raises", seconds_raised, 1, "s"),
)  # fmt: skip


def ranks(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rank values: 1 for the smallest; equal values share the mean of their ranks."""
    below = (values[None] < values[:, None]).sum(axis=1)
    return below + ((values[None] == values[:, None]).sum(axis=1) + 1) / 2


def spearman(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    """Compute the rank correlation (Spearman); 0 where one of them does not change."""
    first_ranks, second_ranks = ranks(first), ranks(second)
    if first_ranks.std() == 0 or second_ranks.std() == 0:
        return 0.0
    return float(np.corrcoef(first_ranks, second_ranks)[0, 1])


def judge_weights(values: NDArray[np.float64], sense: int, weights: Sequence[float], spread: float) -> dict[str, Any]:
    """Judge a curve: its means, how monotone it is, and how far it moves.

    Args:
        values: (weights, seeds).
        sense: +1 if it should rise, -1 if it should fall.
        weights: in rising order.
        spread: standard deviation over seeds.

    Returns:
        `mean` by weight, `spread`, `spearman`, and `moved`: the way from first to last weight, in spreads.
    """
    mean = values.mean(axis=1)
    way = sense * float(mean[-1] - mean[0])
    return {
        "mean": mean.tolist(),
        "spread": spread,
        "spearman": sense * spearman(np.array(weights), mean),
        "moved": way / spread if spread > 0 else 0.0,
    }


def judge_curve(values: NDArray[np.float64], sense: int) -> dict[str, Any]:
    """Judge a curve over `WEIGHTS` (`judge_weights`), how steep it is, and whether it is met."""
    judged = judge_weights(values, sense, WEIGHTS, float(values[WEIGHTS.index(1.0)].std(ddof=1)))
    steps = np.abs(np.diff(judged["mean"]))
    steepest = float(steps.max() / np.ptp(judged["mean"])) if steps.any() else 0.0
    return {**judged, "steepest": steepest, "met": judged["spearman"] >= MONOTONE and judged["moved"] >= MOVED}


def measure_curve(pipe: MotionPipeline, curve: Curve, seeds: int, seconds: float) -> dict[str, Any]:
    """Measure and judge one curve.

    Raises:
        InvalidInputError: the parser finds no such node in the caption.
    """
    graph: SemanticGraph = pipe.parse(curve.caption)
    values = [
        [
            curve.quantity(pipe.generate(with_weight(graph, curve.node, weight), seconds=seconds, seed=seed).joints)
            for seed in range(seeds)
        ]
        for weight in WEIGHTS
    ]
    description = {"caption": curve.caption, "node": curve.node, "unit": curve.unit}
    return {**description, **judge_curve(np.array(values), curve.sense)}


def markdown_table(results: dict[str, dict[str, Any]]) -> str:
    """Format results as Markdown, one line for each curve."""
    heads = [
        "caption",
        "edge",
        *(f"w = {weight:g}" for weight in WEIGHTS),
        "unit",
        "Spearman",
        "moved / s.d.",
        "steepest",
        "met",
    ]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for curve in results.values():
        cells = [curve["caption"], curve["node"], *(f"{value:.2f}" for value in curve["mean"]), curve["unit"]]
        cells += [f"{curve[name]:.2f}" for name in ("spearman", "moved", "steepest")]
        cells += ["yes" if curve["met"] else "no"]
        lines.append("| " + " | ".join(cells) + " |")
    met = sum(curve["met"] for curve in results.values())
    return "\n".join(lines) + f"\n\n{met} of {len(results)} curves met.\n"


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "bundle", "out", seeds=10)
    parser.add_argument("--seconds", type=float, default=4.0, help="length of the clips (4)")
    options = parser.parse_args()
    pipe = MotionPipeline.load(options.bundle)
    results = {curve.name: measure_curve(pipe, curve, options.seeds, options.seconds) for curve in CURVES}
    write_report(options.out, results, markdown_table(results))


if __name__ == "__main__":
    main()
