"""Measure how the runtime's time grows with frames, steps, concepts and batches.

    python -m kinegraph_benchmarks.speed.scaling --out scaling.json [--quick]

Clips are generated from parsed graphs to joints, so without the parser. The arms of each table take turns in one
process. A cost is linear if a straight line through the minima explains it; the table says by how much it fails to.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from kinegraph import Concept, MotionPipeline
from kinegraph.bench import GRAPH, machine
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.timing import Arm, time_interleaved, timing_table

FRAMES = (20, 60, 100, 148, 196)
STEPS = (5, 10, 20, 40)
BATCHES = (1, 4, 16, 32)
CONCEPTS = (1, 2, 3, 5, 8)
STEP_SIZES = (0.1, 0.1)
"""Of adaptive gradient descent, gamma_attn and gamma_reg."""
WORDS = (
    "a person walks forward", "a person waves the right hand", "a person raises the left hand", "a person runs",
    "a person bows", "a person turns left", "a person waves both hands", "an old person walks",
)  # fmt: skip


def frame_arms(pipe: MotionPipeline) -> dict[str, Arm]:
    """Make arms for lengths of a clip."""
    fps = pipe.manifest.fps
    return {f"{n} frames": lambda n=n: pipe.generate(GRAPH, seconds=n / fps, seed=1) for n in FRAMES}  # type: ignore[misc]


def step_arms(pipe: MotionPipeline) -> dict[str, Arm]:
    """Make arms for diffusion steps, the same number at each level."""
    return {f"{n} steps": lambda n=n: pipe.generate(GRAPH, seconds=4, seed=1, steps=n) for n in STEPS}  # type: ignore[misc]


def batch_arms(pipe: MotionPipeline) -> dict[str, Arm]:
    """Make arms for batches of different sentences in one call."""
    graphs = [pipe.parse(text) for text in WORDS]

    def run(count: int) -> object:
        batch = [graphs[index % len(graphs)] for index in range(count)]
        return pipe.batch(batch, seconds=4, seed=1, shared_run=True)

    return {f"batch of {n}": lambda n=n: run(n) for n in BATCHES}  # type: ignore[misc]


def concept_arms(pipe: MotionPipeline) -> dict[str, Arm]:
    """Make arms for fused composition of more and more concepts, of three also with AGD, and for one plain clip."""
    graphs = [pipe.parse(text) for text in WORDS]

    def joint(count: int) -> Any:
        return pipe.parse(" while ".join(WORDS[: min(count, 4)]))

    arms: dict[str, Arm] = {"plain": lambda: pipe.generate(graphs[0], seconds=4, seed=1)}
    agd = {f"{count} concepts": None for count in CONCEPTS} | {"3 concepts, AGD": STEP_SIZES}
    for name, sizes in agd.items():
        count = int(name.split()[0])
        concepts, text = [Concept(graph) for graph in graphs[:count]], joint(count)
        arms[name] = lambda concepts=concepts, text=text, sizes=sizes: pipe.compose(
            concepts, text=text, agd=sizes, seconds=4, seed=1
        )
    return arms


def fit_line(times: Mapping[str, list[float]]) -> dict[str, float]:
    """Fit a line through the minima by least squares, over the numbers at the beginning of the arms' names.

    Returns:
        "start_ms" at 0, "per_unit_ms", and "deviation", the largest distance from the line over the largest time.
    """
    x = np.array([float(name.split()[0]) for name in times])
    y = np.array([min(values) for values in times.values()])
    slope, start = np.polyfit(x, y, 1)
    return {
        "start_ms": float(start),
        "per_unit_ms": float(slope),
        "deviation": float(np.abs(start + slope * x - y).max() / y.max()),
    }


def throughput(times: Mapping[str, list[float]]) -> dict[str, float]:
    """Compute clips per second of each batch size, from the minima."""
    return {name: 1000.0 * int(name.split()[-1]) / min(values) for name, values in times.items()}


def markdown_table(result: dict[str, Any]) -> str:
    """Format a result as Markdown."""
    lines = [f"From graphs to joints; {result['machine']['cpu']}.", ""]
    for name in ("frames", "steps"):
        fit = result["lines"][name]
        lines += [timing_table(result["times_ms"][name]), ""]
        lines += [f"{fit['start_ms']:.1f} ms + {fit['per_unit_ms']:.3f} ms each, to {fit['deviation']:.0%}.", ""]
    for threads, times in result["times_ms"]["concepts"].items():
        lines += [f"{threads}:", "", timing_table(times), ""]
        plain = min(times["plain"])
        ratios = ", ".join(f"{name} {min(values) / plain:.2f}" for name, values in times.items() if name != "plain")
        adaptive = min(times["3 concepts, AGD"]) / min(times["3 concepts"])
        lines += [f"Times plain: {ratios}. AGD takes {adaptive:.2f} times as long as the same without it.", ""]
    for threads, times in result["times_ms"]["batches"].items():
        rates = throughput(times)
        single = rates["batch of 1"]
        lines += [f"{threads}:", "", "| | clips a second | against singles |", "|---|---|---|"]
        lines += [f"| {name} | {rate:.1f} | {rate / single:.2f} |" for name, rate in rates.items()]
        lines.append("")
    return "\n".join(lines)


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "bundle", "out", repeats=15, quick="two repeats")
    options = parser.parse_args()
    repeats = 2 if options.quick else options.repeats
    pipe = MotionPipeline.load(options.bundle)
    pipes = {"default threads": pipe, "2 threads": MotionPipeline.load(options.bundle, threads=2)}
    times: dict[str, Any] = {
        "frames": time_interleaved(frame_arms(pipe), repeats),
        "steps": time_interleaved(step_arms(pipe), repeats),
        "concepts": {name: time_interleaved(concept_arms(own), repeats) for name, own in pipes.items()},
        "batches": {name: time_interleaved(batch_arms(own), max(2, repeats // 3)) for name, own in pipes.items()},
    }
    lines = {name: fit_line(times[name]) for name in ("frames", "steps")}
    result = {"machine": machine(), "quick": options.quick, "times_ms": times, "lines": lines}
    write_report(options.out, result, markdown_table(result))


if __name__ == "__main__":
    main()
