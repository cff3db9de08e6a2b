"""Measure quality and time against steps, spacing and guidance of one bundle, to choose the defaults of its manifest.

    python -m kinegraph_benchmarks.quality.sampler_sweep --data DATA/bandai --out sampling.json [--only guidance]

    ... --only steps --seeds 5      without --data: everyday prompts, composition and time alone, which takes minutes

The runtime generates the clips, with one setting at a time moved away from the bundle's own. With --data each setting
is evaluated on the captured splits, and clips are kept in --work. Everyday is the mean rate of prompts, composed the
share of pairs that training never joined of which both happen. Settings take turns when they are timed. Writes JSON,
and a Markdown table beside it; a stopped run continues after its last setting.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from kinegraph import MotionPipeline
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_json, write_report
from kinegraph_benchmarks.common.sample_cache import BundleModel, GuidanceBase, Spacing
from kinegraph_benchmarks.common.timing import time_interleaved
from kinegraph_benchmarks.quality.composition import SENTENCE, measure_together
from kinegraph_benchmarks.quality.composition_settings import PAIRS, WORDS
from kinegraph_benchmarks.quality.evaluate import SPLITS, Plan, evaluate, format_ratio
from kinegraph_benchmarks.quality.everyday import PARAPHRASES, Prompt, measure_prompts, read_prompts, summarise

STEPS = (
    (2, 2, 2),
    (3, 3, 3),
    (4, 4, 4),
    (6, 6, 8),
    (8, 8, 10),
    (10, 10, 10),
    (15, 15, 20),
    (20, 15, 15),
    (25, 25, 25),
    (50, 50, 50),
)
GUIDANCE = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0)
SPACINGS: tuple[Spacing, ...] = ("leading", "trailing")
BASES: tuple[GuidanceBase, ...] = ("empty", "coarse")
COLUMNS = ("r_precision_1", "fid", "behaviour", "content", "style", "foot_skate", "jerk")
COMPOSED: Final = ("latent", "semantic", "default", SENTENCE)
"""Methods of `quality.composition` that are measured."""
ROUNDS: Final = 10
"""Clips that are timed for each setting."""

Setting = tuple[dict[str, Any], dict[str, Any]]
"""Changes to the bundle (arguments of `BundleModel`), and options of `generate` and `compose`."""


def settings() -> dict[str, Setting]:
    """List the settings by name."""
    variants: dict[str, Setting] = {"as shipped": ({}, {})}
    for counts in STEPS:
        for spacing in SPACINGS:
            name = "/".join(map(str, counts))
            variants[f"steps {name}, {spacing}"] = ({"spacing": spacing}, {"steps": counts})
    for scale in GUIDANCE:
        for base in BASES:
            variants[f"guidance {scale:g}, away from {base}"] = ({"base": base}, {"guidance": scale})
    return variants


def measure_text(
    pipe: MotionPipeline, prompts: Mapping[str, Sequence[Prompt]], seeds: int, options: Mapping[str, Any]
) -> dict[str, Any]:
    """Measure one setting by what was asked for: everyday prompts by file, and pairs of actions by method."""
    rows = {file: summarise(measure_prompts(pipe, asked, seeds, **options)) for file, asked in prompts.items()}
    both = measure_together(pipe, PAIRS, seeds, COMPOSED, **options)
    return {"everyday": rows, "composed": {method: row["all"] for method, row in both.items()}}


def time_settings(loaded: MotionPipeline, chosen: Mapping[str, Setting]) -> dict[str, float]:
    """Time one clip of 4 seconds of each setting, in turns; returns the median of each, milliseconds."""
    arms = {}
    for name, (changes, options) in chosen.items():
        pipe = BundleModel(loaded, **changes).pipe
        arms[name] = lambda pipe=pipe, options=options: pipe.generate(WORDS["walk"], seconds=4.0, seed=0, **options)
    return {name: float(np.median(times)) for name, times in time_interleaved(arms, ROUNDS).items()}


def markdown_table(results: Mapping[str, Mapping[str, Any]]) -> str:
    """Format results as Markdown: what was asked for and time, and ratios to captured motion where it was given."""
    lines: list[str] = []
    asked = {name: result["text"] for name, result in results.items() if "text" in result}
    if asked:
        files = list(next(iter(asked.values()))["everyday"])
        heads = [*files, *(f"both, {method}" for method in COMPOSED), "ms a clip"]
        lines += ["| | " + " | ".join(heads) + " |", "|---" * (1 + len(heads)) + "|"]
        for name, row in asked.items():
            cells = [f"{row['everyday'][file]['mean']:.3f} ({row['everyday'][file]['at_zero']} at 0)" for file in files]
            cells += [f"{row['composed'][method]:.3f}" for method in COMPOSED]
            cells.append(f"{results[name]['ms']:.1f}" if "ms" in results[name] else "-")
            lines.append(f"| {name} | " + " | ".join(cells) + " |")
        lines.append("")
    judged = {name: result["splits"] for name, result in results.items() if "splits" in result}
    return "\n".join(lines + (captured_tables(judged) if judged else []))


def captured_tables(results: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Format the captured splits as lines of Markdown: ratios under the same evaluator; FID as it is."""
    lines = ["Ratios to captured motion; FID as it is.", ""]
    for split in SPLITS:
        lines += [f"**{split}**", "", "| | " + " | ".join(COLUMNS) + " |", "|---|" + "---|" * len(COLUMNS)]
        for name, result in results.items():
            generated, captured = (result[split][part] for part in ("generated", "captured"))
            cells = [
                f"{generated['mean'][column]['mean']:.3f}"
                if column == "fid"
                else format_ratio(generated["mean"][column]["mean"], captured[column]["mean"])
                for column in COLUMNS
            ]
            lines.append(f"| {name} | " + " | ".join(cells) + " |")
        lines.append("")
    return lines


def read_results(out: Path, model: BundleModel, seeds: int) -> dict[str, Any]:
    """Read what a stopped run of the same weights and seeds has left, or start without any."""
    start = {"bundle": model.name, "stamp": model.stamp, "seeds": seeds, "settings": {}}
    if out.is_file():
        stored: dict[str, Any] = json.loads(out.read_text(encoding="utf-8"))
        if all(stored.get(key) == start[key] for key in ("stamp", "seeds")):
            return stored
    return start


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "data", "bundle", "work", "out", optional=("data",), repeats=1, seeds=5)
    parser.add_argument("--prompts", type=Path, nargs="+", default=[PARAPHRASES], help="files of everyday prompts")
    parser.add_argument("--only", default="", help="only settings whose name begins with this")
    options = parser.parse_args()
    prompts = {path.name: read_prompts(path) for path in options.prompts}
    loaded = MotionPipeline.load(options.bundle, threads=1)
    chosen = {name: setting for name, setting in settings().items() if name.startswith(options.only)}
    result = read_results(options.out, BundleModel(loaded), options.seeds)
    for name, (changes, sampling) in chosen.items():
        row, model = result["settings"].setdefault(name, {}), BundleModel(loaded, **changes)
        if "text" not in row:
            row["text"] = measure_text(model.pipe, prompts, options.seeds, sampling)
        if options.data is not None and "splits" not in row:
            plan = Plan(options.bundle, None, options.data, options.work, None, options.repeats, sampling)
            row |= evaluate(plan, model)
        write_json(options.out, result)
        print(f"{name}: measured", file=sys.stderr)
    for name, milliseconds in time_settings(loaded, chosen).items():
        result["settings"][name]["ms"] = milliseconds
    write_report(options.out, result, markdown_table(result["settings"]))


if __name__ == "__main__":
    main()
