"""Time alternatives so that they can be compared: they take turns in one process, and every repeat is kept."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np

Arm = Callable[[], object]
"""One of the alternatives: a call to time."""


def time_interleaved(arms: Mapping[str, Arm], repeats: int, warm_up: int = 2) -> dict[str, list[float]]:
    """Time every arm once per round, so that a slow phase of the machine hits all of them.

    Args:
        arms: calls to time, by name.
        repeats: rounds that count.
        warm_up: rounds before them that do not.

    Returns:
        Milliseconds of every repeat of every arm, to a microsecond.
    """
    for _ in range(warm_up):
        for run in arms.values():
            run()
    times: dict[str, list[float]] = {name: [] for name in arms}
    for _ in range(repeats):
        for name, run in arms.items():
            start = time.perf_counter()
            run()
            times[name].append(round(1000.0 * (time.perf_counter() - start), 3))
    return times


def timing_table(times: Mapping[str, list[float]], against: str | None = None) -> str:
    """Format times as Markdown: median, minimum and 95th percentile of each arm.

    Args:
        times: milliseconds of every repeat, by arm.
        against: an arm; adds a column with the ratio of its minimum to that of each arm.
    """
    lines = ["| ms | median | minimum | p95 |" + (f" {against} / this |" if against else "")]
    lines.append("|---|---|---|---|" + ("---|" if against else ""))
    for name, values in times.items():
        cells = f"| {name} | {np.median(values):.1f} | {min(values):.1f} | {np.percentile(values, 95):.1f} |"
        lines.append(cells + (f" {min(times[against]) / min(values):.2f} |" if against else ""))
    return "\n".join(lines)
