"""Measure a bundle: the papers' metrics, recognition, behaviour and clean movement, beside captured motion.

    python -m kinegraph_benchmarks.quality.evaluate --data DATA/bandai --out evaluation.json

Everything generated goes through the runtime and is kept in --work, so that a stopped run goes on. Only the motion of
the specific level is scored: GraphMotion's released code scores a blend of its three levels' embeddings. Writes JSON,
and a Markdown table beside it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinegraph import KinegraphError
from kinegraph.motion.skeleton import bone_lengths
from kinegraph_benchmarks.common.evaluator import Evaluator
from kinegraph_benchmarks.common.label_classifier import Recogniser
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.sample_cache import BundleModel, Model, captions_of, folder_of, generated
from kinegraph_benchmarks.common.scores import (
    GROUP,
    Judges,
    Reference,
    by_pair,
    has_twin,
    kept_labels,
    scores,
    summarised,
)
from kinegraph_benchmarks.common.two_action_scores import as_clips, by_training, composed_scores
from kinegraph_benchmarks.common.two_action_set import Composed, Kind, composed_set
from kinegraph_training.data.clips import MotionClip, read_split
from kinegraph_training.metrics import bootstrap, frechet_distance, label_groups, multimodality, r_precision
from kinegraph_training.synthetic.compositions import HeldOut

MIN_FRAMES = 16
MOST_PAIRS = 12
"""Content-style pairs of a split that the table tells apart; the JSON has those of every split."""
SPLITS = ("dev_test", "dev_compositional")
KINDS: tuple[Kind, ...] = ("in_order", "together")


@dataclass(frozen=True)
class Plan:
    """What is measured, and how often."""

    bundle: Path | None
    run: Path | None
    """A training run to sample in torch, instead of a bundle."""
    data: Path
    work: Path
    held_out: Path | None
    """Pairs of actions never joined in training; without it, captions of two actions are not measured."""
    repeats: int
    options: dict[str, Any]


def long_enough(clips: Sequence[MotionClip]) -> list[MotionClip]:
    """Clips that a model can be asked for."""
    return [clip for clip in clips if len(clip.joints) >= MIN_FRAMES]


def captured_scores(reference: Reference, judges: Judges, repeats: int) -> dict[str, Any]:
    """The captured motion under its own captions."""
    rng = np.random.default_rng(1)
    rows, motions = [], [clip.joints for clip in reference.clips]
    for take in range(repeats):
        rows.append(scores(motions, captions_of(reference.clips, take), reference, judges, rng).numbers)
    return summarised(rows)


def generated_scores(
    plan: Plan, model: Model, split: str, reference: Reference, judges: Judges, twins: Sequence[bool]
) -> dict[str, Any]:
    """All takes of a split: means over takes, intervals over clips, and the same without near twins."""
    folder = folder_of(model, plan.work, split, reference.clips, plan.options)
    alone = [row for row, twin in enumerate(twins) if not twin]
    rng = np.random.default_rng(2)
    rows, rows_alone, embeddings, texts, pairs = [], [], [], [], []
    for take in range(plan.repeats):
        motions, captions = generated(model, reference.clips, take, folder, **plan.options)
        found = scores(motions, captions, reference, judges, rng)
        rows.append(found.numbers)
        embeddings.append(found.embeddings)
        texts.append(found.texts)
        pairs.append(by_pair(found.kept, reference))
        if len(alone) > 1:
            part = Reference([reference.clips[row] for row in alone], reference.embeddings[alone])
            some = scores([motions[r] for r in alone], [captions[r] for r in alone], part, judges, rng)
            rows_alone.append(some.numbers)
        reached = found.numbers["r_precision_1"]
        print(f"{split} take {take + 1} of {plan.repeats}: R@1 {reached:.3f}", file=sys.stderr)
    real = kept_labels([clip.joints for clip in reference.clips], reference.clips, judges.recogniser)
    return {
        "clips": len(reference.clips),
        "distinct_pairs": len(set(reference.labels)),
        "group": min(GROUP, len(set(reference.labels))),
        "mean": summarised(rows),
        "interval_over_clips": intervals(embeddings[0], texts[0], reference, rng),
        "multimodality": takes_apart(embeddings, reference.clips, rng),
        "clips_without_near_twin": len(alone),
        "without_near_twins": summarised(rows_alone) if rows_alone else None,
        "by_pair": {pair: summarised([take[pair] for take in pairs]) for pair in pairs[0]},
        "by_pair_captured": by_pair(real, reference),
    }


def takes_apart(embeddings: Sequence[NDArray[np.float32]], clips: Sequence[MotionClip], rng: Any) -> float | None:
    """MModality: distance between takes of one and the same caption."""
    cycle = max(len(clip.captions) for clip in clips)
    same = embeddings[::cycle]
    return multimodality(np.stack(same, axis=1), rng) if len(same) > 1 else None


def intervals(
    motions: NDArray[np.float32], texts: NDArray[np.float32], reference: Reference, rng: np.random.Generator
) -> dict[str, tuple[float, float]]:
    """95 % bootstrap intervals over clips, of the first take."""
    labels = reference.labels

    def top_1(rows: NDArray[np.int64]) -> float:
        groups = label_groups([labels[row] for row in rows], GROUP, rng)
        return float(np.mean([r_precision(texts[rows[group]], motions[rows[group]])[0] for group in groups]))

    def fid(rows: NDArray[np.int64]) -> float:
        return frechet_distance(motions[rows], reference.embeddings[rows])

    return {name: bootstrap(one, len(labels), rng, 100) for name, one in (("r_precision_1", top_1), ("fid", fid))}


def model_of(plan: Plan) -> Model:
    """The bundle, or the run."""
    if plan.run is None:
        return BundleModel(plan.bundle)
    from kinegraph_benchmarks.common.torch_model import TorchModel

    return TorchModel(plan.run)


def two_actions(plan: Plan, model: Model, items: Sequence[Composed], judges: Judges) -> dict[str, Any]:
    """Captions of two actions, beside the same two captured actions joined."""
    rng = np.random.default_rng(3)
    captured = [one.joints for one in items]
    clips = as_clips(items)
    folder = folder_of(model, plan.work, items[0].kind, clips, plan.options)
    takes = [generated(model, clips, take, folder, **plan.options)[0] for take in range(plan.repeats)]
    apart = [by_training(items, motions) for motions in takes]
    return {
        "clips": len(items),
        "captured": summarised([composed_scores(items, captured, judges, rng)]),
        "generated": summarised([composed_scores(items, motions, judges, rng) for motions in takes]),
        "captured_apart": by_training(items, captured),
        "generated_apart": {
            name: {**one, "both_hold": float(np.mean([take[name]["both_hold"] for take in apart]))}
            for name, one in apart[0].items()
            if one["clips"]
        },
    }


def evaluate(plan: Plan, model: Model) -> dict[str, Any]:
    """Everything, as it is written."""
    train = read_split(plan.data, "train")
    lengths = np.mean([bone_lengths(clip.joints).mean(0) for clip in train], axis=0)
    judges = Judges(Evaluator(), Recogniser(train), lengths)
    result: dict[str, Any] = {
        "model": model.name,
        "evaluator": judges.evaluator.version,
        "repeats": plan.repeats,
        "options": plan.options,
        "splits": {},
        "two_actions": {},
    }
    for split in SPLITS:
        clips = long_enough(read_split(plan.data, split))
        reference = Reference(clips, judges.evaluator.motions([clip.joints for clip in clips]))
        result["splits"][split] = {
            "captured": captured_scores(reference, judges, plan.repeats),
            "generated": generated_scores(plan, model, split, reference, judges, has_twin(clips, train)),
        }
    if plan.held_out is not None:
        clips = [clip for split in ("val", "dev_test") for clip in long_enough(read_split(plan.data, split))]
        held = HeldOut.read(plan.held_out)
        for kind in KINDS:
            result["two_actions"][kind] = two_actions(plan, model, composed_set(clips, held, kind), judges)
    return result


def ratio(made: float, real: float) -> str:
    """Of generated to captured, for a table."""
    return f"{made / real:.2f}" if abs(real) > 1e-6 else "-"


def table(result: dict[str, Any]) -> str:
    """Markdown, one table per split and per kind of captions of two actions."""
    lines = [f"{result['model']}, evaluator {result['evaluator']}, {result['repeats']} repeats (mean ± 1.96 s.e.)"]
    for split, parts in result["splits"].items():
        made, real = parts["generated"], parts["captured"]
        lines += [
            "",
            f"**{split}**: {made['clips']} clips, {made['distinct_pairs']} content-style pairs, groups of"
            f" {made['group']}; {made['clips_without_near_twin']} clips have no near twin in training",
            "",
            "| | captured | generated | ratio | without near twins |",
            "|---|---|---|---|---|",
        ]
        for name, value in made["mean"].items():
            alone, own = made["without_near_twins"], real[name]["mean"]
            other = f"{alone[name]['mean']:.3f}" if alone and name in alone else "-"
            cells = f"{own:.3f} | {value['mean']:.3f} ± {value['plus_minus']:.3f} | {ratio(value['mean'], own)}"
            lines.append(f"| {name} | {cells} | {other} |")
        if made["multimodality"] is not None:
            lines.append(f"| multimodality | - | {made['multimodality']:.3f} | - | - |")
        if len(made["by_pair"]) <= MOST_PAIRS:
            lines += pairs_table(made["by_pair"], made["by_pair_captured"])
    for kind, parts in result["two_actions"].items():
        lines += two_actions_table(kind, parts)
    return "\n".join(lines) + "\n"


def pairs_table(made: dict[str, Any], captured: dict[str, Any]) -> list[str]:
    """Lines of Markdown."""
    names = list(next(iter(captured.values())))
    lines = ["", "| generated (captured) | " + " | ".join(names) + " |", "|---|" + "---|" * len(names)]
    for pair, own in captured.items():
        cells = [f"{made[pair][name]['mean']:.2f} ({own[name]:.2f})" if name in own else "-" for name in names]
        lines.append(f"| {pair} | " + " | ".join(cells) + " |")
    return lines


def two_actions_table(kind: str, parts: dict[str, Any]) -> list[str]:
    """Lines of Markdown."""
    lines = ["", f"**two actions, {kind.replace('_', ' ')}**: {parts['clips']} captions", ""]
    lines += ["| | captured | generated | ratio |", "|---|---|---|---|"]
    for name, value in parts["generated"].items():
        own = parts["captured"][name]["mean"]
        made = f"{value['mean']:.3f} ± {value['plus_minus']:.3f}"
        lines.append(f"| {name} | {own:.3f} | {made} | {ratio(value['mean'], own)} |")
    for name, one in parts["generated_apart"].items():
        own, held = parts["captured_apart"][name]["both_hold"], one["both_hold"]
        if held is not None:
            label = f"both_hold, {one['clips']} pairs {name.replace('_', ' ')}"
            lines.append(f"| {label} | {own:.3f} | {held:.3f} | {ratio(held, own)} |")
    return lines


def main() -> int:
    """0: measured; 2: wrong input."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of the captured motion (bandai)")
    parser.add_argument("--held-out", type=Path, help="held_out_pairs.json: also measure captions of two actions")
    parser.add_argument("--bundle", type=Path, help="folder of a bundle; the default bundle without it")
    parser.add_argument("--run", type=Path, help="a training run instead of a bundle, sampled in torch (comparisons)")
    parser.add_argument("--work", type=Path, default=Path("evaluation"), help="folder for generated clips")
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--steps", type=lambda text: [int(part) for part in text.split(",")], help="such as 15,15,20")
    parser.add_argument("--guidance", type=float)
    parser.add_argument("--out", type=Path, required=True, help="JSON file; a .md file is written beside it")
    arguments = parser.parse_args()
    options = {name: getattr(arguments, name) for name in ("steps", "guidance")}
    options = {name: value for name, value in options.items() if value is not None}
    plan = Plan(
        arguments.bundle, arguments.run, arguments.data, arguments.work, arguments.held_out, arguments.repeats, options
    )
    try:
        result = evaluate(plan, model_of(plan))
    except KinegraphError as error:
        print(f"evaluate: error: {error}", file=sys.stderr)
        return 2
    write_report(arguments.out, result, table(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
