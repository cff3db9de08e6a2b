"""What the tests of pages share: waiting, and looking at what is drawn."""

from __future__ import annotations

import io
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Page

Open = Callable[..., "Page"]
"""The fixture `open_page`: an address, a width, a height, and options of the browser's context -> the page."""


def wait_until(page: Page, holds: Callable[[], bool], seconds: float = 30) -> None:
    """The page's policy forbids strings that become scripts, and with them playwright's own way of waiting."""
    deadline = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < deadline, page.locator("body").inner_text()
        page.wait_for_timeout(30)


def time_of(page: Page) -> float:
    """The time of the clip that is drawn, seconds."""
    return float(page.locator("canvas").get_attribute("data-time") or "nan")


def shown(page: Page, seconds: float) -> bytes:
    """The drawing at a time of the clip, as PNG."""
    page.locator(".scrub").fill(str(seconds))
    wait_until(page, lambda: abs(time_of(page) - seconds) < 0.026)
    page.wait_for_timeout(100)
    return page.locator("canvas").screenshot()


def changed(one: bytes, other: bytes) -> float:
    """Share of pixels that differ clearly between two pictures of the same size."""
    image = pytest.importorskip("PIL.Image")
    first, second = (np.asarray(image.open(io.BytesIO(data)).convert("RGB"), dtype=int) for data in (one, other))
    return float((np.abs(first - second).max(axis=-1) > 24).mean())
