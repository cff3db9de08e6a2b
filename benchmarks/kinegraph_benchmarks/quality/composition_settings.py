"""Compare ways of composing on pairs of actions that were never joined in training, with the same seeds for each.

    python -m kinegraph_benchmarks.quality.composition_settings --data DATA/bandai \
        --held-out DATA/held_out_pairs.json --out settings.json

    ... --seeds 2                   a quick look
    ... --only "fused, AGD"         only rows that begin with this, no negations; --only negation: negations alone

Measures how often both actions happen, how natural the motion looks (Fréchet distance of its embedding to spliced
captured clips, foot skate, jerk, transition distance), and what a negation takes away and leaves (EnergyMoGen, Tables 7
and 9). The runtime generates the clips; the bundle needs the graphs of adaptive gradient descent (AGD). Writes JSON,
and a Markdown table beside it; a stopped run continues after its last row.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph import Concept, MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.evaluator import Evaluator
from kinegraph_benchmarks.common.report_io import write_json, write_report
from kinegraph_benchmarks.common.sample_cache import long_enough
from kinegraph_benchmarks.common.two_action_scores import transition_distance
from kinegraph_benchmarks.common.two_action_set import BESIDE, build_two_action_set
from kinegraph_training import metrics
from kinegraph_training.data.clips import read_split
from kinegraph_training.metrics import frechet_distance
from kinegraph_training.synthetic.compositions import HeldOut

SECONDS = 4.0
"""Length of every clip."""

WORDS = {
    "walk": "a person walks forward",
    "run": "a person runs forward",
    "walk-back": "a person walks backward",
    "walk-turn-left": "a person walks and turns left",
    "walk-turn-right": "a person walks and turns right",
    "raise-up-left-hand": "a person raises the left hand",
    "raise-up-right-hand": "a person raises the right hand",
    "raise-up-both-hands": "a person raises both hands",
    "wave-left-hand": "a person waves the left hand",
    "wave-right-hand": "a person waves the right hand",
    "wave-both-hands": "a person waves both hands",
}
"""Prompt of each action."""
PAIRS = (
    ("walk", "raise-up-both-hands"), ("walk", "wave-right-hand"), ("run", "raise-up-left-hand"),
    ("run", "wave-both-hands"), ("run", "wave-right-hand"), ("walk-turn-left", "wave-both-hands"),
    ("walk-turn-left", "raise-up-left-hand"), ("walk-turn-right", "raise-up-right-hand"),
    ("walk-turn-right", "wave-left-hand"), ("walk-back", "raise-up-both-hands"),
    ("raise-up-left-hand", "wave-right-hand"), ("wave-left-hand", "raise-up-right-hand"),
)  # fmt: skip

LAMBDAS = (
    (0.1, 0.7, 0.2), (0.3, 0.5, 0.2), (0.3, 0.3, 0.4), (0.0, 0.5, 0.5), (0.1, 0.3, 0.6), (0.2, 0.2, 0.6),
    (0.05, 0.15, 0.8), (0.1, 0.1, 0.8), (0.2, 0.0, 0.8), (0.0, 0.2, 0.8), (0.05, 0.05, 0.9), (0.1, 0.0, 0.9),
    (0.0, 0.1, 0.9),
)  # fmt: skip
"""Shares of latent, semantic and joint text: those of EnergyMoGen's Table 7, and more of the joint text."""
STEP_SIZES = ((4e-4, 4e-4), (1e-3, 2e-3), (1e-2, 1e-2), (0.1, 0.1), (0.2, 0.2))
"""Step sizes of AGD, gamma_attn and gamma_reg (EnergyMoGen, Table 9)."""
NEGATIONS = (-0.3, -0.5, -0.75, -1.0)
"""Weights."""

Setting = Callable[[MotionPipeline, tuple[str, str], int], FloatArray]
"""A way of composing: bundle, pair of actions, seed -> joints (frames, 22, 3)."""


def joint_text(pair: tuple[str, str]) -> str:
    """Write one sentence for both actions."""
    return f"{WORDS[pair[0]]} while {WORDS[pair[1]]}"


def compose_concepts(**options: Any) -> Setting:
    """Make a setting: both actions as concepts of one `compose` with these options."""

    def generate(pipe: MotionPipeline, pair: tuple[str, str], seed: int) -> FloatArray:
        return pipe.compose([WORDS[action] for action in pair], seconds=SECONDS, seed=seed, **options).joints

    return generate


def compose_joint_text(agd: tuple[float, float]) -> Setting:
    """Make a setting: both actions in one sentence, with adaptive gradient descent."""

    def generate(pipe: MotionPipeline, pair: tuple[str, str], seed: int) -> FloatArray:
        return pipe.compose([joint_text(pair)], agd=agd, seconds=SECONDS, seed=seed).joints

    return generate


def list_settings() -> dict[str, Setting]:
    """List all settings by the name of their row."""
    settings: dict[str, Setting] = {
        "joint text": lambda pipe, pair, seed: pipe.generate(joint_text(pair), seconds=SECONDS, seed=seed).joints,
        "latent": compose_concepts(method="latent"),
        "semantic": compose_concepts(method="semantic"),
        "fused": compose_concepts(method="fused"),
    }
    for lambdas in LAMBDAS:
        settings["fused " + "/".join(f"{share:g}" for share in lambdas)] = compose_concepts(
            method="fused", lambdas=lambdas
        )
    for scale in (1.5, 4.0):
        for method in ("fused", "latent"):
            settings[f"{method}, guidance {scale:g}"] = compose_concepts(method=method, guidance=scale)
    for agd in STEP_SIZES:
        label = f"AGD {agd[0]:g}/{agd[1]:g}"
        settings[f"joint text, {label}"] = compose_joint_text(agd)
        for method in ("fused", "semantic"):
            settings[f"{method}, {label}"] = compose_concepts(method=method, agd=agd)
    return settings


def measure_setting(
    setting: Setting, pipe: MotionPipeline, seeds: int, reference: FloatArray, evaluator: Evaluator
) -> dict[str, Any]:
    """Measure one setting over all pairs and seeds.

    Args:
        setting: generates the clips.
        pipe: the bundle.
        seeds: number of seeds of each pair.
        reference: (n, e) embeddings of spliced captured clips, for the Fréchet distance.
        evaluator: embeds the generated clips.
    """
    motions = {pair: [setting(pipe, pair, seed) for seed in range(seeds)] for pair in PAIRS}
    held = {
        pair: [[bool(BESIDE[action](joints)) for action in pair] for joints in clips] for pair, clips in motions.items()
    }
    everything = [joints for clips in motions.values() for joints in clips]
    return {
        "both": float(np.mean([all(both) for clips in held.values() for both in clips])),
        "first": float(np.mean([first for clips in held.values() for first, _ in clips])),
        "second": float(np.mean([second for clips in held.values() for _, second in clips])),
        "per_pair": {" + ".join(pair): float(np.mean([all(both) for both in clips])) for pair, clips in held.items()},
        "frechet": frechet_distance(evaluator.embed_motions(everything), reference),
        "foot_skate": float(np.nanmean([metrics.foot_skate(joints) for joints in everything])),
        "jerk": float(np.mean([metrics.jerk(joints) for joints in everything])),
        "transition": float(np.mean([transition_distance(joints, None) for joints in everything])),
    }


def measure_negation(pipe: MotionPipeline, seeds: int, weight: float, **options: Any) -> dict[str, Any]:
    """Measure what a negation of the second action takes from the joint text, and what it leaves of the first.

    Pairs whose joint text does not show both actions are left out. The method is the default one; beside one positive
    concept of weight 1, latent and fused are the same. `options` are keywords that `generate` and `compose` have in
    common.
    """
    rows = []
    for pair in PAIRS:
        how = {"seconds": SECONDS, **options}
        plain = [pipe.generate(joint_text(pair), seed=seed, **how).joints for seed in range(seeds)]
        concepts = [Concept(joint_text(pair)), Concept(WORDS[pair[1]], weight)]
        negated = [pipe.compose(concepts, seed=seed, **how).joints for seed in range(seeds)]
        before, after = ([action_rate(action, clips) for action in pair] for clips in (plain, negated))
        if before[1] >= 0.3 and before[0] > 0:
            # at most 1: one pair that comes out better without the second action does not make up for others
            fallen, kept = 1 - after[1] / before[1], min(after[0] / before[0], 1.0)
            rows.append({"pair": " + ".join(pair), "before": before, "after": after, "fallen": fallen, "kept": kept})
    return {
        "rows": rows,
        "fallen_by": float(np.mean([row["fallen"] for row in rows] or [0.0])),
        "kept": float(np.mean([row["kept"] for row in rows] or [0.0])),
        "both_met": sum(row["fallen"] >= 0.5 and row["kept"] >= 0.8 for row in rows),
    }


def measure_similar_negation(pipe: MotionPipeline, seeds: int, weight: float) -> dict[str, float]:
    """Measure what a negation of running leaves of walking with a gesture.

    A negation also takes away what the two actions have in common.
    """
    pairs = [pair for pair in PAIRS if pair[0] == "walk"]
    concepts = {pair: [*(WORDS[action] for action in pair), Concept(WORDS["run"], weight)] for pair in pairs}
    motions = {
        pair: [pipe.compose(concepts[pair], seconds=SECONDS, seed=seed).joints for seed in range(seeds)]
        for pair in pairs
    }
    metres = [
        np.linalg.norm(joints[-1, 0, [0, 2]] - joints[0, 0, [0, 2]]) for clips in motions.values() for joints in clips
    ]
    return {
        "walks": float(np.mean([action_rate("walk", motions[pair]) for pair in pairs])),
        "gesture": float(np.mean([action_rate(pair[1], motions[pair]) for pair in pairs])),
        "metres": float(np.mean(metres)),
    }


def action_rate(action: str, clips: list[FloatArray]) -> float:
    """Compute the share of clips that show an action beside another."""
    return float(np.mean([BESIDE[action](joints) for joints in clips]))


def markdown_table(result: dict[str, Any]) -> str:
    """Format a result as Markdown: settings, negations, and negations of a similar action."""
    columns = ("both", "first", "second", "frechet", "foot_skate", "jerk", "transition")
    lines = [f"{len(PAIRS)} pairs, {result['seeds']} seeds, {result['model']}", ""]
    lines += ["| | " + " | ".join(columns) + " |", "|---|" + "---|" * len(columns)]
    for name, row in result["settings"].items():
        lines.append(f"| {name} | " + " | ".join(f"{row[column]:.3f}" for column in columns) + " |")
    lines += [
        "",
        "| negation of the second action | pairs | its rate falls by | the first keeps | pairs with >= .5 and >= .8 |",
        "|---|---|---|---|---|",
    ]
    for weight, row in result["negation"].items():
        lines.append(
            f"| weight {weight} | {len(row['rows'])} | {row['fallen_by']:.2f} | {row['kept']:.2f} | {row['both_met']} |"
        )
    lines += ["", "| walking with a gesture, not running | walks | gesture | metres in 4 s |", "|---|---|---|---|"]
    for weight, row in result["alike"].items():
        lines.append(f"| weight {weight} | " + " | ".join(f"{value:.2f}" for value in row.values()) + " |")
    return "\n".join(lines) + "\n"


def load_partial_result(path: Path, identity: dict[str, Any]) -> dict[str, Any]:
    """Read the rows that a stopped run of the same model and seeds has left, or start without any.

    Args:
        path: JSON file of the result.
        identity: model and seeds; a file that says otherwise is not continued.
    """
    if path.is_file():
        result: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if all(result.get(key) == value for key, value in identity.items()):
            return result
    return {**identity, "settings": {}, "negation": {}, "alike": {}}


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "data", "held_out", "bundle", "out", seeds=10)
    parser.add_argument("--only", default="", help="only settings whose name begins with this, or negation")
    parser.add_argument("--threads", type=int, help="threads of a model")
    options = parser.parse_args()
    pipe, evaluator = MotionPipeline.load(options.bundle, threads=options.threads), Evaluator()
    clips = [clip for split in ("val", "dev_test") for clip in long_enough(read_split(options.data, split))]
    spliced = build_two_action_set(clips, HeldOut.read(options.held_out), "together")
    reference = evaluator.embed_motions([item.joints for item in spliced])
    model = f"{pipe.manifest.name} {pipe.manifest.version}"
    result = load_partial_result(options.out, {"model": model, "seeds": options.seeds})
    for name, setting in list_settings().items():
        if name.startswith(options.only) and name not in result["settings"]:
            result["settings"][name] = measure_setting(setting, pipe, options.seeds, reference, evaluator)
            print(f"{name}: both {result['settings'][name]['both']:.2f}", file=sys.stderr)
            write_json(options.out, result)
    for weight in NEGATIONS if options.only in ("", "negation") else ():
        if f"{weight:g}" not in result["alike"]:
            result["negation"][f"{weight:g}"] = measure_negation(pipe, options.seeds, weight)
            result["alike"][f"{weight:g}"] = measure_similar_negation(pipe, options.seeds, weight)
            write_json(options.out, result)
    write_report(options.out, result, markdown_table(result))


if __name__ == "__main__":
    main()
