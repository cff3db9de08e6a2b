"""Threads and spinning, on an idle machine and beside busy neighbours.

    python -m kinegraph_benchmarks.speed.cpu_contention --out neighbours.json [--quick]

Every setting is a process of its own (a pool that spins would disturb the others), once with nothing else to do and
once beside a busy loop on every CPU. Also says how much CPU sleeping pools use.
"""

from __future__ import annotations

import argparse
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
from kinegraph_benchmarks.common.report_io import write_report

SETTINGS = ("default", "1 thread", "2 threads", "2 threads, always spinning", "2 threads, never spinning")

# Loads, warms up, prints the times of clips from a graph, and the share of a core that is used while it sleeps.
MEASURED = """
import json, sys, time
from pathlib import Path
import onnxruntime
from kinegraph import MotionPipeline
from kinegraph.bench import GRAPH
threads, spinning, repeats, bundle = json.loads(sys.argv[1])
wishes = {"threads": threads}
if spinning:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "1" if spinning == "always" else "0")
    wishes = {"session_options": options}
pipe = MotionPipeline.load(bundle, **wishes)
times = []
for repeat in range(repeats + 3):
    start = time.perf_counter()
    pipe.generate(GRAPH, seconds=4, seed=1)
    times.append(1000 * (time.perf_counter() - start))
start = time.process_time()
time.sleep(1)
print(json.dumps({"times_ms": [round(t, 3) for t in times[3:]], "idle_cpu": time.process_time() - start}))
"""


def measured(setting: str, repeats: int, bundle: Path | None) -> dict[str, Any]:
    """One setting in a fresh process."""
    threads = None if setting == "default" else int(setting.split()[0])
    spinning = setting.split()[2] if setting.endswith("spinning") else None
    words = [threads, spinning, repeats, None if bundle is None else str(bundle)]
    done = subprocess.run([sys.executable, "-c", MEASURED, json.dumps(words)], stdout=subprocess.PIPE, check=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def busy() -> None:
    """A neighbour that never sleeps."""
    while True:
        sum(range(10_000))


@contextmanager
def neighbours(count: int) -> Iterator[None]:
    """Busy loops beside what runs inside."""
    running = [multiprocessing.get_context("spawn").Process(target=busy, daemon=True) for _ in range(count)]
    for process in running:
        process.start()
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.join()


def table(result: dict[str, Any]) -> str:
    """Markdown."""
    lines = [f"A clip of 4 s from its graph; {result['machine']['cpu']}, {result['machine']['cpus']} CPUs.", ""]
    lines += ["| ms, median (minimum) | idle machine | all CPUs busy | ratio of medians | CPU while asleep |"]
    lines += ["|---|---|---|---|---|"]
    for name in result["idle"]:
        calm, crowded = result["idle"][name], result["busy"][name]
        cells = [f"{np.median(own['times_ms']):.1f} ({min(own['times_ms']):.1f})" for own in (calm, crowded)]
        ratio = np.median(crowded["times_ms"]) / np.median(calm["times_ms"])
        lines.append(f"| {name} | {' | '.join(cells)} | {ratio:.2f} | {calm['idle_cpu']:.1%} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bundle", type=Path, help="folder of a bundle; the default bundle without it")
    parser.add_argument("--repeats", type=int, default=40)
    parser.add_argument("--quick", action="store_true", help="three repeats: does it run?")
    parser.add_argument("--out", type=Path, required=True, help="JSON file; a .md file is written beside it")
    given = parser.parse_args()
    repeats = 3 if given.quick else given.repeats
    result: dict[str, Any] = {"machine": machine(), "quick": given.quick}
    result["idle"] = {name: measured(name, repeats, given.bundle) for name in SETTINGS}
    with neighbours(available_cpus()):
        result["busy"] = {name: measured(name, repeats, given.bundle) for name in SETTINGS}
    write_report(given.out, result, table(result))


if __name__ == "__main__":
    main()
