"""Measure whether training on motion that the model composed itself helps (EnergyMoGen, section 5.5; Table 1, end).

    python -m kinegraph_benchmarks.ablations.compml --data DATA/bandai --held-out DATA/held_out_pairs.json \
        --start runs/recovered --work compml --count 300 --steps 400 --seeds 1 2 3 --out compml.json

The three rows are the weights of --start as they are, trained further on recorded motion alone, and trained further on
recorded and composed motion. Everything else is equal: steps, batch, seeds, learning rate. Composed clips come from
--bundle, which should have the weights of --start (`python -m kinegraph_export.recover` makes such a run of a bundle).
Rows are sampled in torch and measured by `quality.evaluate`. Composed clips, trained weights and evaluations are kept
in --work, so a stopped comparison continues where it was.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

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

AUTOENCODERS = [f"vae_{level}" for level in LEVELS]
BEFORE, RECORDED, COMPOSED = "before", "recorded", "recorded + composed"
RATE = 0.5
"""Share of the preset's learning rate, as in the paper (appendix A: 1e-4, then 5e-5 with CompML)."""
WARMUP = 0.1
"""Share of the steps in which the learning rate rises, because the optimiser starts anew."""

Results = dict[str, list[dict[str, Any]]]
"""Evaluations by row, one for each seed."""


def preset_toml(base: str, seed: int, steps: int) -> str:
    """Write the TOML preset of a fine-tune; both rows use the same one."""
    rate = RATE * read_preset(base).denoiser_training.learning_rate
    lines = ("[denoiser_training]", f"steps = {steps}", f"learning_rate = {rate}", f"warmup = {int(WARMUP * steps)}")
    return "\n".join((f'base = "{base}"', f"seed = {seed}", "", *lines, ""))


def compose_clips(options: argparse.Namespace) -> Path:
    """Compose clips with the bundle as far as they are not there yet; returns their folder."""
    folder: Path = options.work / "composed"
    command = [sys.executable, "-m", "kinegraph_training.compml", "--data", str(options.data)]
    command += ["--held-out", str(options.held_out), "--count", str(options.count), "--out", str(folder)]
    command += ["--bundle", str(options.bundle)] if options.bundle else []
    subprocess.run(command, check=True)
    return folder


def fine_tune(seed: int, extra_data: Sequence[Path], options: argparse.Namespace) -> dict[str, Any]:
    """Train the weights of --start further on recorded motion and extra data, and evaluate them."""
    name = f"composed_{options.count}" if extra_data else "recorded"
    run, first_run = (options.work / f"{name}_steps{options.steps}_seed{number}" for number in (seed, options.seeds[0]))
    link_shared(run, options.start, AUTOENCODERS)
    if seed != options.seeds[0]:
        link_shared(run, first_run, [*CAPTION_CACHES, "latents.pt"])
    (run / "preset.toml").write_text(preset_toml(options.preset, seed, options.steps), encoding="utf-8")
    start = ["--start-from", str(options.start / "denoisers" / "last.ckpt")]
    train(run, options, [*start, *(word for folder in extra_data for word in ("--more", str(folder)))])
    return evaluate_run(run, options, ["--held-out", str(options.held_out)])


def evaluate_start(options: argparse.Namespace) -> dict[str, Any]:
    """Evaluate the weights that both rows start from."""
    run: Path = options.work / "before"
    link_shared(run, options.start, [*AUTOENCODERS, "denoisers", "tables.npz"])
    return evaluate_run(run, options, ["--held-out", str(options.held_out)])


def two_actions_table(results: Results) -> str:
    """Format as Markdown the share of captions of two actions whose motion shows both.

    Columns are in order and at once; of all captions, and apart for pairs that training joined and never joined.
    """
    first = next(iter(results.values()))[0]["two_actions"]
    columns = [(kind, apart) for kind, parts in first.items() for apart in (None, *parts["generated_apart"])]
    names = [" ".join((kind, apart or "all")).replace("_", " ") for kind, apart in columns]
    lines = ["**both actions happen**", "", "| | " + " | ".join(names) + " |", "|---|" + "---|" * len(names)]
    rows = {"captured": [{"two_actions": {kind: as_generated(parts) for kind, parts in first.items()}}], **results}
    for name, seeds in rows.items():
        rates = [[both_hold(seed["two_actions"][kind], apart) for seed in seeds] for kind, apart in columns]
        lines.append(f"| {name} | " + " | ".join(f"{np.mean(values):.3f}" for values in rates) + " |")
    return "\n".join(lines) + "\n"


def as_generated(parts: Mapping[str, Any]) -> dict[str, Any]:
    """Put the captured motion in the place of the generated one."""
    return {"generated": parts["captured"], "generated_apart": parts["captured_apart"]}


def both_hold(parts: Mapping[str, Any], apart: str | None) -> float:
    """Look up the rate of all captions, or of one group of pairs."""
    rate = parts["generated"]["both_hold"]["mean"] if apart is None else parts["generated_apart"][apart]["both_hold"]
    return float(rate)


def main() -> int:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "data", "held_out", "out", repeats=3)
    parser.add_argument("--start", type=Path, required=True, help="run with autoencoders, denoisers and tables.npz")
    parser.add_argument("--bundle", help="bundle that composes; the default bundle without it")
    parser.add_argument("--preset", default="edge", help="preset of --start")
    parser.add_argument("--work", type=Path, required=True, help="folder of the runs")
    parser.add_argument("--count", type=int, default=300, help="composed clips")
    parser.add_argument("--steps", type=int, default=400, help="training steps of each row (400)")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1], help="of the training")
    options = parser.parse_args()
    composed = compose_clips(options)
    results: Results = {BEFORE: [evaluate_start(options)], RECORDED: [], COMPOSED: []}
    for seed in options.seeds:
        results[RECORDED].append(fine_tune(seed, [], options))
        results[COMPOSED].append(fine_tune(seed, [composed], options))
    table = markdown_table(results) + "\n" + two_actions_table(results)
    budget = {name: getattr(options, name) for name in ("count", "steps", "seeds", "repeats")}
    write_report(options.out, {**budget, "rows": results}, table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
