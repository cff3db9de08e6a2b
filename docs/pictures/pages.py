"""Make the pictures of the pages: play.jpg, timeline.jpg, phone.jpg and view.jpg.

    python docs/pictures/pages.py

Needs the extras text, play and browser, and a chromium.
"""

from __future__ import annotations

import json
import shutil
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from urllib.parse import urlencode

from playwright.sync_api import Browser, Page, sync_playwright

from kinegraph import MotionPipeline
from kinegraph.formats.html import clips_page
from kinegraph.playground.app import Playground
from kinegraph.playground.server import Server, listen, warm_up

HERE = Path(__file__).parent
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
TEXT = "a person walks forward while waving the right hand"
SCENE = ["a person walks forward", "a person walks while waving the right hand", "a person walks and stops"]
WHERE = [
    {"type": "path", "points": [[0, 0], [0.1, 1.6], [1.0, 2.7], [2.4, 2.9], [3.4, 2.2], [3.9, 1.1]]},
    {"type": "joint", "joint": "right_wrist", "position": [None, 1.75, None], "seconds": 4.5},
]
Author = Callable[[Page], None]


def make_takes(page: Page) -> None:
    """Ask for more takes, and wait for them."""
    page.get_by_role("button", name="More takes").click()
    page.locator(".take").nth(3).wait_for(timeout=300_000)
    page.wait_for_timeout(500)


def open_code(page: Page) -> None:
    """Scroll to the program for what is seen."""
    page.get_by_text("As a program").click()
    page.locator(".code pre").scroll_into_view_if_needed()


def take_picture(
    browser: Browser, url: str, name: str, size: tuple[int, int], scheme: str, at: float, author: Author | None = None
) -> None:
    """Take a picture of a page.

    Args:
        browser: a chromium.
        url: of the page.
        name: file to write.
        size: width and height of the window.
        scheme: "light" or "dark".
        at: time of the clip to show, in seconds.
        author: what is done on the page of the playground before the picture.
    """
    width, height = size
    context = browser.new_context(
        viewport={"width": width, "height": height}, color_scheme=scheme, reduced_motion="reduce"
    )
    page = context.new_page()
    page.goto(url)
    page.wait_for_selector("html[data-ready]", state="attached")
    if author is not None:
        page.wait_for_selector("html[data-made='1']", state="attached", timeout=300_000)  # the clip of the link
        author(page)
        if page.locator(".sampling").get_attribute("open") is not None:
            page.locator(".sampling summary").click()  # close the settings, which the link has opened
    page.locator(".scrub").fill(str(at))
    page.locator("h1").click()
    page.wait_for_timeout(1000)
    page.screenshot(path=HERE / name, type="jpeg", quality=82)
    context.close()


def main() -> None:
    """Serve a playground, and take all pictures."""
    pipe = MotionPipeline.load()
    warm_up(pipe)
    with tempfile.TemporaryDirectory() as folder, listen(0) as listener, sync_playwright() as driver:
        port = listener.getsockname()[1]
        server = Server(Playground(pipe), port)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        link = f"http://127.0.0.1:{port}/#{urlencode({'text': TEXT, 'seconds': 4, 'seed': 4})}"
        take_picture(browser, link, "play.jpg", (1280, 800), "light", 2.0, make_takes)
        take_picture(browser, link, "phone.jpg", (390, 844), "light", 2.0, lambda page: None)
        scene = {"texts": json.dumps(SCENE), "seconds": "3,3,3", "seed": 7, "constraints": json.dumps(WHERE)}
        take_picture(
            browser, f"http://127.0.0.1:{port}/#{urlencode(scene)}", "timeline.jpg", (1280, 800), "dark", 4.5, open_code
        )
        turns = ("a person walks and turns to the left", "a person walks and turns to the right")
        clips = [pipe.generate(text, seconds=4, seed=6) for text in turns]
        file = Path(folder) / "view.html"
        file.write_bytes(clips_page(clips))
        take_picture(browser, file.as_uri(), "view.jpg", (1080, 620), "dark", 3.2)
        browser.close()
        server.should_exit = True
        thread.join()


if __name__ == "__main__":
    main()
