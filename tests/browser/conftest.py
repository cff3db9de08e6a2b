"""Fixtures of a headless browser with software rendering: Debian's chromium, driven by playwright."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest

from support.browsing import Open

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

# The sandbox needs rights that root in a container lacks; WebGL without a graphics card needs the other two flags.
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    playwright = pytest.importorskip("playwright.sync_api", reason="needs the extra browser")
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("needs a browser: apt-get install chromium")
    with playwright.sync_playwright() as driver:
        try:
            chromium = driver.chromium.launch(executable_path=program, args=FLAGS)
        except playwright.Error as error:
            pytest.skip(f"{program} does not start: {str(error).splitlines()[0]}")
        yield chromium
        chromium.close()


@pytest.fixture
def open_page(browser: Browser) -> Iterator[Open]:
    """Open pages and wait until they are ready; no page may log an error or send a request elsewhere."""
    contexts = []
    complaints: list[str] = []

    def open_at(url: str, width: int = 640, height: int = 480, *, refused: bool = False, **options: Any) -> Page:
        # Nothing plays by itself, so that pictures of the same time are equal.
        options = {"reduced_motion": "reduce", **options}
        context = browser.new_context(viewport={"width": width, "height": height}, **options)
        contexts.append(context)
        page = context.new_page()
        address = url.split("#")[0]
        page.on("console", lambda message: heard(message.text, refused))
        page.on("pageerror", lambda error: complaints.append(f"error: {error}"))
        page.on(
            "request",
            lambda request: request.url.startswith((address, "data:", "blob:")) or complaints.append(request.url),
        )
        page.goto(url)
        page.wait_for_selector("html[data-ready]", state="attached", timeout=60_000)
        return page

    def heard(text: str, refused: bool) -> None:
        # the browser logs every refused request; here one is expected
        if not (refused and "status of 400" in text):
            complaints.append(text)

    yield open_at
    for context in contexts:
        context.close()
    assert complaints == []
