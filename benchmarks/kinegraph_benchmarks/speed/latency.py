"""The published method and ours at the published size, taking turns in one process.

    python -m kinegraph_benchmarks.speed.latency --out latency.json [--quick]

One sample, 15/15/20 steps, guidance, paper preset, random weights. Arms: GraphMotion's denoisers as published in eager
torch and as a plain ONNX export, our network in eager torch, and our graphs (float32 and int8; one thread and two).
Then composition of three concepts against plain guidance. The ratio to trust is that of minima.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import torch

from kinegraph.bench import GRAPH, machine
from kinegraph.bundle.reader import read_bundle
from kinegraph.bundle.sessions import available_cpus
from kinegraph.concepts import DEFAULT_LAMBDAS
from kinegraph.denoising import LatentSampler
from kinegraph.diffusion.composition import CompositionWeights
from kinegraph.options import resolve_options
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.timing import Arm, in_one_process, summary
from kinegraph_benchmarks.speed import published_size as paper_size
from kinegraph_export.graphs import Precision

PUBLISHED, PLAIN = "published, eager torch", "published, plain ONNX export"
PUBLISHED_STEPS = (15, 15, 20)
"""Of GraphMotion's levels."""


def composed(sampler: LatentSampler, concepts: paper_size.Task) -> Arm:
    """Three concepts and their joint text, fused: rows of `concepts` are four graphs."""
    mixture = CompositionWeights((1.0, 1.0, 1.0), (1.0,), lambdas=DEFAULT_LAMBDAS)
    return lambda: sampler.sample(concepts.encoded, mixture, [concepts.options])


def arms(quick: bool) -> tuple[dict[str, Arm], dict[str, Arm]]:
    """Of the comparison, and of composition."""
    steps = (2, 2, 2) if quick else PUBLISHED_STEPS
    options = resolve_options(read_bundle(None).manifest, seconds=4, seed=1, steps=steps)
    task, concepts = paper_size.paper_task(GRAPH, options), paper_size.paper_task(GRAPH, options, copies=4)
    cpus = available_cpus()
    torch.set_num_threads(cpus)
    concat, cross = paper_size.hierarchy("concat"), paper_size.hierarchy("cross")
    print("exporting", file=sys.stderr)
    eager, plain = paper_size.in_torch(concat), paper_size.plainly_exported(concat, task, cpus)
    own = paper_size.in_torch(cross)
    found: dict[str, Arm] = {
        PUBLISHED: lambda: paper_size.sample(task, eager),
        PLAIN: lambda: paper_size.sample(task, plain),
        "ours, eager torch": lambda: paper_size.sample(task, own),
    }
    fused: dict[str, Arm] = {}
    precisions: tuple[Precision, ...] = ("fp32", "int8")
    for precision in precisions:
        graphs = paper_size.exported(cross, task, precision)
        for threads in sorted({1, cpus}):
            sampler = paper_size.ours(graphs, task, threads)
            name = f"ours, {precision}, {threads} thread" + "s" * (threads > 1)
            found[name] = lambda sampler=sampler: sampler.sample(task.encoded, None, [task.options])
            if precision == "int8":
                fused[f"plain, {threads} threads"] = found[name]
                fused[f"three concepts, {threads} threads"] = composed(sampler, concepts)
    return found, fused


def table(result: dict[str, Any]) -> str:
    """Markdown."""
    lines = ["Paper size, random weights, one sample with guidance; " + result["machine"]["cpu"] + ".", ""]
    lines += [summary(result["latency_ms"], against=PUBLISHED), ""]
    plain = min(result["latency_ms"][PLAIN])
    best = min(min(times) for name, times in result["latency_ms"].items() if name.startswith("ours, int8"))
    lines += [f"The plain export takes {plain / best:.2f} times as long as our best.", ""]
    times = result["composition_ms"]
    for name in [name for name in times if name.startswith("plain")]:
        threads = name.removeprefix("plain")
        ratio = min(times[f"three concepts{threads}"]) / min(times[name])
        lines.append(f"Three concepts fused{threads}: {ratio:.2f} times plain guidance.")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--quick", action="store_true", help="two steps a level and two repeats: does it run?")
    parser.add_argument("--out", type=Path, required=True, help="JSON file; a .md file is written beside it")
    given = parser.parse_args()
    compared, fused = arms(given.quick)
    repeats = 2 if given.quick else given.repeats
    result = {
        "machine": {**machine(), "torch": torch.__version__},
        "quick": given.quick,
        "latency_ms": in_one_process(compared, repeats),
        "composition_ms": in_one_process(fused, repeats),
    }
    write_report(given.out, result, table(result))


if __name__ == "__main__":
    main()
