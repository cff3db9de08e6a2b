"""Helpers of browser tests: waiting, comparing pictures, and using the playground."""

from __future__ import annotations

import io
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Page

Open = Callable[..., "Page"]
"""The fixture `open_page`: address, width, height and options of the browser context -> page."""

TEXT = "a person walks forward and turns to the left"


def wait_until(page: Page, holds: Callable[[], bool], seconds: float = 30) -> None:
    """Wait for a condition. Playwright's own way evaluates strings as scripts, which the page's policy forbids."""
    deadline = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < deadline, page.locator("body").inner_text()
        page.wait_for_timeout(30)


def time_of(page: Page) -> float:
    """Return the time of the clip that is drawn, seconds."""
    return float(page.locator("canvas").get_attribute("data-time") or "nan")


def picture_at(page: Page, seconds: float) -> bytes:
    """Seek to a time of the clip and return the drawing as PNG."""
    page.locator(".scrub").fill(str(seconds))
    wait_until(page, lambda: abs(time_of(page) - seconds) < 0.026)
    page.wait_for_timeout(100)
    return page.locator("canvas").screenshot()


def changed(before: bytes, after: bytes) -> float:
    """Return the share of pixels that differ clearly between two pictures of the same size."""
    image = pytest.importorskip("PIL.Image")
    first, second = (np.asarray(image.open(io.BytesIO(data)).convert("RGB"), dtype=int) for data in (before, after))
    return float((np.abs(first - second).max(axis=-1) > 24).mean())


def settings(page: Page, **values: str) -> None:
    """Fill in length, seed, guidance and steps."""
    if not page.locator(".sampling [name=seconds]").is_visible():
        page.get_by_text("Length, seed, steps").click()
    for name, value in values.items():
        page.locator(f".sampling [name={name}]").fill(value)


def clips_shown(page: Page) -> int:
    """Count the clips that the page has made and shown."""
    return int(page.locator("html").get_attribute("data-made") or 0)


def shows(page: Page) -> int:
    """Count the clips that the page has shown, also those that it had already."""
    return int(page.locator("html").get_attribute("data-shown") or 0)


def generate(page: Page, text: str = TEXT, **values: str) -> None:
    """Ask for a clip and wait until it is there."""
    before = clips_shown(page)
    page.get_by_label("What should the person do?").fill(text)
    settings(page, **values)
    page.get_by_role("button", name="Generate").click()
    wait_until(page, lambda: clips_shown(page) > before)


def download(page: Page, suffix: str, name: str | None = None) -> bytes:
    """Fetch the file of a format; `name` is what it must be called."""
    with page.expect_download(timeout=60_000) as waiting:
        page.locator(f"[data-suffix='{suffix}']").click()
    pattern = rf"\w+_\d+{re.escape(suffix)}" if name is None else re.escape(name)  # words and seed
    assert re.fullmatch(pattern, waiting.value.suggested_filename), waiting.value.suggested_filename
    return Path(waiting.value.path()).read_bytes()
