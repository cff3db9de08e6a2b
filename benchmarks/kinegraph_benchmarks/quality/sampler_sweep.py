"""Measure quality against steps, spacing and guidance of one bundle, to choose the defaults of its manifest.

    python -m kinegraph_benchmarks.quality.sampler_sweep --data DATA/bandai --out sampling.json [--only guidance]

The runtime generates the clips, with one setting at a time moved away from the bundle's own; clips are kept in --work.
Speed is not measured here, the cost is the number of steps. Writes JSON, and a Markdown table beside it.
"""

from __future__ import annotations

from typing import Any

from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_json, write_report
from kinegraph_benchmarks.common.sample_cache import BundleModel, GuidanceBase, Spacing
from kinegraph_benchmarks.quality.evaluate import SPLITS, Plan, evaluate, format_ratio

STEPS = ((4, 4, 4), (6, 6, 8), (8, 8, 10), (10, 10, 10), (15, 15, 20), (20, 15, 15), (25, 25, 25), (50, 50, 50))
GUIDANCE = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0)
SPACINGS: tuple[Spacing, ...] = ("leading", "trailing")
BASES: tuple[GuidanceBase, ...] = ("empty", "coarse")
COLUMNS = ("r_precision_1", "fid", "behaviour", "content", "style", "foot_skate", "jerk")


def settings() -> dict[str, tuple[dict[str, Any], dict[str, Any]]]:
    """List the settings by name: changes to the bundle (arguments of `BundleModel`), and options of `generate`."""
    variants: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {"as shipped": ({}, {})}
    for counts in STEPS:
        for spacing in SPACINGS:
            name = "/".join(map(str, counts))
            variants[f"steps {name}, {spacing}"] = ({"spacing": spacing}, {"steps": counts})
    for scale in GUIDANCE:
        for base in BASES:
            variants[f"guidance {scale:g}, away from {base}"] = ({"base": base}, {"guidance": scale})
    return variants


def markdown_table(results: dict[str, dict[str, Any]]) -> str:
    """Format results as Markdown: ratios to captured motion under the same evaluator; FID as it is."""
    lines = ["Ratios to captured motion; FID as it is.", ""]
    for split in SPLITS:
        lines += [f"**{split}**", "", "| | " + " | ".join(COLUMNS) + " |", "|---|" + "---|" * len(COLUMNS)]
        for name, result in results.items():
            generated, captured = (result["splits"][split][part] for part in ("generated", "captured"))
            cells = [
                f"{generated['mean'][column]['mean']:.3f}"
                if column == "fid"
                else format_ratio(generated["mean"][column]["mean"], captured[column]["mean"])
                for column in COLUMNS
            ]
            lines.append(f"| {name} | " + " | ".join(cells) + " |")
        lines.append("")
    return "\n".join(lines)


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "data", "bundle", "work", "out", repeats=1)
    parser.add_argument("--only", default="", help="only settings whose name begins with this")
    options = parser.parse_args()
    results = {}
    for name, (changes, sampling) in settings().items():
        if not name.startswith(options.only):
            continue
        plan = Plan(options.bundle, None, options.data, options.work, None, options.repeats, sampling)
        results[name] = evaluate(plan, BundleModel(options.bundle, **changes))
        write_json(options.out, results)
    write_report(options.out, results, markdown_table(results))


if __name__ == "__main__":
    main()
