"""A real browser without a window, drawing in software: Debian's chromium, driven by playwright."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest

from support.browsing import Open

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

# Sandboxes need rights that a container's root has not; WebGL without a graphics card needs both of the others.
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    playwright = pytest.importorskip("playwright.sync_api", reason="needs the extra browser")
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("needs a browser: apt-get install chromium")
    with playwright.sync_playwright() as driver:
        found = driver.chromium.launch(executable_path=program, args=FLAGS)
        yield found
        found.close()


@pytest.fixture
def open_page(browser: Browser) -> Iterator[Open]:
    """Opens a page and waits until it is ready; at the end, no page may have complained or asked for anything else."""
    contexts = []
    complaints: list[str] = []

    def open_at(url: str, width: int = 640, height: int = 480, *, refused: bool = False, **options: Any) -> Page:
        # Nothing plays by itself, so that pictures of the same time are the same.
        options = {"reduced_motion": "reduce", **options}
        context = browser.new_context(viewport={"width": width, "height": height}, **options)
        contexts.append(context)
        page = context.new_page()
        own = url.split("#")[0]
        page.on("console", lambda message: heard(message.text, refused))
        page.on("pageerror", lambda error: complaints.append(f"error: {error}"))
        page.on(
            "request", lambda request: request.url.startswith((own, "data:", "blob:")) or complaints.append(request.url)
        )
        page.goto(url)
        page.wait_for_selector("html[data-ready]", state="attached", timeout=60_000)
        return page

    def heard(text: str, refused: bool) -> None:
        # what a browser says of every refused request, where one is to be refused
        if not (refused and "status of 400" in text):
            complaints.append(text)

    yield open_at
    for context in contexts:
        context.close()
    assert complaints == []
