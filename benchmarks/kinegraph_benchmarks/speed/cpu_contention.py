"""Measure threads and spinning on an idle machine and beside processes that keep every CPU busy.

    python -m kinegraph_benchmarks.speed.cpu_contention --out neighbours.json [--quick]

Every setting runs in a process of its own, because a thread pool that spins would disturb the others: once with nothing
else to do and once beside a busy loop on every CPU. The CPU use of sleeping pools is measured too.
"""

from __future__ import annotations

import json
import multiprocessing
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.bench import machine
from kinegraph.bundle.sessions import available_cpus
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_report

SETTINGS = ("default", "1 thread", "2 threads", "2 threads, always spinning", "2 threads, never spinning")

# Loads a bundle, warms up, and prints the times of clips from a graph and the share of a core in use while it sleeps.
SCRIPT = """
import json, sys, time
from pathlib import Path
import onnxruntime
from kinegraph import MotionPipeline
from kinegraph.bench import GRAPH
threads, spinning, repeats, bundle = json.loads(sys.argv[1])
load_options = {"threads": threads}
if spinning:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "1" if spinning == "always" else "0")
    load_options = {"session_options": options}
pipe = MotionPipeline.load(bundle, **load_options)
times = []
for repeat in range(repeats + 3):
    start = time.perf_counter()
    pipe.generate(GRAPH, seconds=4, seed=1)
    times.append(1000 * (time.perf_counter() - start))
start = time.process_time()
time.sleep(1)
print(json.dumps({"times_ms": [round(t, 3) for t in times[3:]], "idle_cpu": time.process_time() - start}))
"""


def measure_setting(setting: str, repeats: int, bundle: str | Path | None) -> dict[str, Any]:
    """Measure one setting in a fresh process: times of every repeat, ms, and CPU use while asleep."""
    threads = None if setting == "default" else int(setting.split()[0])
    spinning = setting.split()[2] if setting.endswith("spinning") else None
    arguments = [threads, spinning, repeats, None if bundle is None else str(bundle)]
    process = subprocess.run([sys.executable, "-c", SCRIPT, json.dumps(arguments)], stdout=subprocess.PIPE, check=True)
    times: dict[str, Any] = json.loads(process.stdout)
    return times


def spin() -> None:
    """Keep one CPU busy forever."""
    while True:
        sum(range(10_000))


@contextmanager
def busy_neighbours(count: int) -> Iterator[None]:
    """Run that many busy loops in other processes while the block runs."""
    running = [multiprocessing.get_context("spawn").Process(target=spin, daemon=True) for _ in range(count)]
    for process in running:
        process.start()
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.join()


def markdown_table(result: dict[str, Any]) -> str:
    """Format a result as Markdown."""
    lines = [f"A clip of 4 s from its graph; {result['machine']['cpu']}, {result['machine']['cpus']} CPUs.", ""]
    lines += ["| ms, median (minimum) | idle machine | all CPUs busy | ratio of medians | CPU while asleep |"]
    lines += ["|---|---|---|---|---|"]
    for name in result["idle"]:
        idle, busy = result["idle"][name], result["busy"][name]
        cells = [f"{np.median(run['times_ms']):.1f} ({min(run['times_ms']):.1f})" for run in (idle, busy)]
        ratio = np.median(busy["times_ms"]) / np.median(idle["times_ms"])
        lines.append(f"| {name} | {' | '.join(cells)} | {ratio:.2f} | {idle['idle_cpu']:.1%} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "bundle", "out", repeats=40, quick="three repeats")
    options = parser.parse_args()
    repeats = 3 if options.quick else options.repeats
    result: dict[str, Any] = {"machine": machine(), "quick": options.quick}
    result["idle"] = {name: measure_setting(name, repeats, options.bundle) for name in SETTINGS}
    with busy_neighbours(available_cpus()):
        result["busy"] = {name: measure_setting(name, repeats, options.bundle) for name in SETTINGS}
    write_report(options.out, result, markdown_table(result))


if __name__ == "__main__":
    main()
