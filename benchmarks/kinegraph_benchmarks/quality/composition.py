"""Measure composition of one bundle or several: two and three concepts by method, leaks, negations, and weights.

    python -m kinegraph_benchmarks.quality.composition --out composition.json

    ... --bundles A B               folders or names of bundles; the default bundle without it
    ... --only pairs curves         parts: pairs, triples, uncalled, negation, curves
    ... --spaces latent frames      in skeleton space as well, of a bundle that has it

Pairs are those of `quality.composition_settings`, which training never joins; of three concepts, one is of the legs
and one of each hand. A single sentence must not do more than it says: gestures do not travel, and travelling raises no
hand. A curve weights one concept beside another of weight 1 (EnergyMoGen, Eq. 7-10); it is met if it rises with the
weight (Spearman 0.9 or more) and spans 3 standard deviations over seeds or more, root mean square over the weights. The
runtime generates the clips, with the same seeds everywhere. Writes JSON, and a Markdown table beside it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from kinegraph import Concept, MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph.motion.skeleton import JOINT_INDEX
from kinegraph.options import LATENT, SPACES
from kinegraph_benchmarks.common import predicates as p
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.everyday_rules import travel
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.two_action_set import BESIDE, GESTURES
from kinegraph_benchmarks.quality.composition_settings import PAIRS, SECONDS, WORDS, joint_text, measure_negation
from kinegraph_benchmarks.quality.edit_curves import judge_weights
from kinegraph_benchmarks.quality.everyday import bundle_name
from kinegraph_benchmarks.quality.negations import hand_up

PAPER_LAMBDAS: Final = (0.1, 0.7, 0.2)
"""Shares of latent, semantic and joint text of EnergyMoGen (section 4.1)."""
METHODS: Final[Mapping[str, Mapping[str, Any]]] = {
    "latent": {"method": "latent"},
    "semantic": {"method": "semantic"},
    "0.1/0.7/0.2": {"method": "fused", "lambdas": PAPER_LAMBDAS},
    "fused": {"method": "fused"},
    "parts": {"method": "parts"},
    "default": {},
}
"""Options of `compose` by the name of a row."""
SENTENCE: Final = "one sentence"
"""Row of the sentence that says all of it."""

LEGS: Final = ("walk", "run", "walk-turn-left", "walk-turn-right")
HANDS: Final = (("raise-up-left-hand", "wave-right-hand"), ("wave-left-hand", "raise-up-right-hand"))
TRIPLES: Final = tuple((legs, *hands) for legs in LEGS for hands in HANDS)
GERUNDS: Final = {
    "raise-up-left-hand": "raising the left hand",
    "raise-up-right-hand": "raising the right hand",
    "wave-left-hand": "waving the left hand",
    "wave-right-hand": "waving the right hand",
}
TRAVELS: Final = (*LEGS, "walk-back")
NEGATIONS: Final = (-0.5, -1.0)
PARTS: Final = ("pairs", "triples", "uncalled", "negation", "curves")

WEIGHTS: Final = (0.1, 0.25, 0.5, 1.0, 1.5, 2.0)
MONOTONE: Final = 0.9
MOVED: Final = 3.0
GOAL_CURVES: Final = 6
CURVE_METHODS: Final = ("latent", "semantic", "fused")


@dataclass(frozen=True)
class WeightCurve:
    """A concept whose weight varies beside another one, and the quantity that it should raise."""

    beside: str
    """Key of `WORDS`, with weight 1."""
    weighted: str
    """Key of `WORDS`."""
    quantity: Callable[[FloatArray], float]
    """Joints (frames, 22, 3) -> value in `unit`."""
    unit: str


def hand_over_head(*sides: str) -> Callable[[FloatArray], float]:
    """Make a quantity: highest point of these wrists over the head joint, metres, their mean."""
    wrists = [JOINT_INDEX[f"{side}_wrist"] for side in sides]
    return lambda joints: float((joints[:, wrists, 1] - joints[:, [JOINT_INDEX["head"]], 1]).max(axis=0).mean())


def metres(axis: int, sign: float) -> Callable[[FloatArray], float]:
    """Make a quantity: how far the body goes to the left (axis 0) or ahead (1) as it faces, times `sign`, metres."""
    return lambda joints: float(sign * travel(joints)[axis])


CURVES: Final = (
    WeightCurve("walk", "raise-up-both-hands", hand_over_head("left", "right"), "m over the head"),
    WeightCurve("walk", "raise-up-right-hand", hand_over_head("right"), "m over the head"),
    WeightCurve("run", "raise-up-left-hand", hand_over_head("left"), "m over the head"),
    WeightCurve("walk", "walk-turn-left", p.net_turn, "degrees to the left"),
    WeightCurve("walk", "walk-turn-right", lambda joints: -p.net_turn(joints), "degrees to the right"),
    WeightCurve("walk", "run", p.speed, "m/s"),
    WeightCurve("raise-up-both-hands", "walk", metres(1, 1.0), "m ahead"),
    WeightCurve("wave-right-hand", "walk-back", metres(1, -1.0), "m back"),
)


def sentence_for(actions: Sequence[str]) -> str:
    """Write one sentence that says two actions (`joint_text`) or three."""
    if len(actions) == 2:
        return joint_text((actions[0], actions[1]))
    first, *hands = actions
    return f"{WORDS[first]} while {' and '.join(GERUNDS[hand] for hand in hands)}"


def generate_together(
    pipe: MotionPipeline, actions: Sequence[str], method: str, seeds: int, **options: Any
) -> list[FloatArray]:
    """Generate clips of several actions at once, by a key of `METHODS` or by `SENTENCE`, one a seed.

    `options` are keywords that `generate` and `compose` have in common.
    """
    if method == SENTENCE:
        text = sentence_for(actions)
        return [pipe.generate(text, seconds=SECONDS, seed=seed, **options).joints for seed in range(seeds)]
    concepts, how = [WORDS[action] for action in actions], {**METHODS[method], **options}
    return [pipe.compose(concepts, seconds=SECONDS, seed=seed, **how).joints for seed in range(seeds)]


def measure_together(
    pipe: MotionPipeline,
    sets: Sequence[Sequence[str]],
    seeds: int,
    methods: Sequence[str] = (*METHODS, SENTENCE),
    **options: Any,
) -> dict[str, Any]:
    """Measure by method how often all actions of a set happen, and each of them, over all sets and seeds."""
    rows: dict[str, Any] = {}
    for method in methods:
        held = {
            " + ".join(actions): np.array(
                [
                    [BESIDE[action](joints) for action in actions]
                    for joints in generate_together(pipe, actions, method, seeds, **options)
                ]
            )
            for actions in sets
        }
        rows[method] = {
            "all": float(np.mean([clips.all(axis=1).mean() for clips in held.values()])),
            "each": np.mean([clips.mean(axis=0) for clips in held.values()], axis=0).tolist(),
            "by_set": {name: float(clips.all(axis=1).mean()) for name, clips in held.items()},
        }
    return rows


def measure_uncalled(pipe: MotionPipeline, seeds: int, **options: Any) -> dict[str, Any]:
    """Measure what single sentences do that nobody asked for.

    Returns:
        By sentence the share of clips: gestures that end 0.5 m away or more, travels in which a hand is up.
    """
    rows: dict[str, float] = {}
    asked = [(action, lambda joints: not p.stands(joints)) for action in GESTURES]
    asked += [(action, hand_up("left", "right")) for action in TRAVELS]
    for action, leaks in asked:
        how = {"seconds": SECONDS, **options}
        clips = [pipe.generate(WORDS[action], seed=seed, **how).joints for seed in range(seeds)]
        rows[WORDS[action]] = float(np.mean([leaks(joints) for joints in clips]))
    return {
        "travel": float(np.mean([rows[WORDS[action]] for action in GESTURES])),
        "gesture": float(np.mean([rows[WORDS[action]] for action in TRAVELS])),
        "by_sentence": rows,
    }


def measure_curves(pipe: MotionPipeline, seeds: int, **options: Any) -> dict[str, Any]:
    """Measure every curve by each of `CURVE_METHODS`: means by weight, Spearman, range in s.d. of seeds, met or not."""
    report: dict[str, Any] = {}
    for method in CURVE_METHODS:
        rows = []
        for curve in CURVES:
            values = np.array([
                [
                    curve.quantity(
                        pipe.compose(
                            [WORDS[curve.beside], Concept(WORDS[curve.weighted], weight)],
                            seconds=SECONDS, seed=seed, **METHODS[method], **options,
                        ).joints
                    )
                    for seed in range(seeds)
                ]
                for weight in WEIGHTS
            ])  # fmt: skip
            # over all weights: at a weight where every clip does the same, seeds do not differ
            spread = float(np.sqrt(values.var(axis=1, ddof=1).mean()))
            judged = judge_weights(values, 1, WEIGHTS, spread)
            judged["met"] = judged["spearman"] >= MONOTONE and judged["moved"] >= MOVED
            rows.append({"beside": curve.beside, "weighted": curve.weighted, "unit": curve.unit, **judged})
        report[method] = {"curves": rows, "met": sum(row["met"] for row in rows)}
    return report


MEASURES: Final[Mapping[str, Callable[..., Any]]] = {
    "pairs": lambda pipe, seeds, **options: measure_together(pipe, PAIRS, seeds, **options),
    "triples": lambda pipe, seeds, **options: measure_together(pipe, TRIPLES, seeds, **options),
    "uncalled": measure_uncalled,
    "negation": lambda pipe, seeds, **options: {
        f"{weight:g}": measure_negation(pipe, seeds, weight, **options) for weight in NEGATIONS
    },
    "curves": measure_curves,
}
"""Measure of each of `PARTS`: bundle, number of seeds, and keywords of `generate` and `compose` -> what is written."""


def markdown_table(result: Mapping[str, Any]) -> str:
    """Format a result as Markdown: a table of rates with a column a bundle, then the curves of each bundle."""
    bundles = result["bundles"]
    lines = [f"{len(PAIRS)} pairs, {len(TRIPLES)} triples, {result['seeds']} seeds", ""]
    lines += ["| | " + " | ".join(bundles) + " |", "|---" * (1 + len(bundles)) + "|"]
    rows: dict[str, list[str]] = {}
    for parts in bundles.values():
        for name, value in _rates(parts).items():
            rows.setdefault(name, []).append(f"{value:.3f}")
    lines += [f"| {name} | " + " | ".join(cells) + " |" for name, cells in rows.items()]
    for bundle, parts in bundles.items():
        for method, report in parts.get("curves", {}).items():
            heads = [f"{method}: weight of", *(f"{weight:g}" for weight in WEIGHTS), "unit", "Spearman", "range / s.d."]
            lines += [
                "",
                f"**{bundle}**",
                "",
                "| " + " | ".join([*heads, "met"]) + " |",
                "|---" * (len(heads) + 1) + "|",
            ]
            for row in report["curves"]:
                cells = [f"{row['weighted']} beside {row['beside']}", *(f"{value:.2f}" for value in row["mean"])]
                cells += [row["unit"], f"{row['spearman']:.2f}", f"{row['moved']:.1f}", "yes" if row["met"] else "no"]
                lines.append("| " + " | ".join(cells) + " |")
            lines.append(f"\n{report['met']} of {len(report['curves'])} curves met; goal {GOAL_CURVES}.")
    return "\n".join(lines) + "\n"


def _rates(parts: Mapping[str, Any]) -> dict[str, float]:
    """List the single rates of a bundle by the name of their row."""
    rates = {
        f"{title}, {method}": row["all"]
        for part, title in (("pairs", "both"), ("triples", "all three"))
        for method, row in parts.get(part, {}).items()
    }
    if "uncalled" in parts:
        rates |= {
            "gestures that travel": parts["uncalled"]["travel"],
            "travels with a hand up": parts["uncalled"]["gesture"],
        }
    for weight, row in parts.get("negation", {}).items():
        rates |= {f"negation {weight}, falls by": row["fallen_by"], f"negation {weight}, the first keeps": row["kept"]}
    return rates


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "out", seeds=10)
    parser.add_argument(
        "--bundles", nargs="+", default=[None], help="folders or names of bundles; the default bundle without it"
    )
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS, help="parts that are measured (all)")
    parser.add_argument("--spaces", nargs="+", choices=SPACES, default=[LATENT], help="frames: skeleton space, too")
    parser.add_argument("--threads", type=int, default=1, help="threads of a model (1)")
    options = parser.parse_args()
    result: dict[str, Any] = {"seeds": options.seeds, "bundles": {}}
    # All before the first is measured: a bundle that cannot be read is told at once.
    for pipe in [MotionPipeline.load(bundle, threads=options.threads) for bundle in options.bundles]:
        plain = bundle_name(pipe, tuple(result["bundles"]))
        for space in options.spaces:
            name = plain if space == LATENT else f"{plain}, {space}"
            result["bundles"][name] = {}
            for part in options.only:
                result["bundles"][name][part] = MEASURES[part](pipe, options.seeds, space=space)
                print(f"{name}: {part} measured", file=sys.stderr)
    write_report(options.out, result, markdown_table(result))


if __name__ == "__main__":
    main()
