"""With every verb of a caption masked, do direction and hand still steer the motion? (GraphMotion, Table 6.)

    python -m kinegraph_benchmarks.quality.masked_verbs --data DATA/bandai --out masked_verbs.json

The verb is masked in the caption, and the caption encoded again: hidden states of the other words leak it otherwise.
The predicates ask only for what the words that are left say: the side of a turn, the hand that moves. `--run` measures
a training run instead of a bundle, such as the ablation without a graph. Writes JSON, and a Markdown table beside it.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.bundle.reader import DEFAULT_BUNDLE
from kinegraph.text.parser import GraphParser, read_parser
from kinegraph_benchmarks.common import predicates as p
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.sample_cache import Model, folder_of, generated
from kinegraph_benchmarks.quality.evaluate import SPLITS, Plan, long_enough, model_of, ratio
from kinegraph_training.data.caption_cache import without_verbs
from kinegraph_training.data.clips import MotionClip, read_split

PREDICATES: dict[str, p.Predicate] = {
    **{f"walk-turn-{side}": p.turns(side) for side in ("left", "right")},
    **{f"{verb}-{side}-hand": p.swings(side) for verb in ("raise-up", "wave") for side in ("left", "right")},
    **{f"{verb}-both-hands": p.swings("both") for verb in ("raise-up", "wave")},
}


class Masked:
    """A model that is never told a verb."""

    def __init__(self, model: Model, parser: GraphParser) -> None:
        self._model, self._parser = model, parser
        self.name, self.stamp = f"{model.name}, verbs masked", f"{model.stamp} masked"
        self.fps, self.seconds_limits = model.fps, model.seconds_limits

    def generate(self, caption: str, *, seconds: float, seed: int, **options: Any) -> Any:
        """As the model's own."""
        return self._model.generate(without_verbs(self._parser.parse(caption)), seconds=seconds, seed=seed, **options)


def rates(clips: Sequence[MotionClip], motions: Sequence[np.ndarray]) -> dict[str, float]:
    """Share of clips whose predicate holds, per kind of predicate."""
    held: dict[str, list[bool]] = {"direction": [], "body part": []}
    for clip, joints in zip(clips, motions, strict=True):
        held["direction" if "turn" in clip.content else "body part"].append(PREDICATES[clip.content](joints))
    return {name: float(np.mean(values)) for name, values in held.items() if values}


def measured(plan: Plan, parser: GraphParser) -> dict[str, Any]:
    """Per split: captured motion, the whole caption, the caption without verbs."""
    model = model_of(plan)
    result: dict[str, Any] = {"model": model.name, "splits": {}}
    for split in SPLITS:
        clips = [clip for clip in long_enough(read_split(plan.data, split)) if clip.content in PREDICATES]
        found = {"captured": rates(clips, [clip.joints for clip in clips])}
        for name, own in (("whole caption", model), ("verbs masked", Masked(model, parser))):
            folder = folder_of(own, plan.work, f"masked_{split}", clips, plan.options)
            takes = [generated(own, clips, take, folder, **plan.options)[0] for take in range(plan.repeats)]
            rows = [rates(clips, motions) for motions in takes]
            found[name] = {kind: float(np.mean([row[kind] for row in rows])) for kind in rows[0]}
        result["splits"][split] = {"clips": len(clips), **found}
    return result


def table(result: dict[str, Any]) -> str:
    """Markdown; the ratio is that of masked to whole captions."""
    lines = [f"{result['model']}: share of clips whose direction or body part is the caption's", ""]
    lines += ["| split | | captured | whole caption | verbs masked | ratio |", "|---|---|---|---|---|---|"]
    for split, found in result["splits"].items():
        for kind in found["captured"]:
            real, whole, masked = (found[name][kind] for name in ("captured", "whole caption", "verbs masked"))
            cells = f"{real:.3f} | {whole:.3f} | {masked:.3f} | {ratio(masked, whole)}"
            lines.append(f"| {split} | {kind} | {cells} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of the captured motion (bandai)")
    parser.add_argument("--bundle", type=Path, help="folder of a bundle; the default bundle without it")
    parser.add_argument("--run", type=Path, help="a training run instead of a bundle, sampled in torch")
    parser.add_argument("--work", type=Path, default=Path("evaluation"), help="folder for generated clips")
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True, help="JSON file; a .md file is written beside it")
    given = parser.parse_args()
    plan = Plan(given.bundle, given.run, given.data, given.work, None, given.repeats, {})
    result = measured(plan, read_parser(DEFAULT_BUNDLE))
    write_report(given.out, result, table(result))


if __name__ == "__main__":
    main()
