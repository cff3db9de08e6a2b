"""Life on little: `kinegraph bench` on one core, and on a quarter of one where cgroups allow it.

    python -m kinegraph_benchmarks.speed.constrained_cpu --out low_power.json [--quick]

The quota needs the right to make a control group. Linux only.
"""

from __future__ import annotations

import argparse
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
from kinegraph_benchmarks.common.report_io import write_report

CGROUPS = Path("/sys/fs/cgroup")
PERIOD = 100_000
"""Microseconds, the kernel's own; a quarter of it may be used."""


@contextmanager
def quarter_core() -> Iterator[Path | None]:
    """A group whose processes get a quarter of a core; None where none can be made."""
    newer = (CGROUPS / "cgroup.controllers").is_file()
    group = (CGROUPS if newer else CGROUPS / "cpu") / f"kinegraph_bench_{os.getpid()}"
    try:
        group.mkdir()
        if newer:
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


def benched(bundle: Path | None, repeats: int, group: Path | None) -> dict[str, Any]:
    """`kinegraph bench` on one core; as a member of a group, if there is one."""
    core = min(os.sched_getaffinity(0))

    def confined() -> None:
        os.sched_setaffinity(0, {core})
        if group is not None:
            (group / "cgroup.procs").write_text(str(os.getpid()))

    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "bench.json"
        more = [] if bundle is None else ["--bundle", str(bundle)]
        words = [sys.executable, "-m", "kinegraph", "bench", "--repeats", str(repeats), "--json", str(out), *more]
        subprocess.run(words, check=True, stdout=subprocess.DEVNULL, preexec_fn=confined)
        found: dict[str, Any] = json.loads(out.read_text(encoding="utf-8"))
    return found


def table(result: dict[str, Any]) -> str:
    """Markdown."""
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
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bundle", type=Path, help="folder of a bundle; the default bundle without it")
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--quick", action="store_true", help="two repeats: does it run?")
    parser.add_argument("--out", type=Path, required=True, help="JSON file; a .md file is written beside it")
    given = parser.parse_args()
    repeats = 2 if given.quick else given.repeats
    reports = {"one core": benched(given.bundle, repeats, None)}
    with quarter_core() as group:
        reports["a quarter of a core"] = None if group is None else benched(given.bundle, repeats, group)
    result = {"machine": machine(), "quick": given.quick, "reports": reports}
    write_report(given.out, result, table(result))


if __name__ == "__main__":
    main()
