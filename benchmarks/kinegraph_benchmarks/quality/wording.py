"""Measure whether everyday wording is taken at its word: clockwise, short orders, lengths said and lengths not said.

    python -m kinegraph_benchmarks.quality.wording --data DATA/bandai --out wording.json

Clockwise, seen from above, is to the right, in all spellings. "walks forward, then bows" must hold both in their order
at 3 to 8 seconds; captured clips joined to the same lengths are judged beside them, in the right order and in the wrong
one. A length in words is kept. None of 30 everyday sentences gets the longest length there is, which is what a model
says that does not know. Writes JSON, and a Markdown table beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from kinegraph import MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph.motion.turning import net_turn
from kinegraph_benchmarks.common import predicates as p
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.two_action_set import happen_in_order
from kinegraph_benchmarks.common.window_actions import ACTIONS, middle_window
from kinegraph_benchmarks.quality.behaviour import SPLITS
from kinegraph_training.data.clips import MotionClip, read_split
from kinegraph_training.synthetic.compositions import BLEND, stitch_clips

TURN_SECONDS: Final = 5.0
SPELLINGS: Final = {
    "clockwise": "right",
    "Clockwise": "right",
    "counterclockwise": "left",
    "counter-clockwise": "left",
    "counter clockwise": "left",
    "Counter-Clockwise": "left",
    "anticlockwise": "left",
    "anti-clockwise": "left",
    "anti clockwise": "left",
}
"""Side that each spelling turns to, seen from above."""
TURNS: Final = (
    "a person walks and turns {way}",
    "someone turns {way} while walking",
    "a person turns {way}",
    "a person walks in a circle {way}",
    "a person walks {way} in a circle",
)
"""A bundle that knows no circles does not turn in the last two, whatever their side."""

ORDERS: Final = (
    ("a person walks forward, then bows", "walk", "bow"),
    ("a person walks forward and then a person bows", "walk", "bow"),
    ("a person bows, then walks forward", "bow", "walk"),
    ("a person walks forward, then raises the right hand", "walk", "raise-up right"),
    ("a person runs forward, then bows", "run", "bow"),
    ("a person raises both hands, then walks forward", "raise-up both", "walk"),
)
"""Sentences with the names of their actions."""
ORDER_SECONDS: Final = (3.0, 4.0, 6.0, 8.0)
GOAL_SECONDS: Final = (4.0, 6.0)
"""Lengths at which every clip should hold both actions."""

SAID: Final = (
    ("a person walks for four seconds", 4.0),
    ("a person walks forward for 3 seconds", 3.0),
    ("someone waves the right hand for six seconds", 6.0),
    ("a man runs for 2.5 seconds", 2.5),
    ("a person raises both hands for two seconds", 2.0),
    ("walk for five seconds", 5.0),
)
"""Sentences that say their length, and the length."""
SAID_TOLERANCE: Final = 0.1

EVERYDAY: Final = (
    "a person walks forward", "someone runs", "a man is walking backwards", "a person stands still",
    "a person does not move", "a woman jumps up", "a person jumps forward", "a person kicks with the right foot",
    "someone throws a punch", "a person crouches down", "a person falls down", "a person gets up from the ground",
    "a person picks something up from the floor", "someone reaches up high with the right hand",
    "a person waves hello", "a man waves with both hands", "a person raises the left arm", "a person bows politely",
    "someone steps to the left", "a person turns around on the spot", "a person walks in a circle",
    "she turns right while walking", "he walks slowly", "a child skips along", "a person dances",
    "someone sits down on a chair", "a person walks, then stops", "a person claps the hands", "a man limps forward",
    "someone looks around",
)  # fmt: skip
"""Sentences that say no length; the default bundle was not trained on all of these actions."""


def measure_turns(pipe: MotionPipeline, seeds: int) -> list[dict[str, Any]]:
    """Measure how often each spelling turns to its side: one row a sentence."""
    rows = []
    for way, side in SPELLINGS.items():
        for sentence in (turn.format(way=way) for turn in TURNS):
            clips = [pipe.generate(sentence, seconds=TURN_SECONDS, seed=seed).joints for seed in range(seeds)]
            holds = circles(side) if "circle" in sentence else p.turns(side)
            rate = float(np.mean([holds(joints) for joints in clips]))
            rows.append({"sentence": sentence, "way": way, "side": side, "rate": rate})
    return rows


def circles(side: str) -> p.Predicate:
    """Make a predicate: the body turns to that side by more than captured turns do, up to a round and a half."""
    sign = 1.0 if side == "left" else -1.0
    return lambda joints: p.MOST_TURN < sign * net_turn(joints) < 540.0


def holds_in_order(joints: FloatArray, first: str, second: str) -> bool:
    """Tell whether both actions, keys of `ACTIONS`, happen in a clip, and in this order."""
    return happen_in_order(joints, ACTIONS[first].holds, ACTIONS[second].holds)


def measure_orders(pipe: MotionPipeline, seeds: int) -> list[dict[str, Any]]:
    """Measure how often each sentence holds both actions in their order, at each length: one row a sentence."""
    rows = []
    for sentence, first, second in ORDERS:
        rates = {}
        for seconds in ORDER_SECONDS:
            clips = [pipe.generate(sentence, seconds=seconds, seed=seed).joints for seed in range(seeds)]
            rates[f"{seconds:g}"] = float(np.mean([holds_in_order(joints, first, second) for joints in clips]))
        rows.append({"sentence": sentence, "first": first, "second": second, "rates": rates})
    return rows


def check_orders(clips: Sequence[MotionClip], count: int = 10) -> dict[str, dict[str, float]]:
    """Judge captured clips joined to each length in the same way.

    Args:
        clips: captured clips; those of the normal style are joined.
        count: joined clips for each order and length.

    Returns:
        By length: share of the joined clips that hold (`right`), and of those joined the other way round (`wrong`).
    """
    report = {}
    for seconds in ORDER_SECONDS:
        held: dict[str, list[bool]] = {"right": [], "wrong": []}
        for _, first, second in ORDERS:
            sources = [
                [clip.joints for clip in clips if clip.action == ACTIONS[name].label and clip.style == "normal"]
                for name in (first, second)
            ]
            half = (seconds + BLEND / p.FPS) / 2
            for index in range(count):
                one, other = (middle_window(motions[index % len(motions)], half) for motions in sources)
                held["right"].append(holds_in_order(stitch_clips(one, other), first, second))
                held["wrong"].append(holds_in_order(stitch_clips(other, one), first, second))
        report[f"{seconds:g}"] = {name: float(np.mean(values)) for name, values in held.items()}
    return report


def measure_lengths(pipe: MotionPipeline) -> dict[str, Any]:
    """Measure the lengths of sentences that say one and of those that do not."""
    longest = pipe.manifest.seconds_limits[1]
    said = [
        {"sentence": text, "asked": seconds, "seconds": pipe.generate(text, seed=0).duration} for text, seconds in SAID
    ]
    everyday = [{"sentence": text, "seconds": pipe.generate(text, seed=0).duration} for text in EVERYDAY]
    return {
        "longest": longest,
        "said": said,
        "said_kept": float(np.mean([abs(row["seconds"] - row["asked"]) <= SAID_TOLERANCE for row in said])),
        "everyday": everyday,
        "at_longest": sum(row["seconds"] >= longest - 0.5 / p.FPS for row in everyday),
    }


def markdown_table(result: Mapping[str, Any]) -> str:
    """Format a result as Markdown."""
    lines = [f"{result['bundle']}, {result['seeds']} seeds a sentence", ""]
    lines += ["| spelling | turns to the | " + " | ".join(turn.format(way="...") for turn in TURNS) + " |"]
    lines.append("|---" * (2 + len(TURNS)) + "|")
    for way, side in SPELLINGS.items():
        rates = [f"{row['rate']:.2f}" for row in result["turns"] if row["way"] == way]
        lines.append(f"| {way} | {side} | " + " | ".join(rates) + " |")
    names = [f"{seconds:g}" for seconds in ORDER_SECONDS]
    lines += ["", "| both actions, in order | " + " | ".join(f"{name} s" for name in names) + " |"]
    lines.append("|---" * (1 + len(names)) + "|")
    for row in result["orders"]:
        lines.append(f"| {row['sentence']} | " + " | ".join(f"{row['rates'][name]:.2f}" for name in names) + " |")
    for name, title in (("right", "captured clips joined in this order"), ("wrong", "joined in the other order")):
        cells = " | ".join(f"{result['captured_orders'][length][name]:.2f}" for length in names)
        lines.append(f"| {title} | {cells} |")
    lengths = result["lengths"]
    lines += ["", "| a length in words | asked, s | got, s |", "|---|---|---|"]
    lines += [f"| {row['sentence']} | {row['asked']:g} | {row['seconds']:.2f} |" for row in lengths["said"]]
    lines += ["", "| no length in words | got, s |", "|---|---|"]
    lines += [f"| {row['sentence']} | {row['seconds']:.2f} |" for row in lengths["everyday"]]
    lines += [
        "",
        f"{lengths['at_longest']} of {len(lengths['everyday'])} everyday sentences get the longest length,"
        f" {lengths['longest']:g} s; goal: none.",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "data", "bundle", "out", seeds=10)
    options = parser.parse_args()
    pipe = MotionPipeline.load(options.bundle, threads=1)
    clips = [clip for split in SPLITS for clip in read_split(options.data, split)]
    orders = measure_orders(pipe, options.seeds)
    turns = measure_turns(pipe, options.seeds)
    lengths = measure_lengths(pipe)
    result = {
        "bundle": f"{pipe.manifest.name} {pipe.manifest.version}",
        "seeds": options.seeds,
        "met": {
            "turns": bool(min(row["rate"] for row in turns if "circle" not in row["sentence"]) == 1.0),
            "circles": bool(min(row["rate"] for row in turns if "circle" in row["sentence"]) == 1.0),
            "orders": bool(min(row["rates"][f"{s:g}"] for row in orders for s in GOAL_SECONDS) == 1.0),
            "said": lengths["said_kept"] == 1.0,
            "everyday": lengths["at_longest"] == 0,
        },
        "turns": turns,
        "orders": orders,
        "captured_orders": check_orders(clips),
        "lengths": lengths,
    }
    write_report(options.out, result, markdown_table(result))


if __name__ == "__main__":
    main()
