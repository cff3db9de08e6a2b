"""Make one speed table from the results of the speed benchmarks, with a column for each machine.

    python -m kinegraph_benchmarks.speed.speed_table --results benchmarks/results/0.6.0/zen3 [ANOTHER_MACHINE ...]

Reads bench.json (of `kinegraph bench`), latency.json, scaling.json, neighbours.json, low_power.json and precision.json
of each folder; what is missing is left out. Ratios are those of minima. Results of quick runs are refused. Writes
speed.md into the first folder.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph_benchmarks.common.arguments import benchmark_parser
from kinegraph_benchmarks.speed.latency import PLAIN, PUBLISHED
from kinegraph_benchmarks.speed.scaling import throughput

Row = tuple[str, str]
"""Name and formatted value."""


def bench_rows(result: dict[str, Any]) -> list[Row]:
    """Format the result of `kinegraph bench`."""
    stages = result["stages"]
    to_joints = np.array(stages["total"]) - np.array(stages["write"])
    rows = [
        (
            f"sentence to joints, a clip of {result['seconds']:g} s, parse included",
            f"{np.median(to_joints):.0f} ms (least {to_joints.min():.0f})",
        ),
        ("CPU while nothing is asked for", f"{result['idle_cpu']:.1%}"),
    ]
    for kind, start in result["cold"].items():
        memory = "" if start["peak_bytes"] is None else f", peak memory {start['peak_bytes'] / 1e6:.0f} MB"
        rows.append(
            (f"start of a process to its first file, from a {kind}", f"{min(start['milliseconds']):.0f} ms{memory}")
        )
    return rows


def latency_rows(result: dict[str, Any]) -> list[Row]:
    """Format the result of `latency`."""
    times = {name: min(values) for name, values in result["latency_ms"].items()}
    best = min(value for name, value in times.items() if name.startswith("ours, int8"))
    rows = [
        ("published size: eager torch of GraphMotion as published, against ours", f"{times[PUBLISHED] / best:.1f} x"),
        ("published size: its plain ONNX export, against ours", f"{times[PLAIN] / best:.1f} x"),
        (
            "published size: our network in eager torch, against its int8 graphs",
            f"{times['ours, eager torch'] / best:.1f} x",
        ),
    ]
    fused = {name: min(values) for name, values in result["composition_ms"].items()}
    rows += [
        (f"published size: three concepts fused, against one{name.removeprefix('plain')}",
         f"{fused['three concepts' + name.removeprefix('plain')] / value:.2f} x")
        for name, value in fused.items() if name.startswith("plain")
    ]  # fmt: skip
    return rows


def scaling_rows(result: dict[str, Any]) -> list[Row]:
    """Format the result of `scaling`."""
    times, lines = result["times_ms"], result["lines"]
    rows = [
        (f"{name}: cost of one more, and how far from a straight line",
         f"{lines[name]['per_unit_ms']:.2f} ms, {lines[name]['deviation']:.0%}")
        for name in ("frames", "steps")
    ]  # fmt: skip
    rows += [
        (
            f"three concepts fused, against a plain clip, {threads}",
            f"{min(arms['3 concepts']) / min(arms['plain']):.2f} x",
        )
        for threads, arms in times["concepts"].items()
    ]
    rows += [
        (
            f"the same three concepts with AGD, against without, {threads}",
            f"{min(arms['3 concepts, AGD']) / min(arms['3 concepts']):.2f} x",
        )
        for threads, arms in times["concepts"].items()
    ]
    for threads, arms in times["batches"].items():
        rates = throughput(arms)
        shown = ", ".join(f"{name.split()[-1]}: {rate:.0f}" for name, rate in rates.items())
        gain = rates["batch of 16"] / rates["batch of 1"]
        rows.append((f"clips a second in batches, {threads}", f"{shown} (16 against 1: {gain:.1f} x)"))
    return rows


def contention_rows(result: dict[str, Any]) -> list[Row]:
    """Format the result of `cpu_contention`."""
    return [
        (f"every CPU busy elsewhere, against idle, {name}",
         f"{np.median(result['busy'][name]['times_ms']) / np.median(result['idle'][name]['times_ms']):.2f} x")
        for name in ("default", "2 threads")
    ]  # fmt: skip


def constrained_rows(result: dict[str, Any]) -> list[Row]:
    """Format the result of `constrained_cpu`."""
    return [
        (f"sentence to file on {name}", f"{np.median(report['stages']['total']):.0f} ms")
        for name, report in result["reports"].items()
        if report is not None
    ]


def precision_rows(result: dict[str, Any]) -> list[Row]:
    """Format the result of `quality.precision`."""
    far, times = result["distance_mm"], result["times_ms"]
    scores = result["scores"]
    judged = ", ".join(
        f"{label} {scores['candidate'][name]['mean']:.3f} ({scores['reference'][name]['mean']:.3f})"
        for name, label in (("behaviour", "behaviour"), ("r_precision_1", "R@1"))
    )
    return [
        ("int8 against fp32 (in brackets), the same noise", judged),
        ("joints of int8 and fp32 apart", f"{far['world_mean']:.0f} mm, around the pelvis {far['local_mean']:.1f} mm"),
        ("int8 is faster", f"{min(times['reference']) / min(times['candidate']):.2f} x"),
    ]


ROWS: dict[str, Callable[[dict[str, Any]], list[Row]]] = {
    "bench": bench_rows,
    "latency": latency_rows,
    "scaling": scaling_rows,
    "neighbours": contention_rows,
    "low_power": constrained_rows,
    "precision": precision_rows,
}


def read_column(folder: Path) -> tuple[str, dict[str, str]]:
    """Read the results of one machine.

    Returns:
        The head of the column (CPU and versions), and its rows by name.

    Raises:
        ValueError: a result is of a quick run or of another machine than the others, or there is none.
    """
    rows: list[Row] = []
    machine: dict[str, Any] = {}
    for name, format_rows in ROWS.items():
        path = folder / f"{name}.json"
        if not path.is_file():
            continue
        result = json.loads(path.read_text(encoding="utf-8"))
        if result.get("quick"):
            raise ValueError(f"{path} is of a quick run, which only shows that the script works")
        machine = machine or result["machine"]
        if result["machine"]["cpu"] != machine["cpu"]:
            raise ValueError(f"{path} was measured on {result['machine']['cpu']}, others on {machine['cpu']}")
        rows += format_rows(result)
    if not rows:
        raise ValueError(f"{folder} has none of {', '.join(f'{name}.json' for name in ROWS)}")
    head = f"{machine['cpu']}, {machine['cpus']} CPUs; kinegraph {machine['kinegraph']}, "
    return head + f"onnxruntime {machine['onnxruntime']}, Python {machine['python']}", dict(rows)


def markdown_table(folders: Sequence[Path]) -> str:
    """Format the results of some folders as Markdown, one column for each.

    Raises:
        ValueError: a result is of a quick run, or a folder has none or those of two machines.
    """
    columns = [read_column(folder) for folder in folders]
    names = dict.fromkeys(name for _, rows in columns for name in rows)
    lines = ["| | " + " | ".join(head for head, _ in columns) + " |", "|---|" + "---|" * len(columns)]
    lines += [f"| {name} | " + " | ".join(rows.get(name, "") for _, rows in columns) + " |" for name in names]
    return "\n".join(lines) + "\n"


def main() -> int:
    """Run the command line: 0 if the table was written, 2 if there is nothing to put into it."""
    parser = benchmark_parser(__doc__)
    parser.add_argument(
        "--results",
        type=Path,
        nargs="+",
        required=True,
        help="folders of JSON files; speed.md is written to the first",
    )
    options = parser.parse_args()
    try:
        table = markdown_table(options.results)
    except (KeyError, ValueError) as error:
        print(f"speed_table: error: {error}", file=sys.stderr)
        return 2
    (options.results[0] / "speed.md").write_text(table, encoding="utf-8")
    print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
