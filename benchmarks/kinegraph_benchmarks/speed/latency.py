"""Time the published method and ours at the published size, taking turns in one process.

    python -m kinegraph_benchmarks.speed.latency --out latency.json [--quick]

Each arm draws one sample in 15/15/20 steps with guidance, at the sizes of preset `paper`, with random weights. The arms
are GraphMotion's denoisers as published, in eager torch and as a plain ONNX export, our network in eager torch, and our
graphs (float32 and int8; one thread and two). Then composition of three concepts is timed against plain guidance. The
ratio to trust is that of minima.
"""

from __future__ import annotations

import sys
from typing import Any

import torch

from kinegraph.bench import GRAPH, machine
from kinegraph.bundle.reader import read_bundle
from kinegraph.bundle.sessions import available_cpus
from kinegraph.concepts import DEFAULT_LAMBDAS
from kinegraph.denoising import LatentSampler
from kinegraph.diffusion.composition import CompositionWeights
from kinegraph.options import resolve_options
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.timing import Arm, time_interleaved, timing_table
from kinegraph_benchmarks.speed import published_size
from kinegraph_export.graphs import Precision

PUBLISHED, PLAIN = "published, eager torch", "published, plain ONNX export"
PUBLISHED_STEPS = (15, 15, 20)
"""Diffusion steps of GraphMotion's levels."""


def composition_arm(sampler: LatentSampler, task: published_size.SamplingTask) -> Arm:
    """Make the arm of three concepts and their joint text, fused; the task has four graphs."""
    weights = CompositionWeights((1.0, 1.0, 1.0), (1.0,), lambdas=DEFAULT_LAMBDAS)
    return lambda: sampler.sample(task.conditions, weights, [task.options])


def make_arms(quick: bool) -> tuple[dict[str, Arm], dict[str, Arm]]:
    """Make the arms of the comparison, and those of composition."""
    steps = (2, 2, 2) if quick else PUBLISHED_STEPS
    options = resolve_options(read_bundle(None).manifest, seconds=4, seed=1, steps=steps)
    task = published_size.paper_task(GRAPH, options)
    concepts = published_size.paper_task(GRAPH, options, copies=4)
    cpus = available_cpus()
    torch.set_num_threads(cpus)
    concat, cross = published_size.random_hierarchy("concat"), published_size.random_hierarchy("cross")
    print("exporting", file=sys.stderr)
    published_torch = published_size.torch_levels(concat)
    published_onnx = published_size.plain_onnx_levels(concat, task, cpus)
    our_torch = published_size.torch_levels(cross)
    arms: dict[str, Arm] = {
        PUBLISHED: lambda: published_size.sample(task, published_torch),
        PLAIN: lambda: published_size.sample(task, published_onnx),
        "ours, eager torch": lambda: published_size.sample(task, our_torch),
    }
    composition: dict[str, Arm] = {}
    precisions: tuple[Precision, ...] = ("fp32", "int8")
    for precision in precisions:
        graphs = published_size.export_graphs(cross, task, precision)
        for threads in sorted({1, cpus}):
            sampler = published_size.make_sampler(graphs, task, threads)
            name = f"ours, {precision}, {threads} thread" + "s" * (threads > 1)
            arms[name] = lambda sampler=sampler: sampler.sample(task.conditions, None, [task.options])
            if precision == "int8":
                composition[f"plain, {threads} threads"] = arms[name]
                composition[f"three concepts, {threads} threads"] = composition_arm(sampler, concepts)
    return arms, composition


def markdown_table(result: dict[str, Any]) -> str:
    """Format a result as Markdown."""
    lines = ["Paper size, random weights, one sample with guidance; " + result["machine"]["cpu"] + ".", ""]
    lines += [timing_table(result["latency_ms"], against=PUBLISHED), ""]
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
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "out", repeats=20, quick="two steps a level and two repeats")
    options = parser.parse_args()
    arms, composition = make_arms(options.quick)
    repeats = 2 if options.quick else options.repeats
    result = {
        "machine": {**machine(), "torch": torch.__version__},
        "quick": options.quick,
        "latency_ms": time_interleaved(arms, repeats),
        "composition_ms": time_interleaved(composition, repeats),
    }
    write_report(options.out, result, markdown_table(result))


if __name__ == "__main__":
    main()
