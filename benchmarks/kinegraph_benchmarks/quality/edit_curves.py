"""Do edits do what they say? Weight of one edge from 0 to 3 against a physical quantity (GraphMotion, Figures 5 and 6).

    python -m kinegraph_benchmarks.quality.edit_curves --out edit_curves.json

Each curve turns one edge of one caption's graph, over the same seeds at every weight. It counts as met where the mean
over seeds is monotone (Spearman 0.8 or more, in the sense expected) and moves from weight 0 to 3 by the standard
deviation over seeds at weight 1 or more. Writes JSON, and a Markdown table beside it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinegraph import MotionPipeline, SemanticGraph
from kinegraph.arrays import FloatArray
from kinegraph.edits import with_weight
from kinegraph.motion.skeleton import JOINT_INDEX
from kinegraph_benchmarks.common import predicates as p
from kinegraph_benchmarks.common.report_io import write_report

WEIGHTS = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
MONOTONE, MOVED = 0.8, 1.0


@dataclass(frozen=True)
class Curve:
    """One edge and what it should move."""

    name: str
    caption: str
    node: str
    quantity: Callable[[FloatArray], float]
    sense: int
    """+1: more weight, more of it."""
    unit: str


def higher(side: str) -> Callable[[FloatArray], float]:
    """Mean height of that wrist less that of the other, metres."""
    other = "left" if side == "right" else "right"

    def measured(joints: FloatArray) -> float:
        heights = {each: joints[:, JOINT_INDEX[f"{each}_wrist"], 1].mean() for each in (side, other)}
        return float(heights[side] - heights[other])

    return measured


def share_walking(joints: FloatArray) -> float:
    """Share of frames in which the pelvis moves faster than 0.4 m/s over the floor."""
    step = np.linalg.norm(np.diff(joints[:, 0][:, [0, 2]], axis=0), axis=1) * p.FPS
    return float((np.convolve(step, np.ones(5) / 5, mode="same") > 0.4).mean())


def share_raised(joints: FloatArray) -> float:
    """Share of frames in which a wrist is above the head."""
    wrists = joints[:, [JOINT_INDEX["left_wrist"], JOINT_INDEX["right_wrist"]], 1]
    return float((wrists.max(axis=1) > joints[:, JOINT_INDEX["head"], 1]).mean())


def turned(side: int) -> Callable[[FloatArray], float]:
    """Change of heading to that side, degrees."""
    return lambda joints: side * p.net_turn(joints)


CURVES = (
    Curve("direction, left", "a person walks and turns to the left", "to the left", turned(1), 1, "degrees"),
    Curve("direction, right", "a person walks and turns to the right", "to the right", turned(-1), 1, "degrees"),
    Curve("manner, slower", "a person walks in an exhausted way", "in an exhausted way", p.speed, -1, "m/s"),
    Curve("manner, faster", "a person walks energetically", "energetically", p.speed, 1, "m/s"),
    Curve("body part, right", "a person waves with the right hand", "with the right hand", higher("right"), 1, "m"),
    Curve("body part, left", "a person raises the left hand", "the left hand", higher("left"), 1, "m"),
    Curve("action, first", "a person walks and raises both hands", "walks", share_walking, 1, "share"),
    Curve("action, second", "a person walks and raises both hands", "raises", share_raised, 1, "share"),
)  # fmt: skip


def ranks(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """1 for the smallest; equal values share the mean of their ranks."""
    below = (values[None] < values[:, None]).sum(axis=1)
    return below + ((values[None] == values[:, None]).sum(axis=1) + 1) / 2


def spearman(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    """Rank correlation; 0 where one of them does not change."""
    one, other = ranks(first), ranks(second)
    if one.std() == 0 or other.std() == 0:
        return 0.0
    return float(np.corrcoef(one, other)[0, 1])


def judged(values: NDArray[np.float64], sense: int) -> dict[str, Any]:
    """Of (weights, seeds) values: the curve, how monotone it is, and how far it goes."""
    mean = values.mean(axis=1)
    spread = float(values[WEIGHTS.index(1.0)].std(ddof=1))
    order = sense * spearman(np.array(WEIGHTS), mean)
    way = sense * float(mean[-1] - mean[0])
    moved = way / spread if spread > 0 else 0.0
    return {
        "mean": mean.tolist(),
        "spread": spread,
        "spearman": order,
        "moved": moved,
        "met": order >= MONOTONE and moved >= MOVED,
    }


def measured(pipe: MotionPipeline, curve: Curve, seeds: int, seconds: float) -> dict[str, Any]:
    """One curve; a node that the parser does not find is an error."""
    graph: SemanticGraph = pipe.parse(curve.caption)
    values = [
        [
            curve.quantity(pipe.generate(with_weight(graph, curve.node, weight), seconds=seconds, seed=seed).joints)
            for seed in range(seeds)
        ]
        for weight in WEIGHTS
    ]
    about = {"caption": curve.caption, "node": curve.node, "unit": curve.unit}
    return {**about, **judged(np.array(values), curve.sense)}


def table(results: dict[str, dict[str, Any]]) -> str:
    """Markdown."""
    heads = ["caption", "edge", *(f"w = {weight:g}" for weight in WEIGHTS), "unit", "Spearman", "moved / s.d.", "met"]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for one in results.values():
        cells = [one["caption"], one["node"], *(f"{value:.2f}" for value in one["mean"]), one["unit"]]
        cells += [f"{one['spearman']:.2f}", f"{one['moved']:.2f}", "yes" if one["met"] else "no"]
        lines.append("| " + " | ".join(cells) + " |")
    met = sum(one["met"] for one in results.values())
    return "\n".join(lines) + f"\n\n{met} of {len(results)} curves met.\n"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bundle", type=Path, help="folder of a bundle; the default bundle without it")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--out", type=Path, required=True, help="JSON file; a .md file is written beside it")
    given = parser.parse_args()
    pipe = MotionPipeline.load(given.bundle)
    results = {curve.name: measured(pipe, curve, given.seeds, given.seconds) for curve in CURVES}
    write_report(given.out, results, table(results))


if __name__ == "__main__":
    main()
