"""Steps, spacing and guidance against quality, for one bundle: which settings its manifest should have.

    python -m kinegraph_benchmarks.quality.sampler_sweep --data DATA/bandai --out sampling.json [--only guidance]

Through the runtime, a setting at a time moved away from the bundle's own; takes are kept in --work. Speed is not
measured here: cost is the number of steps. Writes JSON, and a Markdown table beside it.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from kinegraph_benchmarks.common.report_io import write_json, write_report
from kinegraph_benchmarks.common.sample_cache import BundleModel, GuidanceBase, Spacing
from kinegraph_benchmarks.quality.evaluate import SPLITS, Plan, evaluate, ratio

STEPS = ((4, 4, 4), (6, 6, 8), (8, 8, 10), (10, 10, 10), (15, 15, 20), (20, 15, 15), (25, 25, 25), (50, 50, 50))
GUIDANCE = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0)
SPACINGS: tuple[Spacing, ...] = ("leading", "trailing")
BASES: tuple[GuidanceBase, ...] = ("empty", "coarse")
COLUMNS = ("r_precision_1", "fid", "behaviour", "content", "style", "foot_skate", "jerk")


def settings() -> dict[str, tuple[dict[str, Any], dict[str, Any]]]:
    """Name -> changes to the bundle (arguments of `BundleModel`), options of `generate`."""
    found: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {"as shipped": ({}, {})}
    for counts in STEPS:
        for spacing in SPACINGS:
            name = "/".join(map(str, counts))
            found[f"steps {name}, {spacing}"] = ({"spacing": spacing}, {"steps": counts})
    for scale in GUIDANCE:
        for base in BASES:
            found[f"guidance {scale:g}, away from {base}"] = ({"base": base}, {"guidance": scale})
    return found


def table(results: dict[str, dict[str, Any]]) -> str:
    """Markdown: ratio to captured motion under the same evaluator; FID as it is."""
    lines = ["Ratios to captured motion; FID as it is.", ""]
    for split in SPLITS:
        lines += [f"**{split}**", "", "| | " + " | ".join(COLUMNS) + " |", "|---|" + "---|" * len(COLUMNS)]
        for name, result in results.items():
            made, real = (result["splits"][split][part] for part in ("generated", "captured"))
            cells = [
                f"{made['mean'][c]['mean']:.3f}" if c == "fid" else ratio(made["mean"][c]["mean"], real[c]["mean"])
                for c in COLUMNS
            ]
            lines.append(f"| {name} | " + " | ".join(cells) + " |")
        lines.append("")
    return "\n".join(lines)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of the captured motion (bandai)")
    parser.add_argument("--bundle", type=Path, help="folder of a bundle; the default bundle without it")
    parser.add_argument("--work", type=Path, default=Path("evaluation"), help="folder for generated clips")
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--only", default="", help="settings whose name begins so")
    parser.add_argument("--out", type=Path, required=True, help="JSON file; a .md file is written beside it")
    given = parser.parse_args()
    results = {}
    for name, (changes, options) in settings().items():
        if not name.startswith(given.only):
            continue
        plan = Plan(given.bundle, None, given.data, given.work, None, given.repeats, options)
        results[name] = evaluate(plan, BundleModel(given.bundle, **changes))
        write_json(given.out, results)
    write_report(given.out, results, table(results))


if __name__ == "__main__":
    main()
