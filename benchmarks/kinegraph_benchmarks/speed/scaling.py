"""What costs what, through the runtime: frames, steps, concepts, batches.

    python -m kinegraph_benchmarks.speed.scaling --out scaling.json [--quick]

From parsed graphs to joints, so without the parser. The arms of each table take turns in one process. A cost is linear
when a straight line through the minima explains it; the table says by how much it fails to.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph import Concept, MotionPipeline
from kinegraph.bench import GRAPH, machine
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.timing import Arm, in_one_process, summary

FRAMES = (20, 60, 100, 148, 196)
STEPS = (5, 10, 20, 40)
BATCHES = (1, 4, 16, 32)
CONCEPTS = (1, 2, 3, 5, 8)
STEP_SIZES = (0.1, 0.1)
WORDS = (
    "a person walks forward", "a person waves the right hand", "a person raises the left hand", "a person runs",
    "a person bows", "a person turns left", "a person waves both hands", "an old person walks",
)  # fmt: skip


def frame_arms(pipe: MotionPipeline) -> dict[str, Arm]:
    """Lengths of a clip."""
    fps = pipe.manifest.fps
    return {f"{n} frames": lambda n=n: pipe.generate(GRAPH, seconds=n / fps, seed=1) for n in FRAMES}  # type: ignore[misc]


def step_arms(pipe: MotionPipeline) -> dict[str, Arm]:
    """Diffusion steps, the same number at each level."""
    return {f"{n} steps": lambda n=n: pipe.generate(GRAPH, seconds=4, seed=1, steps=n) for n in STEPS}  # type: ignore[misc]


def batch_arms(pipe: MotionPipeline) -> dict[str, Arm]:
    """Different sentences in one call."""
    graphs = [pipe.parse(text) for text in WORDS]

    def run(count: int) -> object:
        wanted = [graphs[place % len(graphs)] for place in range(count)]
        return pipe.batch(wanted, seconds=4, seed=1)

    return {f"batch of {n}": lambda n=n: run(n) for n in BATCHES}  # type: ignore[misc]


def concept_arms(pipe: MotionPipeline) -> dict[str, Arm]:
    """Fused composition of more and more concepts, of three also with AGD, beside one plain clip."""
    graphs = [pipe.parse(text) for text in WORDS]

    def joint(count: int) -> Any:
        return pipe.parse(" while ".join(WORDS[: min(count, 4)]))

    found: dict[str, Arm] = {"plain": lambda: pipe.generate(graphs[0], seconds=4, seed=1)}
    agd = {f"{count} concepts": None for count in CONCEPTS} | {"3 concepts, AGD": STEP_SIZES}
    for name, sizes in agd.items():
        count = int(name.split()[0])
        concepts, text = [Concept(graph) for graph in graphs[:count]], joint(count)
        found[name] = lambda concepts=concepts, text=text, sizes=sizes: pipe.compose(
            concepts, text=text, agd=sizes, seconds=4, seed=1
        )
    return found


def line(times: Mapping[str, list[float]]) -> dict[str, float]:
    """Least squares through the minima over the numbers in the names: ms at 0, ms per unit, and the largest deviation
    from the line as a share of the largest time."""
    x = np.array([float(name.split()[0]) for name in times])
    y = np.array([min(values) for values in times.values()])
    slope, start = np.polyfit(x, y, 1)
    return {
        "start_ms": float(start),
        "per_unit_ms": float(slope),
        "deviation": float(np.abs(start + slope * x - y).max() / y.max()),
    }


def throughput(times: Mapping[str, list[float]]) -> dict[str, float]:
    """Clips a second by batch, from the minima."""
    return {name: 1000.0 * int(name.split()[-1]) / min(values) for name, values in times.items()}


def table(result: dict[str, Any]) -> str:
    """Markdown."""
    lines = [f"From graphs to joints; {result['machine']['cpu']}.", ""]
    for name in ("frames", "steps"):
        fit = result["lines"][name]
        lines += [summary(result["times_ms"][name]), ""]
        lines += [f"{fit['start_ms']:.1f} ms + {fit['per_unit_ms']:.3f} ms each, to {fit['deviation']:.0%}.", ""]
    for threads, times in result["times_ms"]["concepts"].items():
        lines += [f"{threads}:", "", summary(times), ""]
        plain = min(times["plain"])
        ratios = ", ".join(f"{name} {min(own) / plain:.2f}" for name, own in times.items() if name != "plain")
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
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bundle", type=Path, help="folder of a bundle; the default bundle without it")
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--quick", action="store_true", help="two repeats: does it run?")
    parser.add_argument("--out", type=Path, required=True, help="JSON file; a .md file is written beside it")
    given = parser.parse_args()
    repeats = 2 if given.quick else given.repeats
    pipe = MotionPipeline.load(given.bundle)
    both = {"default threads": pipe, "2 threads": MotionPipeline.load(given.bundle, threads=2)}
    times: dict[str, Any] = {
        "frames": in_one_process(frame_arms(pipe), repeats),
        "steps": in_one_process(step_arms(pipe), repeats),
        "concepts": {name: in_one_process(concept_arms(each), repeats) for name, each in both.items()},
        "batches": {name: in_one_process(batch_arms(each), max(2, repeats // 3)) for name, each in both.items()},
    }
    lines = {name: line(times[name]) for name in ("frames", "steps")}
    result = {"machine": machine(), "quick": given.quick, "times_ms": times, "lines": lines}
    write_report(given.out, result, table(result))


if __name__ == "__main__":
    main()
