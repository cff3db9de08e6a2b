"""Which way of composing is best: pairs of actions that were never joined in training, every method on the same seeds.

    python benchmarks/composition_settings.py --data DATA/bandai --held-out DATA/held_out_pairs.json --out settings.json

How often both actions happen, how natural the motion looks (Fréchet distance of its embedding to spliced captured
clips, foot skate, jerk), and what a negation takes away and leaves (EnergyMoGen, Tables 7 and 9). Through the runtime.
Writes JSON, and a Markdown table beside it.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from composed import BESIDE, composed_set
from evaluate import long_enough
from evaluator import Evaluator
from numpy.typing import NDArray

from kinegraph import Concept, MotionPipeline
from kinegraph_training import measures
from kinegraph_training.compositions import HeldOut
from kinegraph_training.data import read_split
from kinegraph_training.metrics import frechet_distance

Joints = NDArray[np.float32]
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

Make = Callable[[MotionPipeline, tuple[str, str], int], Joints]


def joint_text(pair: tuple[str, str]) -> str:
    """One sentence for both."""
    return f"{WORDS[pair[0]]} while {WORDS[pair[1]]}"


def composing(**how: Any) -> Make:
    """Both actions as concepts."""

    def make(pipe: MotionPipeline, pair: tuple[str, str], seed: int) -> Joints:
        return pipe.compose([WORDS[each] for each in pair], seconds=SECONDS, seed=seed, **how).joints

    return make


def settings() -> dict[str, Make]:
    """Name of the row -> how its clips are made."""
    found: dict[str, Make] = {
        "joint text": lambda pipe, pair, seed: pipe.generate(joint_text(pair), seconds=SECONDS, seed=seed).joints,
        "latent": composing(method="latent"),
        "semantic": composing(method="semantic"),
        "fused": composing(method="fused"),
    }
    for lambdas in ((0.3, 0.3, 0.4), (0.0, 0.5, 0.5), (0.1, 0.3, 0.6), (0.2, 0.0, 0.8), (0.3, 0.5, 0.2)):
        found["fused " + "/".join(f"{share:g}" for share in lambdas)] = composing(method="fused", lambdas=lambdas)
    for scale in (1.5, 4.0):
        found[f"fused, guidance {scale:g}"] = composing(method="fused", guidance=scale)
        found[f"latent, guidance {scale:g}"] = composing(method="latent", guidance=scale)
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
        "foot_skate": float(np.nanmean([measures.foot_skate(joints) for joints in everything])),
        "jerk": float(np.mean([measures.jerk(joints) for joints in everything])),
    }


def negated(pipe: MotionPipeline, seeds: int, weight: float) -> dict[str, Any]:
    """What a negation of the second action takes from the joint text, where that shows it, and what it leaves."""
    rows = []
    for pair in PAIRS:
        with_it = [pipe.generate(joint_text(pair), seconds=SECONDS, seed=seed).joints for seed in range(seeds)]
        concepts = [Concept(joint_text(pair)), Concept(WORDS[pair[1]], weight)]
        less = [pipe.compose(concepts, method="latent", seconds=SECONDS, seed=seed).joints for seed in range(seeds)]
        rates = [[rate(each, clips) for each in pair] for clips in (with_it, less)]
        if rates[0][1] >= 0.3 and rates[0][0] > 0:
            rows.append({"pair": " + ".join(pair), "before": rates[0], "after": rates[1]})
    fallen = [1 - one["after"][1] / one["before"][1] for one in rows]
    kept = [one["after"][0] / one["before"][0] for one in rows]
    return {"rows": rows, "fallen_by": float(np.mean(fallen or [0.0])), "kept": float(np.mean(kept or [0.0]))}


def rate(action: str, clips: list[Joints]) -> float:
    """Share of clips that show an action beside another."""
    return float(np.mean([BESIDE[action](joints) for joints in clips]))


def table(result: dict[str, Any]) -> str:
    """Markdown."""
    columns = ("both", "first", "second", "frechet", "foot_skate", "jerk")
    lines = [f"{len(PAIRS)} pairs, {result['seeds']} seeds, {result['model']}", ""]
    lines += ["| | " + " | ".join(columns) + " |", "|---|" + "---|" * len(columns)]
    for name, found in result["settings"].items():
        lines.append(f"| {name} | " + " | ".join(f"{found[column]:.3f}" for column in columns) + " |")
    lines += [
        "",
        "| negation of the second action | pairs | its rate falls by | the first keeps |",
        "|---|---|---|---|",
    ]
    for weight, found in result["negation"].items():
        lines.append(f"| weight {weight} | {len(found['rows'])} | {found['fallen_by']:.2f} | {found['kept']:.2f} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of the captured motion (bandai)")
    parser.add_argument("--held-out", type=Path, required=True, help="held_out_pairs.json")
    parser.add_argument("--bundle", type=Path, help="folder of a bundle; the default bundle without it")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", default="", help="settings whose name begins so; no negations then")
    parser.add_argument("--out", type=Path, required=True, help="JSON file; a .md file is written beside it")
    given = parser.parse_args()
    pipe, judge = MotionPipeline.load(given.bundle), Evaluator()
    clips = [clip for split in ("val", "dev_test") for clip in long_enough(read_split(given.data, split))]
    spliced = composed_set(clips, HeldOut.read(given.held_out), "together")
    reference = judge.motions([one.joints for one in spliced])
    model = f"{pipe.manifest.name} {pipe.manifest.version}"
    result: dict[str, Any] = {"model": model, "seeds": given.seeds, "settings": {}, "negation": {}}
    for name, make in settings().items():
        if name.startswith(given.only):
            result["settings"][name] = row(make, pipe, given.seeds, reference, judge)
            print(f"{name}: both {result['settings'][name]['both']:.2f}", file=sys.stderr)
    for weight in () if given.only else (-0.5, -1.0):
        result["negation"][f"{weight:g}"] = negated(pipe, given.seeds, weight)
    given.out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    text = table(result)
    given.out.with_suffix(".md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
