"""Which way of composing is best: pairs of actions that were never joined in training, every method on the same seeds.

    python -m kinegraph_benchmarks.quality.composition_settings --data DATA/bandai \
        --held-out DATA/held_out_pairs.json --out settings.json

    ... --seeds 2                   a quick look
    ... --only "fused, AGD"         the rows that begin so, no negations; --only negation: those alone

How often both actions happen, how natural the motion looks (Fréchet distance of its embedding to spliced captured
clips, foot skate, jerk, transition distance), and what a negation takes away and leaves (EnergyMoGen, Tables 7 and 9).
Through the runtime. Writes JSON, and a Markdown table beside it; a stopped run goes on after its last row. Needs a
bundle with the graphs of adaptive gradient descent.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinegraph import Concept, MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph_benchmarks.common.evaluator import Evaluator
from kinegraph_benchmarks.common.report_io import write_json, write_report
from kinegraph_benchmarks.common.two_action_scores import transition_distance
from kinegraph_benchmarks.common.two_action_set import BESIDE, composed_set
from kinegraph_benchmarks.quality.evaluate import long_enough
from kinegraph_training import metrics
from kinegraph_training.data.clips import read_split
from kinegraph_training.metrics import frechet_distance
from kinegraph_training.synthetic.compositions import HeldOut

SECONDS = 4.0

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
"""EnergyMoGen, Table 7, and more of the joint text."""
STEP_SIZES = ((4e-4, 4e-4), (1e-3, 2e-3), (1e-2, 1e-2), (0.1, 0.1), (0.2, 0.2))
"""EnergyMoGen, Table 9."""
NEGATIONS = (-0.3, -0.5, -0.75, -1.0)

Make = Callable[[MotionPipeline, tuple[str, str], int], FloatArray]


def joint_text(pair: tuple[str, str]) -> str:
    """One sentence for both."""
    return f"{WORDS[pair[0]]} while {WORDS[pair[1]]}"


def composing(**how: Any) -> Make:
    """Both actions as concepts."""

    def make(pipe: MotionPipeline, pair: tuple[str, str], seed: int) -> FloatArray:
        return pipe.compose([WORDS[each] for each in pair], seconds=SECONDS, seed=seed, **how).joints

    return make


def asking_once(agd: tuple[float, float]) -> Make:
    """Both actions in one sentence, with adaptive gradient descent."""

    def make(pipe: MotionPipeline, pair: tuple[str, str], seed: int) -> FloatArray:
        return pipe.compose([joint_text(pair)], agd=agd, seconds=SECONDS, seed=seed).joints

    return make


def settings() -> dict[str, Make]:
    """Name of the row -> how its clips are made."""
    found: dict[str, Make] = {
        "joint text": lambda pipe, pair, seed: pipe.generate(joint_text(pair), seconds=SECONDS, seed=seed).joints,
        "latent": composing(method="latent"),
        "semantic": composing(method="semantic"),
        "fused": composing(method="fused"),
    }
    for lambdas in LAMBDAS:
        found["fused " + "/".join(f"{share:g}" for share in lambdas)] = composing(method="fused", lambdas=lambdas)
    for scale in (1.5, 4.0):
        for method in ("fused", "latent"):
            found[f"{method}, guidance {scale:g}"] = composing(method=method, guidance=scale)
    for agd in STEP_SIZES:
        words = f"AGD {agd[0]:g}/{agd[1]:g}"
        found[f"joint text, {words}"] = asking_once(agd)
        for method in ("fused", "semantic"):
            found[f"{method}, {words}"] = composing(method=method, agd=agd)
    return found


def row(
    make: Make, pipe: MotionPipeline, seeds: int, reference: NDArray[np.float32], judge: Evaluator
) -> dict[str, Any]:
    """One setting over all pairs and seeds."""
    motions = {pair: [make(pipe, pair, seed) for seed in range(seeds)] for pair in PAIRS}
    held = {
        pair: [[bool(BESIDE[each](joints)) for each in pair] for joints in clips] for pair, clips in motions.items()
    }
    everything = [joints for clips in motions.values() for joints in clips]
    return {
        "both": float(np.mean([all(each) for clips in held.values() for each in clips])),
        "first": float(np.mean([each[0] for clips in held.values() for each in clips])),
        "second": float(np.mean([each[1] for clips in held.values() for each in clips])),
        "per_pair": {" + ".join(pair): float(np.mean([all(each) for each in clips])) for pair, clips in held.items()},
        "frechet": frechet_distance(judge.motions(everything), reference),
        "foot_skate": float(np.nanmean([metrics.foot_skate(joints) for joints in everything])),
        "jerk": float(np.mean([metrics.jerk(joints) for joints in everything])),
        "transition": float(np.mean([transition_distance(joints, None) for joints in everything])),
    }


def negated(pipe: MotionPipeline, seeds: int, weight: float) -> dict[str, Any]:
    """What a negation of the second action takes from the joint text, where that shows it, and what it leaves.

    By the default method; beside one positive concept of weight 1, latent and fused are the same.
    """
    rows = []
    for pair in PAIRS:
        with_it = [pipe.generate(joint_text(pair), seconds=SECONDS, seed=seed).joints for seed in range(seeds)]
        concepts = [Concept(joint_text(pair)), Concept(WORDS[pair[1]], weight)]
        less = [pipe.compose(concepts, seconds=SECONDS, seed=seed).joints for seed in range(seeds)]
        rates = [[rate(each, clips) for each in pair] for clips in (with_it, less)]
        if rates[0][1] >= 0.3 and rates[0][0] > 0:
            fallen, kept = 1 - rates[1][1] / rates[0][1], rates[1][0] / rates[0][0]
            rows.append(
                {"pair": " + ".join(pair), "before": rates[0], "after": rates[1], "fallen": fallen, "kept": kept}
            )
    return {
        "rows": rows,
        "fallen_by": float(np.mean([one["fallen"] for one in rows] or [0.0])),
        "kept": float(np.mean([one["kept"] for one in rows] or [0.0])),
        "both_met": sum(one["fallen"] >= 0.5 and one["kept"] >= 0.8 for one in rows),
    }


def beside_alike(pipe: MotionPipeline, seeds: int, weight: float) -> dict[str, float]:
    """What the negation of running leaves of walking with a gesture: it takes what both have in common too."""
    pairs = [pair for pair in PAIRS if pair[0] == "walk"]
    concepts = {pair: [*(WORDS[each] for each in pair), Concept(WORDS["run"], weight)] for pair in pairs}
    motions = {
        pair: [pipe.compose(concepts[pair], seconds=SECONDS, seed=seed).joints for seed in range(seeds)]
        for pair in pairs
    }
    way = [np.linalg.norm(joints[-1, 0, [0, 2]] - joints[0, 0, [0, 2]]) for own in motions.values() for joints in own]
    return {
        "walks": float(np.mean([rate("walk", motions[pair]) for pair in pairs])),
        "gesture": float(np.mean([rate(pair[1], motions[pair]) for pair in pairs])),
        "metres": float(np.mean(way)),
    }


def rate(action: str, clips: list[FloatArray]) -> float:
    """Share of clips that show an action beside another."""
    return float(np.mean([BESIDE[action](joints) for joints in clips]))


def table(result: dict[str, Any]) -> str:
    """Markdown."""
    columns = ("both", "first", "second", "frechet", "foot_skate", "jerk", "transition")
    lines = [f"{len(PAIRS)} pairs, {result['seeds']} seeds, {result['model']}", ""]
    lines += ["| | " + " | ".join(columns) + " |", "|---|" + "---|" * len(columns)]
    for name, found in result["settings"].items():
        lines.append(f"| {name} | " + " | ".join(f"{found[column]:.3f}" for column in columns) + " |")
    lines += [
        "",
        "| negation of the second action | pairs | its rate falls by | the first keeps | pairs with >= .5 and >= .8 |",
        "|---|---|---|---|---|",
    ]
    for weight, found in result["negation"].items():
        lines.append(
            f"| weight {weight} | {len(found['rows'])} | {found['fallen_by']:.2f} | {found['kept']:.2f} "
            f"| {found['both_met']} |"
        )
    lines += ["", "| walking with a gesture, not running | walks | gesture | metres in 4 s |", "|---|---|---|---|"]
    for weight, found in result["alike"].items():
        lines.append(f"| weight {weight} | " + " | ".join(f"{value:.2f}" for value in found.values()) + " |")
    return "\n".join(lines) + "\n"


def begun(path: Path, how: dict[str, Any]) -> dict[str, Any]:
    """The rows that a stopped run of the same model and seeds has left, or none."""
    if path.is_file():
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if all(found.get(key) == value for key, value in how.items()):
            return found
    return {**how, "settings": {}, "negation": {}, "alike": {}}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of the captured motion (bandai)")
    parser.add_argument("--held-out", type=Path, required=True, help="held_out_pairs.json")
    parser.add_argument("--bundle", type=Path, help="folder of a bundle; the default bundle without it")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", default="", help="settings whose name begins so, or negation")
    parser.add_argument("--threads", type=int, help="threads of a model")
    parser.add_argument("--out", type=Path, required=True, help="JSON file; a .md file is written beside it")
    given = parser.parse_args()
    pipe, judge = MotionPipeline.load(given.bundle, threads=given.threads), Evaluator()
    clips = [clip for split in ("val", "dev_test") for clip in long_enough(read_split(given.data, split))]
    spliced = composed_set(clips, HeldOut.read(given.held_out), "together")
    reference = judge.motions([one.joints for one in spliced])
    model = f"{pipe.manifest.name} {pipe.manifest.version}"
    result = begun(given.out, {"model": model, "seeds": given.seeds})
    for name, make in settings().items():
        if name.startswith(given.only) and name not in result["settings"]:
            result["settings"][name] = row(make, pipe, given.seeds, reference, judge)
            print(f"{name}: both {result['settings'][name]['both']:.2f}", file=sys.stderr)
            write_json(given.out, result)
    for weight in NEGATIONS if given.only in ("", "negation") else ():
        if f"{weight:g}" not in result["alike"]:
            result["negation"][f"{weight:g}"] = negated(pipe, given.seeds, weight)
            result["alike"][f"{weight:g}"] = beside_alike(pipe, given.seeds, weight)
            write_json(given.out, result)
    write_report(given.out, result, table(result))


if __name__ == "__main__":
    main()
