"""The speed table of the README from what the benchmarks wrote.

    python -m kinegraph_benchmarks.speed.speed_table --results benchmarks/results [ANOTHER_MACHINE ...]

Reads bench.json (of `kinegraph bench`), latency.json, scaling.json, neighbours.json, low_power.json and precision.json
of each folder, one column a folder; what is missing is left out. Ratios are of minima of one process, arms taking
turns. Refuses quick runs.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph_benchmarks.speed.latency import PLAIN, PUBLISHED
from kinegraph_benchmarks.speed.scaling import throughput

Row = tuple[str, str]


def bench_rows(found: dict[str, Any]) -> list[Row]:
    """Of `kinegraph bench`."""
    stages = found["stages"]
    to_joints = np.array(stages["total"]) - np.array(stages["write"])
    rows = [
        (
            f"sentence to joints, a clip of {found['seconds']:g} s, parse included",
            f"{np.median(to_joints):.0f} ms (least {to_joints.min():.0f})",
        ),
        ("CPU while nothing is asked for", f"{found['idle_cpu']:.1%}"),
    ]
    for kind, start in found["cold"].items():
        memory = "" if start["peak_bytes"] is None else f", peak memory {start['peak_bytes'] / 1e6:.0f} MB"
        rows.append(
            (f"start of a process to its first file, from a {kind}", f"{min(start['milliseconds']):.0f} ms{memory}")
        )
    return rows


def latency_rows(found: dict[str, Any]) -> list[Row]:
    """Of `latency.py`."""
    times = {name: min(values) for name, values in found["latency_ms"].items()}
    best = min(value for name, value in times.items() if name.startswith("ours, int8"))
    rows = [
        ("published size: eager torch of GraphMotion as published, against ours", f"{times[PUBLISHED] / best:.1f} x"),
        ("published size: its plain ONNX export, against ours", f"{times[PLAIN] / best:.1f} x"),
        (
            "published size: our network in eager torch, against its int8 graphs",
            f"{times['ours, eager torch'] / best:.1f} x",
        ),
    ]
    fused = {name: min(values) for name, values in found["composition_ms"].items()}
    rows += [
        (f"published size: three concepts fused, against one{name.removeprefix('plain')}",
         f"{fused['three concepts' + name.removeprefix('plain')] / value:.2f} x")
        for name, value in fused.items() if name.startswith("plain")
    ]  # fmt: skip
    return rows


def scaling_rows(found: dict[str, Any]) -> list[Row]:
    """Of `scaling.py`."""
    times, lines = found["times_ms"], found["lines"]
    rows = [
        (f"{name}: cost of one more, and how far from a straight line",
         f"{lines[name]['per_unit_ms']:.2f} ms, {lines[name]['deviation']:.0%}")
        for name in ("frames", "steps")
    ]  # fmt: skip
    rows += [
        (
            f"three concepts fused, against a plain clip, {threads}",
            f"{min(own['3 concepts']) / min(own['plain']):.2f} x",
        )
        for threads, own in times["concepts"].items()
    ]
    rows += [
        (
            f"the same three concepts with AGD, against without, {threads}",
            f"{min(own['3 concepts, AGD']) / min(own['3 concepts']):.2f} x",
        )
        for threads, own in times["concepts"].items()
    ]
    for threads, own in times["batches"].items():
        rates = throughput(own)
        shown = ", ".join(f"{name.split()[-1]}: {rate:.0f}" for name, rate in rates.items())
        gain = rates["batch of 16"] / rates["batch of 1"]
        rows.append((f"clips a second in batches, {threads}", f"{shown} (16 against 1: {gain:.1f} x)"))
    return rows


def neighbour_rows(found: dict[str, Any]) -> list[Row]:
    """Of `neighbours.py`."""
    return [
        (f"every CPU busy elsewhere, against idle, {name}",
         f"{np.median(found['busy'][name]['times_ms']) / np.median(found['idle'][name]['times_ms']):.2f} x")
        for name in ("default", "2 threads")
    ]  # fmt: skip


def low_power_rows(found: dict[str, Any]) -> list[Row]:
    """Of `low_power.py`."""
    return [
        (f"sentence to file on {name}", f"{np.median(report['stages']['total']):.0f} ms")
        for name, report in found["reports"].items()
        if report is not None
    ]


def precision_rows(found: dict[str, Any]) -> list[Row]:
    """Of `precision.py`."""
    far, times = found["distance_mm"], found["times_ms"]
    scores = found["scores"]
    judged = ", ".join(
        f"{label} {scores['candidate'][name]['mean']:.3f} ({scores['reference'][name]['mean']:.3f})"
        for name, label in (("behaviour", "behaviour"), ("r_precision_1", "R@1"))
    )
    return [
        ("int8 against fp32 (in brackets), the same noise", judged),
        ("joints of int8 and fp32 apart", f"{far['world_mean']:.0f} mm, around the pelvis {far['local_mean']:.1f} mm"),
        ("int8 is faster", f"{min(times['reference']) / min(times['candidate']):.2f} x"),
    ]


PARTS: dict[str, Callable[[dict[str, Any]], list[Row]]] = {
    "bench": bench_rows,
    "latency": latency_rows,
    "scaling": scaling_rows,
    "neighbours": neighbour_rows,
    "low_power": low_power_rows,
    "precision": precision_rows,
}


def measured(folder: Path) -> tuple[str, dict[str, str]]:
    """Where and with what, and its rows.

    Raises:
        ValueError: a result is of a quick run or of another machine than the others, or there is none.
    """
    rows: list[Row] = []
    machine: dict[str, Any] = {}
    for name, make in PARTS.items():
        path = folder / f"{name}.json"
        if not path.is_file():
            continue
        found = json.loads(path.read_text(encoding="utf-8"))
        if found.get("quick"):
            raise ValueError(f"{path} is of a quick run, which only shows that the script works")
        machine = machine or found["machine"]
        if found["machine"]["cpu"] != machine["cpu"]:
            raise ValueError(f"{path} was measured on {found['machine']['cpu']}, others on {machine['cpu']}")
        rows += make(found)
    if not rows:
        raise ValueError(f"{folder} has none of {', '.join(f'{name}.json' for name in PARTS)}")
    about = f"{machine['cpu']}, {machine['cpus']} CPUs; kinegraph {machine['kinegraph']}, "
    return about + f"onnxruntime {machine['onnxruntime']}, Python {machine['python']}", dict(rows)


def report(folders: Sequence[Path]) -> str:
    """Markdown.

    Raises:
        ValueError: a result is of a quick run, or a folder has none or those of two machines.
    """
    columns = [measured(folder) for folder in folders]
    names = dict.fromkeys(name for _, rows in columns for name in rows)
    lines = ["| | " + " | ".join(about for about, _ in columns) + " |", "|---|" + "---|" * len(columns)]
    lines += [f"| {name} | " + " | ".join(rows.get(name, "") for _, rows in columns) + " |" for name in names]
    return "\n".join(lines) + "\n"


def main() -> int:
    """0: written; 2: nothing to report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--results",
        type=Path,
        nargs="+",
        required=True,
        help="folders of JSON files; speed.md is written to the first",
    )
    given = parser.parse_args()
    try:
        text = report(given.results)
    except (KeyError, ValueError) as error:
        print(f"report: error: {error}", file=sys.stderr)
        return 2
    (given.results[0] / "speed.md").write_text(text, encoding="utf-8")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
