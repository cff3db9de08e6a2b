"""Run `kinegraph bench` on one core, and on a quarter of one where cgroups allow it.

    python -m kinegraph_benchmarks.speed.constrained_cpu --out low_power.json [--quick]

The quota needs the permission to make a control group. Linux only.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.bench import machine
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_report

CGROUPS = Path("/sys/fs/cgroup")
PERIOD = 100_000
"""Scheduling period, microseconds (the kernel's default), of which a quarter may be used."""


@contextmanager
def quarter_core_group() -> Iterator[Path | None]:
    """Make a control group whose processes get a quarter of a core; yields None where that is not allowed."""
    version_2 = (CGROUPS / "cgroup.controllers").is_file()
    group = (CGROUPS if version_2 else CGROUPS / "cpu") / f"kinegraph_bench_{os.getpid()}"
    try:
        group.mkdir()
        if version_2:
            (group / "cpu.max").write_text(f"{PERIOD // 4} {PERIOD}")
        else:
            (group / "cpu.cfs_period_us").write_text(str(PERIOD))
            (group / "cpu.cfs_quota_us").write_text(str(PERIOD // 4))
    except OSError as error:
        print(f"no quota: {error}", file=sys.stderr)
        if group.is_dir():
            group.rmdir()
        yield None
        return
    try:
        yield group
    finally:
        group.rmdir()


def bench_on_one_core(bundle: str | Path | None, repeats: int, group: Path | None) -> dict[str, Any]:
    """Run `kinegraph bench` on one core, as a member of a control group if there is one, and read its report."""
    core = min(os.sched_getaffinity(0))

    def confine() -> None:
        os.sched_setaffinity(0, {core})
        if group is not None:
            (group / "cgroup.procs").write_text(str(os.getpid()))

    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "bench.json"
        bundle_option = [] if bundle is None else ["--bundle", str(bundle)]
        command = [sys.executable, "-m", "kinegraph", "bench", "--repeats", str(repeats), "--json", str(out)]
        subprocess.run([*command, *bundle_option], check=True, stdout=subprocess.DEVNULL, preexec_fn=confine)
        report: dict[str, Any] = json.loads(out.read_text(encoding="utf-8"))
    return report


def markdown_table(result: dict[str, Any]) -> str:
    """Format a result as Markdown."""
    lines = [f"{result['machine']['cpu']}.", "", "| ms | sentence to file, median (minimum) | first file, graph |"]
    lines.append("|---|---|---|")
    for name, report in result["reports"].items():
        if report is None:
            lines.append(f"| {name} | not allowed here | |")
            continue
        total, cold = report["stages"]["total"], report["cold"]["graph"]["milliseconds"]
        lines.append(f"| {name} | {np.median(total):.0f} ({min(total):.0f}) | {min(cold):.0f} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "bundle", "out", repeats=20, quick="two repeats")
    options = parser.parse_args()
    repeats = 2 if options.quick else options.repeats
    reports = {"one core": bench_on_one_core(options.bundle, repeats, None)}
    with quarter_core_group() as group:
        reports["a quarter of a core"] = None if group is None else bench_on_one_core(options.bundle, repeats, group)
    result = {"machine": machine(), "quick": options.quick, "reports": reports}
    write_report(options.out, result, markdown_table(result))


if __name__ == "__main__":
    main()
