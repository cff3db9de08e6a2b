"""Measure whether direction and hand still steer the motion when every verb is masked (GraphMotion, Table 6).

    python -m kinegraph_benchmarks.quality.masked_verbs --data DATA/bandai --out masked_verbs.json

The verb is masked in the caption before the caption is encoded, because the hidden states of the other words leak it
otherwise. The predicates ask only for what the remaining words say: the side of a turn, the hand that moves. `--run`
measures a training run instead of a bundle, such as the ablation without a graph. Writes JSON, and a Markdown table
beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.bundle.reader import text_files_folder
from kinegraph.text.parser import GraphParser, read_parser
from kinegraph_benchmarks.common import predicates as p
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.sample_cache import Model, cache_folder, load_or_generate, long_enough
from kinegraph_benchmarks.quality.evaluate import SPLITS, Plan, format_ratio, load_model
from kinegraph_training.data.caption_cache import mask_verbs
from kinegraph_training.data.clips import MotionClip, read_split

PREDICATES: dict[str, p.Predicate] = {
    **{f"walk-turn-{side}": p.turns(side) for side in ("left", "right")},
    **{f"{verb}-{side}-hand": p.swings(side) for verb in ("raise-up", "wave") for side in ("left", "right")},
    **{f"{verb}-both-hands": p.swings("both") for verb in ("raise-up", "wave")},
}


class VerbMaskingModel:
    """Model that gets the graph of every caption with its verbs masked."""

    def __init__(self, model: Model, parser: GraphParser) -> None:
        self._model, self._parser = model, parser
        self.name, self.stamp = f"{model.name}, verbs masked", f"{model.stamp} masked"
        self.fps, self.seconds_limits = model.fps, model.seconds_limits

    def generate(self, caption: str, *, seconds: float, seed: int, **options: Any) -> Any:
        """Generate a clip for the caption without its verbs; arguments as those of the model."""
        return self._model.generate(mask_verbs(self._parser.parse(caption)), seconds=seconds, seed=seed, **options)


def predicate_rates(clips: Sequence[MotionClip], motions: Sequence[FloatArray]) -> dict[str, float]:
    """Compute the share of clips whose predicate holds, by kind of predicate ("direction", "body part")."""
    held: dict[str, list[bool]] = {"direction": [], "body part": []}
    for clip, joints in zip(clips, motions, strict=True):
        held["direction" if "turn" in clip.action else "body part"].append(PREDICATES[clip.action](joints))
    return {name: float(np.mean(values)) for name, values in held.items() if values}


def measure_masking(plan: Plan, parser: GraphParser) -> dict[str, Any]:
    """Measure the rates of captured motion, whole captions and captions without verbs, by split."""
    model = load_model(plan)
    result: dict[str, Any] = {"model": model.name, "splits": {}}
    for split in SPLITS:
        clips = [clip for clip in long_enough(read_split(plan.data, split)) if clip.action in PREDICATES]
        rates = {"captured": predicate_rates(clips, [clip.joints for clip in clips])}
        for name, asked in (("whole caption", model), ("verbs masked", VerbMaskingModel(model, parser))):
            folder = cache_folder(asked, plan.work, f"masked_{split}", clips, plan.options)
            takes = [load_or_generate(asked, clips, take, folder, **plan.options)[0] for take in range(plan.repeats)]
            rows = [predicate_rates(clips, motions) for motions in takes]
            rates[name] = {kind: float(np.mean([row[kind] for row in rows])) for kind in rows[0]}
        result["splits"][split] = {"clips": len(clips), **rates}
    return result


def markdown_table(result: dict[str, Any]) -> str:
    """Format a result as Markdown; the ratio is that of masked to whole captions."""
    lines = [f"{result['model']}: share of clips whose direction or body part is the caption's", ""]
    lines += ["| split | | captured | whole caption | verbs masked | ratio |", "|---|---|---|---|---|---|"]
    for split, rates in result["splits"].items():
        for kind in rates["captured"]:
            real, whole, masked = (rates[name][kind] for name in ("captured", "whole caption", "verbs masked"))
            cells = f"{real:.3f} | {whole:.3f} | {masked:.3f} | {format_ratio(masked, whole)}"
            lines.append(f"| {split} | {kind} | {cells} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "data", "bundle", "work", "out", repeats=1)
    parser.add_argument("--run", type=Path, help="a training run instead of a bundle, sampled in torch")
    options = parser.parse_args()
    plan = Plan(options.bundle, options.run, options.data, options.work, None, options.repeats, {})
    result = measure_masking(plan, read_parser(text_files_folder()))
    write_report(options.out, result, markdown_table(result))


if __name__ == "__main__":
    main()
