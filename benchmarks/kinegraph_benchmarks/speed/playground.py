"""Measure the wait in the playground, from Generate to the first sketch and to the clip, in a headless browser.

    python -m kinegraph_benchmarks.speed.playground --out playground.json

The browser draws in software and shares the processors with the models, so this is the slowest case. The first press on
a new server is reported apart from the others. Writes JSON only.

Needs the extras text, play and browser, and a chromium.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Page, sync_playwright

from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_json

FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
TEXTS = ("a person walks forward", "an old person walks slowly and turns left", "a person waves both hands")


def press(page: Page, text: str) -> dict[str, float]:
    """Generate one clip of four seconds, and read the milliseconds of every stage off the page."""
    count = int(page.locator("html").get_attribute("data-made") or 0) + 1
    page.get_by_label("What should the person do?").fill(text)
    page.get_by_role("button", name="Generate").click()
    page.wait_for_selector(f"html[data-made='{count}']", state="attached", timeout=60_000)
    names, values = (page.locator(f".stages {tag}").all_text_contents() for tag in ("dt", "dd"))
    return {name: float(value.removesuffix(" ms")) for name, value in zip(names, values, strict=True)}


def measure_waits(repeats: int, threads: int | None, bundle: str | Path | None) -> dict[str, Any]:
    """Measure the first press and all others on one page of one server; milliseconds."""
    command = [sys.executable, "-m", "kinegraph", "play", "--port", "0", "--no-browser"]
    command += [] if threads is None else ["--threads", str(threads)]
    command += [] if bundle is None else ["--bundle", str(bundle)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server, sync_playwright() as driver:
        try:
            assert server.stdout is not None
            url = server.stdout.readline().split(" ")[0]
            browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
            page = browser.new_page(viewport={"width": 1280, "height": 800}, reduced_motion="reduce")
            page_bytes = len((page.goto(url) or sys.exit("no page")).body())
            page.wait_for_selector("html[data-ready]", state="attached")
            page.get_by_text("Length, seed, steps").click()
            page.locator("[name=seconds]").fill("4")
            first = press(page, TEXTS[0])
            others = [press(page, TEXTS[number % len(TEXTS)]) for number in range(repeats)]
            browser.close()
        finally:
            server.terminate()
    sketches = [stages["sketch seen after"] for stages in others if "sketch seen after" in stages]
    return {
        "page_bytes": page_bytes,
        "cpus": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "threads": threads,
        "first_ms": first,
        "sketch_ms": median_and_p95(sketches),
        "clip_ms": median_and_p95([stages["clip seen after"] for stages in others]),
        "repeats": others,
    }


def median_and_p95(values: list[float]) -> dict[str, float] | None:
    """Compute median and 95th percentile; None without values, as a bundle may have no sketches."""
    if not values:
        return None
    return {"count": len(values), "median": float(np.median(values)), "p95": float(np.percentile(values, 95))}


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "bundle", repeats=20)
    parser.add_argument("--threads", type=int, help="threads of a model")
    parser.add_argument("--out", type=Path, required=True, help="JSON file with every repeat")
    options = parser.parse_args()
    result = measure_waits(options.repeats, options.threads, options.bundle)
    write_json(options.out, result)
    print(f"page {result['page_bytes'] / 1e6:.2f} MB; milliseconds from Generate until seen:")
    for shown in ("sketch", "clip"):
        first, others = result["first_ms"].get(f"{shown} seen after"), result[f"{shown}_ms"]
        if others is not None:
            print(
                f"{shown}: first {first}, then {others['median']:.0f} (95 %: {others['p95']:.0f}, n={others['count']})"
            )


if __name__ == "__main__":
    main()
