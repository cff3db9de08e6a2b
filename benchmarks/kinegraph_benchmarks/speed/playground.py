"""Measure the waits in the playground, in a headless browser: the first moving person, a clip, and a drag.

    python -m kinegraph_benchmarks.speed.playground --out playground.json

- first clip: from opening the page until somebody is seen to move; each time in a new browser context, without a cache.
- clip: from Generate to the first sketch and to the clip; the first press on a new server is reported apart.
- drag: a waypoint of a clip of four seconds is dragged and let go; until the draft is drawn, and until the clip is.

The browser draws in software and shares the processors with the models, so this is the slowest case. Writes JSON only.

Needs the extras text, play and browser, and a chromium.
"""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Browser, Page, sync_playwright

from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.report_io import write_json

FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SIZE = {"width": 1280, "height": 800}
TEXTS = ("a person walks forward", "an old person walks slowly and turns left", "a person waves both hands")
MOVED = "performance.getEntriesByName('moved')[0]?.startTime ?? 0"
"""Milliseconds from opening the page until a person was seen to move."""
FAR = 60
"""Pixels by which a waypoint is dragged, to and fro."""
# of the page's camera (viewer/src/stage.js): distance and height of what it looks at in metres, angles in radians
DISTANCE, HEIGHT, DOWNWARDS, HALF_VIEW = 4.5, 1.02, math.pi / 2 - 1.36, math.radians(17)


@contextmanager
def playground(threads: int | None, bundle: str | Path | None) -> Iterator[tuple[str, Browser]]:
    """Start a server and a browser; yields the address and the browser."""
    command = [sys.executable, "-m", "kinegraph", "play", "--port", "0", "--no-browser"]
    command += [] if threads is None else ["--threads", str(threads)]
    command += [] if bundle is None else ["--bundle", str(bundle)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server, sync_playwright() as driver:
        try:
            assert server.stdout is not None
            url = server.stdout.readline().split(" ")[0]
            yield url, driver.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        finally:
            server.terminate()


def open_page(browser: Browser, url: str, **options: Any) -> Page:
    """Open the page in a new context and wait until it is ready."""
    page = browser.new_context(viewport=SIZE, **options).new_page()
    if page.goto(url) is None:
        raise SystemExit("no page")
    page.wait_for_selector("html[data-ready]", state="attached")
    return page


def first_clip(browser: Browser, url: str) -> float:
    """Open the page and wait until a person is seen to move; milliseconds."""
    page = open_page(browser, url)
    try:
        deadline = time.monotonic() + 60
        while not (moved := float(page.evaluate(MOVED))):
            if time.monotonic() > deadline:
                raise SystemExit("nobody moves")
            page.wait_for_timeout(50)
        return moved
    finally:
        page.context.close()


def made(page: Page) -> int:
    """Count the clips that the page has made."""
    return int(page.locator("html").get_attribute("data-made") or 0)


def wait_made(page: Page, count: int) -> None:
    """Wait until the page has made so many clips."""
    page.wait_for_selector(f"html[data-made='{count}']", state="attached", timeout=60_000)


def stages(page: Page) -> dict[str, float]:
    """Read the milliseconds of every stage of the last clip off the page."""
    names, values = (page.locator(f".stages {tag}").all_text_contents() for tag in ("dt", "dd"))
    return {name: float(value.removesuffix(" ms")) for name, value in zip(names, values, strict=True)}


def press(page: Page, text: str) -> dict[str, float]:
    """Generate one clip, and read its stages."""
    count = made(page) + 1
    page.get_by_label("What should the person do?").fill(text)
    page.get_by_role("button", name="Generate").click()
    wait_made(page, count)
    return stages(page)


def place_waypoint(page: Page) -> None:
    """Let a person walk four seconds, and add a waypoint where it is after two."""
    press(page, TEXTS[0])
    page.locator(".scrub").fill("2")
    count = made(page) + 1
    page.get_by_role("button", name="Waypoint").click()
    wait_made(page, count)


def drag(page: Page, far: float) -> dict[str, float]:
    """Drag the waypoint under the person in the middle of the stage, let it go at once, and read the stages."""
    box = page.locator("canvas").bounding_box()
    assert box is not None
    below = HEIGHT * math.cos(DOWNWARDS) / (DISTANCE + HEIGHT * math.sin(DOWNWARDS)) / math.tan(HALF_VIEW)
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] * (1 + below) / 2
    count = made(page) + 1
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + far, y, steps=5)
    page.mouse.up()
    wait_made(page, count)
    return stages(page)


def measure_waits(repeats: int, threads: int | None, bundle: str | Path | None) -> dict[str, Any]:
    """Measure all three cases on one server; milliseconds."""
    with playground(threads, bundle) as (url, browser):
        opened = [first_clip(browser, url) for _ in range(repeats)]
        page = open_page(browser, url, reduced_motion="reduce")
        page_bytes = int(page.evaluate("performance.getEntriesByType('navigation')[0].decodedBodySize"))
        page.get_by_text("Length, seed, steps").click()
        page.locator("[name=seconds]").fill("4")
        first = press(page, TEXTS[0])
        others = [press(page, TEXTS[number % len(TEXTS)]) for number in range(repeats)]
        drags = []
        if page.get_by_role("button", name="Waypoint").is_visible():  # else the bundle takes no constraints
            place_waypoint(page)
            drags = [drag(page, FAR if number % 2 else -FAR) for number in range(repeats)]
        browser.close()
    return {
        "page_bytes": page_bytes,
        "cpus": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "threads": threads,
        "opened_ms": median_and_p95(opened),
        "first_ms": first,
        "sketch_ms": median_and_p95(seen(others, "sketch")),
        "clip_ms": median_and_p95(seen(others, "clip")),
        "drag_draft_ms": median_and_p95(seen(drags, "draft")),
        "drag_clip_ms": median_and_p95(seen(drags, "clip")),
        "opened": opened,
        "repeats": others,
        "drags": drags,
    }


def seen(repeats: list[dict[str, float]], what: str) -> list[float]:
    """Collect when something was seen, where it was."""
    return [stage[f"{what} seen after"] for stage in repeats if f"{what} seen after" in stage]


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
    print(f"page {result['page_bytes'] / 1e6:.2f} MB; milliseconds, median (95 %):")
    for name, key in (
        ("opening the page until somebody moves", "opened_ms"),
        ("Generate until a sketch is seen", "sketch_ms"),
        ("Generate until the clip is seen", "clip_ms"),
        ("letting go of a waypoint until its draft is seen", "drag_draft_ms"),
        ("letting go of a waypoint until its clip is seen", "drag_clip_ms"),
    ):
        if (found := result[key]) is not None:
            print(f"{name}: {found['median']:.0f} ({found['p95']:.0f}), n={found['count']}")


if __name__ == "__main__":
    main()
