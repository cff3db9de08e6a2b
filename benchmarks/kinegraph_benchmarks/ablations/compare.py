"""Compare models at equal data and training budget: train each variant, evaluate it, and put all into one table.

    python -m kinegraph_benchmarks.ablations.compare --data DATA/bandai --held-out DATA/held_out_pairs.json \
        --autoencoders runs/edge --work comparisons --steps 3000 --seeds 1 2 3 ours one_stage

Variants are the presets in `comparisons/`. All share the autoencoders of one run. Trained weights and evaluations are
kept in --work, so a stopped comparison continues where it was.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from kinegraph.bundle.contract import LEVELS
from kinegraph_benchmarks.ablations.training_runs import evaluate_run, link_shared, markdown_table, train
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_report

PRESETS = Path(__file__).resolve().parent / "comparisons"


def prepare_run(variant: str, seed: int, options: argparse.Namespace) -> Path:
    """Make the folder of one run: links to the shared autoencoders and caches, and its preset."""
    run: Path = options.work / f"{variant}_seed{seed}"
    vaes = [f"vae_{level}" for level in LEVELS]
    link_shared(run, options.autoencoders, [*vaes, "captions.npz", "captions_masked.npz", "latents.pt", "states.npz"])
    base = PRESETS / f"{variant}.toml"
    text = f'base = "{base}"\nseed = {seed}\n\n[denoiser_training]\nsteps = {options.steps}\n'
    (run / "preset.toml").write_text(text, encoding="utf-8")
    return run


def main() -> int:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("variants", nargs="+", choices=sorted(path.stem for path in PRESETS.glob("*.toml")))
    add_arguments(parser, "data", "held_out", "autoencoders", "out", optional=("out",), repeats=3)
    parser.add_argument("--work", type=Path, required=True, help="folder of the runs")
    parser.add_argument("--steps", type=int, default=3000, help="training steps of each variant (3000)")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1], help="of the training")
    options = parser.parse_args()
    results: dict[str, list[dict[str, Any]]] = {}
    for seed in options.seeds:
        for variant in options.variants:
            run = prepare_run(variant, seed, options)
            train(run, options)
            results.setdefault(variant, []).append(evaluate_run(run, options))
    table = markdown_table(results)
    (options.work / "comparison.md").write_text(table, encoding="utf-8")
    budget = {"steps": options.steps, "seeds": options.seeds, "repeats": options.repeats}
    write_report(options.out, {**budget, "variants": results}, table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
