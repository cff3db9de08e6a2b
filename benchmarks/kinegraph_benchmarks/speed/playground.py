"""How long one waits for the playground: from Generate to the first sketch and to the clip, in a headless browser.

    python -m kinegraph_benchmarks.speed.playground --out playground.json

The browser draws in software and shares the processors with the models, so this is the slow end. The first press of a
new server is told apart from the others. Needs the extras text, play and browser, and a chromium.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Page, sync_playwright

FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
TEXTS = ("a person walks forward", "an old person walks slowly and turns left", "a person waves both hands")


def press(page: Page, text: str) -> dict[str, float]:
    """Milliseconds of every stage of one clip of four seconds, as the page tells them."""
    made = int(page.locator("html").get_attribute("data-made") or 0) + 1
    page.get_by_label("What should the person do?").fill(text)
    page.get_by_role("button", name="Generate").click()
    page.wait_for_selector(f"html[data-made='{made}']", state="attached", timeout=60_000)
    names, values = (page.locator(f".stages {tag}").all_text_contents() for tag in ("dt", "dd"))
    return {name: float(value.removesuffix(" ms")) for name, value in zip(names, values, strict=True)}


def measured(repeats: int, threads: int | None, bundle: Path | None) -> dict[str, Any]:
    """The first press and all others, of one server and one page."""
    words = [sys.executable, "-m", "kinegraph", "play", "--port", "0", "--no-browser"]
    words += [] if threads is None else ["--threads", str(threads)]
    words += [] if bundle is None else ["--bundle", str(bundle)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as server, sync_playwright() as driver:
        try:
            assert server.stdout is not None
            url = server.stdout.readline().split(" ")[0]
            browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
            page = browser.new_page(viewport={"width": 1280, "height": 800}, reduced_motion="reduce")
            page_bytes = len((page.goto(f"{url}#seconds=4&text=.") or sys.exit("no page")).body())
            page.wait_for_selector("html[data-ready]", state="attached")
            first = press(page, TEXTS[0])
            others = [press(page, TEXTS[number % len(TEXTS)]) for number in range(repeats)]
            browser.close()
        finally:
            server.terminate()
    return {
        "page_bytes": page_bytes,
        "cpus": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "threads": threads,
        "first_ms": first,
        "sketch_ms": spread([each["sketch seen after"] for each in others if "sketch seen after" in each]),
        "clip_ms": spread([each["clip seen after"] for each in others]),
        "repeats": others,
    }


def spread(values: list[float]) -> dict[str, float] | None:
    """Median and 95 % of milliseconds; None where there are none: a bundle may have no sketches."""
    if not values:
        return None
    return {"count": len(values), "median": float(np.median(values)), "p95": float(np.percentile(values, 95))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="JSON with every repeat")
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--bundle", type=Path)
    arguments = parser.parse_args()
    found = measured(arguments.repeats, arguments.threads, arguments.bundle)
    arguments.out.write_text(json.dumps(found, indent=1), encoding="utf-8")
    print(f"page {found['page_bytes'] / 1e6:.2f} MB; milliseconds from Generate until seen:")
    for what in ("sketch", "clip"):
        first, others = found["first_ms"].get(f"{what} seen after"), found[f"{what}_ms"]
        if others is not None:
            print(
                f"{what}: first {first}, then {others['median']:.0f} (95 %: {others['p95']:.0f}, n={others['count']})"
            )


if __name__ == "__main__":
    main()
