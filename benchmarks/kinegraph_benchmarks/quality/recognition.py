"""Measure per action whether generated clips are recognised and vary as captured ones do, on takes no judge has seen.

    python -m kinegraph_benchmarks.quality.recognition --data DATA/studio --evaluator EVALUATOR --out recognition.json

    ... --bundles A B               folders or names of bundles; the default bundle without it
    ... --run runs/studio           what the run's finest autoencoder keeps of the held-out clips, as one more column

The judges are an evaluator (`train_evaluator --leave-out`) and a linear classifier of actions, both trained on the
captured clips of `train` without the takes of `data.left_out`; judged are these takes and the splits `val` and
`dev_test`. Every held-out clip is asked for by its captions and length. The evaluator recognises a clip if its own
caption is the nearest of 32 of distinct labels; R-precision looks for the right clip among 32. The classifier tells an
action from all others by statistics of the movement. Clips that look right to people may look like another action to
it, as what an autoencoder has copied differs from captured motion in details: it is the harder judge, and the less just
one. Spread is the mean distance between takes of one caption, beside the captured clips of its label and style: as
poses, in metres, and in the evaluator's space (multimodality). Clips of a bundle with another body are brought to the
common skeleton first. By the classifier, no bundle can be better than its autoencoder's copies of captured clips:
`--run` shows which actions are lost there, before any diffusion. Writes JSON, and a Markdown table.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import LEVELS
from kinegraph.motion.features import features_from_joints, joints_from_features
from kinegraph.motion.skeleton import bone_lengths, start_at_origin
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.evaluator import FOLDER, Evaluator
from kinegraph_benchmarks.common.label_classifier import LabelClassifier
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.sample_cache import BundleModel, Model, cache_folder, load_or_generate, long_enough
from kinegraph_benchmarks.common.scores import caption_hits, grouped_r_precision
from kinegraph_training.data.clips import MotionClip, mirrored_clip, read_jsonl, read_split
from kinegraph_training.data.common_skeleton import BONE_LENGTHS, rest_directions, to_common_skeleton
from kinegraph_training.data.left_out import HELD_OUT, left_out_clips
from kinegraph_training.metrics import frechet_distance, matching_distance
from kinegraph_training.synthetic.compositions import resample_linear

BALANCE: Final = 0.5
"""See `LabelClassifier`: of the held-out captured clips, the mean over actions is recognised best so."""
ENOUGH: Final = 8
"""Training clips from which an action counts for the means."""
MOST: Final = 20
"""Captured clips of an action that its spread is measured on."""
SAME_BODY: Final = 0.005
"""Metres."""
FRAMES: Final = 32
"""Frames to which clips are resampled before their poses are compared."""


@dataclass(frozen=True)
class Captured:
    """Captured clips of a data folder, as the judges know them."""

    train: list[MotionClip]
    """What judges may be trained on."""
    held_out: list[MotionClip]
    same_take: frozenset[str]
    """Ids of held-out clips whose take has other windows in `train`: easier than the rest."""

    @property
    def counts(self) -> Counter[str]:
        """Training clips by action."""
        return Counter(clip.action for clip in self.train)


def read_captured(data: Path) -> Captured:
    """Read the labelled clips of a folder, divided by `left_out_clips`."""
    left_out = left_out_clips(read_jsonl(data / "index.jsonl"))
    every = long_enough([clip for clip in read_split(data, "train") if clip.actions])
    others = long_enough([clip for split in HELD_OUT for clip in read_split(data, split) if clip.actions])
    return Captured(
        [clip for clip in every if clip.id not in left_out],
        [clip for clip in every if clip.id in left_out] + others,
        frozenset(name for name, whole in left_out.items() if not whole),
    )


def train_classifier(captured: Captured) -> LabelClassifier:
    """Train the classifier of actions on the captured clips and their mirror images."""
    return LabelClassifier(captured.train + [mirrored_clip(clip) for clip in captured.train], BALANCE)


def on_body_of(clips: Sequence[MotionClip], motions: Sequence[FloatArray]) -> list[FloatArray]:
    """Bring generated motions to the common skeleton if the captured clips have it and these do not.

    A bundle that was trained on another body would be told from captured motion by its bones alone.

    Args:
        clips: captured.
        motions: of one bundle, all with its body: joints (frames, 22, 3).
    """
    if not has_common_body(clips[0].joints) or has_common_body(motions[0]):
        return list(motions)
    rests = rest_directions(motions)
    return [start_at_origin(to_common_skeleton(joints, rests)) for joints in motions]


def has_common_body(joints: FloatArray) -> bool:
    """Tell whether the bones of a motion are those of the common skeleton, to `SAME_BODY` in the mean."""
    return bool(np.abs(bone_lengths(joints).mean(axis=0) - BONE_LENGTHS).mean() < SAME_BODY)


def recognised(
    clips: Sequence[MotionClip], takes: Sequence[Sequence[FloatArray]], judge: LabelClassifier
) -> list[float]:
    """Compute for each clip the share of takes, one motion a clip each, that are recognised as its action."""
    hits = np.zeros(len(clips))
    for motions in takes:
        hits += [label == clip.action for label, clip in zip(judge(motions, "content"), clips, strict=True)]
    shares: list[float] = (hits / len(takes)).tolist()
    return shares


@dataclass(frozen=True)
class EmbeddedTake:
    """One motion for each held-out clip in the evaluator's space, beside the caption that it was asked for with."""

    motions: FloatArray
    """(n, e)"""
    captions: FloatArray
    """(n, e)"""

    @classmethod
    def of(cls, motions: Sequence[FloatArray], captions: Sequence[str], evaluator: Evaluator) -> EmbeddedTake:
        """Embed motions (frames, 22, 3) and captions."""
        return cls(evaluator.embed_motions(motions), evaluator.embed_captions(captions))


def found_captions(clips: Sequence[MotionClip], takes: Sequence[EmbeddedTake]) -> list[float]:
    """Compute for each clip the share of takes whose motion is nearest to its own caption of 32."""
    labels = [f"{clip.action}/{clip.style}" for clip in clips]
    shares = [caption_hits(take.captions, take.motions, labels, np.random.default_rng(1)) for take in takes]
    found: list[float] = np.mean(shares, axis=0).tolist()
    return found


def by_action(captured: Captured, shares: Mapping[str, Sequence[float]]) -> dict[str, dict[str, Any]]:
    """Average shares of each held-out clip by action; a clip that was not judged has NaN."""
    counts, rows = captured.counts, {}
    for action in sorted({clip.action for clip in captured.held_out}):
        numbers = [number for number, clip in enumerate(captured.held_out) if clip.action == action]
        rows[action] = {
            "trained": counts[action],
            "held_out": len(numbers),
            "same_take": all(captured.held_out[number].id in captured.same_take for number in numbers),
            **{name: _mean([values[number] for number in numbers]) for name, values in shares.items()},
        }
    return rows


def _mean(values: Sequence[float]) -> float:
    judged = [value for value in values if np.isfinite(value)]
    return float(np.mean(judged)) if judged else 0.0


def summarise(
    rows: Mapping[str, Mapping[str, Any]], captured: str = "captured", generated: str = "generated"
) -> dict[str, Any]:
    """Average over the actions with `ENOUGH` training clips that captured clips are recognised in at all.

    Args:
        rows: of `by_action`.
        captured, generated: names of the shares to compare.

    Returns:
        Their number, mean rates, `of_captured`, the mean ratio of the rates (1 at most), and those never recognised.
    """
    counted = {name: row for name, row in rows.items() if row["trained"] >= ENOUGH and row[captured] > 0}
    ratios = [min(1.0, row[generated] / row[captured]) for row in counted.values()]
    return {
        "actions": len(counted),
        "captured": float(np.mean([row[captured] for row in counted.values()])),
        "generated": float(np.mean([row[generated] for row in counted.values()])),
        "of_captured": float(np.mean(ratios)),
        "reach_0.8": sum(ratio >= 0.8 for ratio in ratios),
        "at_zero": [name for name, row in counted.items() if row[generated] == 0],
        "no_opinion": [name for name, row in rows.items() if row["trained"] >= ENOUGH and row[captured] == 0],
    }


def pose_spread(motions: Sequence[FloatArray]) -> float:
    """Measure the mean distance of joints between any two motions, both brought to `FRAMES` frames, metres."""
    rows = [resample_linear(joints, FRAMES) for joints in motions]
    return float(np.mean([np.linalg.norm(one - other, axis=-1).mean() for one, other in combinations(rows, 2)]))


def embedded_spread(embeddings: FloatArray) -> float:
    """Measure the mean distance between any two of (n, e) embeddings."""
    return float(np.mean([np.linalg.norm(one - other) for one, other in combinations(embeddings, 2)]))


def measure_spread(model: Model, captured: Captured, evaluator: Evaluator, takes: int) -> dict[str, dict[str, float]]:
    """Measure takes of one caption beside captured clips, by action and style with `ENOUGH` captured clips.

    The caption is the first one of a held-out clip, the length that clip's.
    """
    asked = {(clip.action, clip.style): clip for clip in reversed(captured.held_out)}
    groups: dict[tuple[str, str], list[MotionClip]] = {}
    for clip in captured.train + captured.held_out:
        groups.setdefault((clip.action, clip.style), []).append(clip)
    rows = {}
    for label, clip in sorted(asked.items()):
        real = [other.joints for other in groups[label]][:MOST]
        if len(real) < ENOUGH:
            continue
        seconds = float(np.clip(len(clip.joints) / model.fps, *model.seconds_limits))
        plain = [model.generate(clip.captions[0], seconds=seconds, seed=seed).joints for seed in range(takes)]
        made = on_body_of([clip], plain)
        rows["/".join(filter(None, label))] = {
            "takes": pose_spread(made),
            "captured": pose_spread(real),
            "multimodality": embedded_spread(evaluator.embed_motions(made)),
            "captured_multimodality": embedded_spread(evaluator.embed_motions(real)),
        }
    return rows


def embedded_scores(clips: Sequence[MotionClip], take: EmbeddedTake, captured: FloatArray) -> dict[str, float]:
    """Score one motion a clip in the evaluator's space: R-precision among 32 labels, FID, MM-Dist.

    Args:
        clips: captured.
        take: what was made for them.
        captured: embeddings (n, e) of their own motions.
    """
    labels = [f"{clip.action}/{clip.style}" for clip in clips]
    hits = grouped_r_precision(take.captions, take.motions, labels, np.random.default_rng(1))
    scores = {f"r_precision_{top}": float(hit) for top, hit in enumerate(hits, start=1)}
    scores["fid"] = frechet_distance(take.motions, captured)
    scores["mm_dist"] = matching_distance(take.captions, take.motions)
    return scores


def measure_model(
    model: Model, captured: Captured, judge: LabelClassifier, evaluator: Evaluator, work: Path, repeats: int, takes: int
) -> dict[str, Any]:
    """Measure one bundle.

    Args:
        model: the bundle.
        captured: clips to be asked for, and to compare with.
        judge: of actions.
        evaluator: of captions and motions.
        work: folder of generated clips.
        repeats: clips generated for each held-out clip.
        takes: of one caption, for the spread.
    """
    clips = captured.held_out
    folder = cache_folder(model, work, "held_out", clips, {})
    takes_made = (load_or_generate(model, clips, take, folder) for take in range(repeats))
    made = [(on_body_of(clips, motions), captions) for motions, captions in takes_made]
    joints = [clip.joints for clip in clips]
    real = EmbeddedTake.of(joints, [clip.captions[0] for clip in clips], evaluator)
    embedded = [EmbeddedTake.of(motions, captions, evaluator) for motions, captions in made]
    shares = {
        "captured_caption": found_captions(clips, [real]),
        "caption": found_captions(clips, embedded),
        "captured": recognised(clips, [joints], judge),
        "generated": recognised(clips, [motions for motions, _ in made], judge),
    }
    rows = by_action(captured, shares)
    scores = [embedded_scores(clips, take, real.motions) for take in embedded]
    spread = measure_spread(model, captured, evaluator, takes)
    return {
        "recognition": summarise(rows),
        "captions": summarise(rows, "captured_caption", "caption"),
        "scores": {name: float(np.mean([row[name] for row in scores])) for name in scores[0]},
        "captured_scores": embedded_scores(clips, real, real.motions),
        "spread": {
            name: float(np.mean([row[name] for row in spread.values()])) for name in next(iter(spread.values()))
        },
        "actions": rows,
        "spread_by_action": spread,
    }


def measure_autoencoder(run: Path, captured: Captured, judge: LabelClassifier) -> dict[str, Any]:
    """Measure how often the held-out clips are recognised once the finest autoencoder of a run has copied them."""
    import torch

    from kinegraph_benchmarks.common.autoencoder_scores import MAX_FRAMES, reconstruct
    from kinegraph_training.latents import read_vae

    torch.set_num_threads(1)  # clips are encoded one by one
    trained = read_vae(run / f"vae_{LEVELS[-1]}" / "last.ckpt")
    clips = captured.held_out
    copies = [
        joints_from_features(reconstruct(trained, features_from_joints(clip.joints)[:MAX_FRAMES])) for clip in clips
    ]
    real = recognised(clips, [[clip.joints for clip in clips]], judge)
    rows = by_action(captured, {"captured": real, "generated": recognised(clips, [copies], judge)})
    errors = [body_error(copy, clip.joints) for copy, clip in zip(copies, clips, strict=True)]
    for action, row in rows.items():
        row["error"] = float(np.mean([e for e, clip in zip(errors, clips, strict=True) if clip.action == action]))
    return {"recognition": summarise(rows), "actions": rows}


def body_error(copy: FloatArray, joints: FloatArray) -> float:
    """Measure the mean distance of joints (frames, 22, 3) in two motions with the pelvis in one place, metres."""
    one, other = copy - copy[:, :1], joints[: len(copy)] - joints[: len(copy), :1]
    return float(np.linalg.norm(one - other, axis=-1).mean())


def markdown_table(result: Mapping[str, Any]) -> str:
    """Format a result as Markdown: a summary with a column a bundle, and a row for each action."""
    bundles = result["bundles"]
    names = list(bundles)
    copies = result.get("autoencoder")
    lines = [
        f"evaluator {result['evaluator']}, {result['repeats']} clips for each of {result['held_out']} held out",
        "",
    ]
    lines += ["| | captured | " + " | ".join(names) + " |", "|---" * (2 + len(names)) + "|"]
    first = bundles[names[0]]

    def row(title: str, captured: str, cells: Sequence[str]) -> None:
        lines.append(f"| {title} | {captured} | " + " | ".join(cells) + " |")

    for title, judge in (("caption found among 32", "captions"), ("recognised by the classifier", "recognition")):
        own = [bundles[name][judge] for name in names]
        row(
            f"{title}, mean over actions",
            f"{own[0]['captured']:.3f}",
            [f"{each['generated']:.3f}" for each in own],
        )
        row("of captured", "1", [f"{each['of_captured']:.3f}" for each in own])
        row(f"actions at 0.8 of captured, of {own[0]['actions']}", "-", [str(each["reach_0.8"]) for each in own])
        row("actions never", "-", [", ".join(each["at_zero"]) or "none" for each in own])
    for name, value in first["captured_scores"].items():
        row(name, f"{value:.3f}", [f"{bundles[bundle]['scores'][name]:.3f}" for bundle in names])
    for title, name, real in (("spread of takes, m", "takes", "captured"),
                              ("multimodality", "multimodality", "captured_multimodality")):  # fmt: skip
        row(title, f"{first['spread'][real]:.3f}", [f"{bundles[bundle]['spread'][name]:.3f}" for bundle in names])
    if copies:
        kept = copies["recognition"]
        lines += [
            "",
            f"Copied by the finest autoencoder: {kept['generated']:.3f}, of captured {kept['of_captured']:.3f}, "
            f"{kept['reach_0.8']} actions at 0.8; never: {', '.join(kept['at_zero']) or 'none'}.",
        ]
    heads = ["action", "trained", "held out", "captured", *names, "classifier: captured"]
    heads += [*(["copied", "error, mm"] if copies else []), *names]
    lines += ["", "| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for action, real in sorted(first["actions"].items(), key=lambda item: -item[1]["trained"]):
        rows = [bundles[bundle]["actions"][action] for bundle in names]
        copy = copies["actions"][action] if copies else {}
        cells = [f"{each:.2f}" for each in (real["captured_caption"], *(each["caption"] for each in rows))]
        cells += [f"{real['captured']:.2f}"]
        cells += [f"{copy['generated']:.2f}", f"{1000 * copy['error']:.0f}"] if copies else []
        cells += [f"{each['generated']:.2f}" for each in rows]
        held = f"{real['held_out']}{' of trained takes' if real['same_take'] else ''}"
        lines.append(f"| {action} | {real['trained']} | {held} | " + " | ".join(cells) + " |")
    unsure = ", ".join(own[0]["no_opinion"]) or "none"
    return "\n".join(lines) + f"\n\nNever recognised by the classifier in captured clips, and not counted: {unsure}.\n"


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "data", "work", "out", repeats=3)
    parser.add_argument(
        "--bundles", nargs="+", default=[None], help="folders or names of bundles; the default bundle without it"
    )
    parser.add_argument("--evaluator", type=Path, default=FOLDER, help="folder that export_evaluator wrote")
    parser.add_argument("--run", type=Path, help="run of training whose autoencoder is measured, too")
    parser.add_argument("--takes", type=int, default=6, help="takes of one caption, for the spread (6)")
    options = parser.parse_args()
    captured, evaluator = read_captured(options.data), Evaluator(options.evaluator)
    # All before the first is measured: a bundle that cannot be read is told at once.
    models = {bundle: BundleModel(bundle) for bundle in options.bundles}
    judge = train_classifier(captured)
    result: dict[str, Any] = {
        "evaluator": evaluator.version, "repeats": options.repeats, "held_out": len(captured.held_out), "bundles": {},
        "autoencoder": measure_autoencoder(options.run, captured, judge) if options.run else None,
    }  # fmt: skip
    for bundle, model in models.items():
        name = model.name if model.name not in result["bundles"] else f"{model.name} ({bundle})"
        result["bundles"][name] = measure_model(
            model, captured, judge, evaluator, options.work, options.repeats, options.takes
        )
        print(f"{name}: measured", file=sys.stderr)
    write_report(options.out, result, markdown_table(result))


if __name__ == "__main__":
    main()
