"""Times that can be compared: the arms take turns in one process, every repeat is kept."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np

Arm = Callable[[], object]


def taking_turns(arms: Mapping[str, Arm], repeats: int, warm_up: int = 2) -> dict[str, list[float]]:
    """Milliseconds of every repeat of every arm; an arm runs once per turn, warm-up not counted."""
    for _ in range(warm_up):
        for run in arms.values():
            run()
    times: dict[str, list[float]] = {name: [] for name in arms}
    for _ in range(repeats):
        for name, run in arms.items():
            start = time.perf_counter()
            run()
            times[name].append(1000.0 * (time.perf_counter() - start))
    return times


def in_one_process(arms: Mapping[str, Arm], repeats: int) -> dict[str, list[float]]:
    """`taking_turns`, rounded to what a clock is worth."""
    return {name: [round(value, 3) for value in values] for name, values in taking_turns(arms, repeats).items()}


def summary(times: Mapping[str, list[float]], against: str | None = None) -> str:
    """Markdown: median, minimum, 95th percentile, and the ratio of minima to the arm `against`."""
    lines = ["| ms | median | minimum | p95 |" + (f" {against} / this |" if against else "")]
    lines.append("|---|---|---|---|" + ("---|" if against else ""))
    for name, values in times.items():
        cells = f"| {name} | {np.median(values):.1f} | {min(values):.1f} | {np.percentile(values, 95):.1f} |"
        lines.append(cells + (f" {min(times[against]) / min(values):.2f} |" if against else ""))
    return "\n".join(lines)
