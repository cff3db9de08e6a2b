"""Run every benchmark of a model that has no result yet, and join the tables into one page.

    python -m kinegraph_benchmarks.run_all --data DATA/bandai --held-out DATA/held_out_pairs.json \
        --run runs/edge --out results

A benchmark whose JSON is in --out already is not run again: remove the file to measure anew. Each one also keeps its
own generated clips in --work, so a stopped run continues where it was. The ablations train models and take hours.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser

VARIANTS = ("ours", "one_stage", "concat", "no_graph", "no_reasoning", "specific_only", "motion_specific",
            "nodes_by_level")  # fmt: skip


@dataclass(frozen=True)
class Benchmark:
    """One module of this package with its arguments: it writes `{result}.json` and prints its table."""

    result: str
    """Stem of the result file."""
    module: str
    """Name below `kinegraph_benchmarks`."""
    title: str
    arguments: tuple[str, ...]

    def command(self, folder: Path) -> list[str]:
        """Build the command line that writes this benchmark's JSON into `folder`."""
        module = f"kinegraph_benchmarks.{self.module}"
        return [sys.executable, "-m", module, *self.arguments, "--out", str(folder / f"{self.result}.json")]


def list_benchmarks(options: argparse.Namespace) -> list[Benchmark]:
    """List all benchmarks of a model, the cheap ones first."""
    data, work = ("--data", str(options.data)), ("--work", str(options.work))
    held_out = ("--held-out", str(options.held_out))
    run, repeats = ("--run", str(options.run)), ("--repeats", str(options.repeats))
    benchmarks = [
        Benchmark("reconstruction", "quality.reconstruction", "What the autoencoders keep (GraphMotion, Table D)",
                  (*data, *run)),
        Benchmark("behaviour", "quality.behaviour", "Behaviours beside captured clips", data),
        Benchmark("lengths", "quality.duration_sweep", "Sentences at any length", data),
        Benchmark("waves", "quality.waves", "Waves at any length", data),
        Benchmark("turns", "quality.turns", "How far turns go", data),
        Benchmark("sequences", "quality.sequences", "Parts of sequences", data),
        Benchmark("constraints", "quality.constraints", "Paths, places, poses", data),
        Benchmark("take_equality", "quality.take_equality", "Takes and the clips of their seeds", ()),
        Benchmark("negations", "quality.negations", "Actions that must not happen", data),
        Benchmark("wording", "quality.wording", "Directions, orders and lengths in words", data),
        Benchmark("everyday", "quality.everyday", "Everyday sentences", ()),
        Benchmark("foot_fix", "quality.foot_fix", "Feet held, and not", data),
        Benchmark("evaluate", "quality.evaluate", "The default bundle", (*data, *held_out, *work, *repeats)),
        Benchmark("masked_verbs", "quality.masked_verbs", "Verbs masked (GraphMotion, Table 6)", (*data, *work)),
        Benchmark("edit_curves", "quality.edit_curves", "Weights of edges", ()),
        Benchmark("composition_settings", "quality.composition_settings",
                  "Ways of composing (EnergyMoGen, Tables 7 and 9)", (*data, *held_out)),
        Benchmark("composition", "quality.composition", "Two and three concepts, and weights", ()),
        Benchmark("temporal_composition", "quality.temporal_composition",
                  "One text after another (EnergyMoGen, Table 5)", (*data, *held_out)),
        Benchmark("mtt", "quality.mtt", "Timelines (EnergyMoGen, Tables 3, 6, 7 and 9)", data),
        Benchmark("sampling", "quality.sampler_sweep", "Steps, spacing and guidance", (*data, *work)),
    ]  # fmt: skip
    return benchmarks + (list_ablations(options) if options.compare_steps else [])


def list_ablations(options: argparse.Namespace) -> list[Benchmark]:
    """List the benchmarks that train models, within the budget of `--compare-steps` and `--seeds`."""
    seeds = tuple(map(str, options.seeds))
    shared = ("--data", str(options.data), "--held-out", str(options.held_out), "--autoencoders", str(options.run),
              "--work", str(options.work / "comparisons"))  # fmt: skip
    title = f"Comparisons and ablations, {options.compare_steps} steps each, seeds {', '.join(seeds)}"
    variants = (*VARIANTS, *shared, "--steps", str(options.compare_steps), "--seeds", *seeds)
    tokens = (*shared, "--steps", str(options.compare_steps // 2))
    return [
        Benchmark("compare", "ablations.compare", title, variants),
        Benchmark("latent_tokens", "ablations.latent_tokens", "Latent tokens (EnergyMoGen, Table 8)", tokens),
    ]


def join_tables(folder: Path, benchmarks: Sequence[Benchmark]) -> str:
    """Join the tables that exist so far into one Markdown page."""
    parts = [
        "# What was measured\n",
        "Made by `python -m kinegraph_benchmarks.run_all`; every number is in the JSON beside it.\n",
    ]
    for benchmark in benchmarks:
        table = folder / f"{benchmark.result}.md"
        if table.is_file():
            parts.append(f"## {benchmark.title}\n\n{table.read_text(encoding='utf-8').strip()}\n")
    return "\n".join(parts)


def run_benchmarks(folder: Path, benchmarks: Sequence[Benchmark]) -> int:
    """Run what has no table in `folder` yet; stop at the first benchmark that fails.

    Returns:
        0, or the exit status of the benchmark that wrote no result.
    """
    page = folder / "README.md"
    for number, benchmark in enumerate(benchmarks, start=1):
        # A benchmark writes its table last; long ones write their JSON after every row, and go on from it.
        table = folder / f"{benchmark.result}.md"
        if table.is_file():
            continue
        print(f"{number} of {len(benchmarks)}: {benchmark.title}", file=sys.stderr)
        start = time.monotonic()
        process = subprocess.run(benchmark.command(folder), stdout=subprocess.PIPE, text=True, check=False)
        if not table.is_file():
            return process.returncode or 1
        # Join after every benchmark: the page is complete up to here whatever happens next.
        page.write_text(join_tables(folder, benchmarks), encoding="utf-8")
        print(f"   {time.monotonic() - start:.0f} s", file=sys.stderr)
    page.write_text(join_tables(folder, benchmarks), encoding="utf-8")
    return 0


def main() -> int:
    """Run the command line: 0 if everything has a result, else the exit status of the benchmark that failed."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "data", "held_out", "run", "work", repeats=20)
    parser.add_argument("--out", type=Path, required=True, help="folder of the tables")
    parser.add_argument("--compare-steps", type=int, default=3000, help="training steps of each variant; 0 for none")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3], help="of the comparisons")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    return run_benchmarks(options.out, list_benchmarks(options))


if __name__ == "__main__":
    sys.exit(main())
