"""Compare models at equal data and training budget: train each variant, evaluate it, and put all into one table.

    python -m kinegraph_benchmarks.ablations.compare --data DATA/bandai --held-out DATA/held_out_pairs.json \
        --autoencoders runs/edge --work comparisons --steps 3000 --seeds 1 2 3 ours one_stage

Variants are the presets in `comparisons/`, over the data and the schedule of --preset. All share the autoencoders of
one run, of which variants of skeleton space (`skeleton`, `mdm`) take the normalisation alone, and all start from random
weights. Trained weights and evaluations are kept in --work, so a stopped comparison continues where it was.
"""

from __future__ import annotations

import argparse
import sys
import tomllib
from pathlib import Path
from typing import Any

from kinegraph.bundle.contract import LEVELS
from kinegraph_benchmarks.ablations.training_runs import (
    CAPTION_CACHES,
    evaluate_run,
    link_shared,
    markdown_table,
    train,
)
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_training.config import read_preset

PRESETS = Path(__file__).resolve().parent / "comparisons"


def is_skeleton_space(variant: str) -> bool:
    """Tell whether a variant is a network of skeleton space."""
    return "frames" in tomllib.loads((PRESETS / f"{variant}.toml").read_text(encoding="utf-8"))


def preset_text(variant: str, base: str, seed: int, steps: int) -> str:
    """Write the preset of a run: what a variant changes of a base, with a seed and a budget.

    Args:
        variant: name in `PRESETS`.
        base: name of a preset, or an absolute path.
        seed: of training.
        steps: of training, of as many clips in either space.
    """
    changes = (PRESETS / f"{variant}.toml").read_text(encoding="utf-8").splitlines()
    lines = [f'base = "{base}"', f"seed = {seed}", *(line for line in changes if not line.startswith("base = "))]
    lines += ["[denoiser_training]", f"steps = {steps}"]
    lines += ["[frames_training]", f"batch = {read_preset(base).denoiser_training.batch}"]
    return "\n".join(lines) + "\n"


def prepare_run(variant: str, seed: int, options: argparse.Namespace) -> Path:
    """Make the folder of one run: links to the shared autoencoders and caches, and its preset."""
    run: Path = options.work / f"{variant}_seed{seed}"
    vaes = [f"vae_{level}" for level in LEVELS]
    # latent denoisers measure the tables themselves, and would write through a link
    tables = ["tables.npz"] if is_skeleton_space(variant) else []
    link_shared(run, options.autoencoders, [*vaes, *CAPTION_CACHES, "latents.pt", "states.npz", *tables])
    text = preset_text(variant, options.preset, seed, options.steps)
    (run / "preset.toml").write_text(text, encoding="utf-8")
    return run


def main() -> int:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("variants", nargs="+", choices=sorted(path.stem for path in PRESETS.glob("*.toml")))
    add_arguments(parser, "data", "held_out", "autoencoders", "out", optional=("out",), repeats=3)
    parser.add_argument("--work", type=Path, required=True, help="folder of the runs")
    parser.add_argument("--preset", default="edge", help="name or absolute path of the base of all variants (edge)")
    parser.add_argument("--assets", type=Path, help="text files of the autoencoders' run (those of installed bundles)")
    parser.add_argument("--steps", type=int, default=3000, help="training steps of each variant (3000)")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1], help="of the training")
    options = parser.parse_args()
    results: dict[str, list[dict[str, Any]]] = {}
    for seed in options.seeds:
        for variant in options.variants:
            run = prepare_run(variant, seed, options)
            stage = "train_frames" if is_skeleton_space(variant) else "train_denoisers"
            train(run, options, stage=stage, assets=options.assets)
            results.setdefault(variant, []).append(evaluate_run(run, options))
    table = markdown_table(results)
    (options.work / "comparison.md").write_text(table, encoding="utf-8")
    budget = {"steps": options.steps, "seeds": options.seeds, "repeats": options.repeats}
    write_report(options.out, {**budget, "variants": results}, table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
