"""The pictures of the pages: `python docs/pictures/pages.py`; needs the extras text, play, browser, and a chromium."""

from __future__ import annotations

import shutil
import tempfile
import threading
from pathlib import Path
from urllib.parse import urlencode

from playwright.sync_api import Browser, sync_playwright

from kinegraph import MotionPipeline
from kinegraph.formats.html import clips_page as page_of
from kinegraph.playground.app import Playground
from kinegraph.playground.server import Server, listen, warm_up

HERE = Path(__file__).parent
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
TEXT = "a person walks forward while waving the right hand"


def picture(browser: Browser, url: str, name: str, size: tuple[int, int], scheme: str, at: float, made: bool) -> None:
    """One picture of a page, which first makes the clip of its link where it is to be `made`."""
    width, height = size
    context = browser.new_context(
        viewport={"width": width, "height": height}, color_scheme=scheme, reduced_motion="reduce"
    )
    page = context.new_page()
    page.goto(url)
    page.wait_for_selector("html[data-ready]", state="attached")
    if made:
        for press in (1, 2):  # the first also prepares what draws
            page.get_by_role("button", name="Generate").click()
            page.wait_for_selector(f"html[data-made='{press}']", state="attached")
        page.locator(".sampling summary").click()  # the settings, which the link has opened
    page.locator(".scrub").fill(str(at))
    page.locator("h1").click()
    page.wait_for_timeout(1000)
    page.screenshot(path=HERE / name, type="jpeg", quality=82)
    context.close()


def main() -> None:
    pipe = MotionPipeline.load()
    warm_up(pipe)
    with tempfile.TemporaryDirectory() as folder, listen(0) as listener, sync_playwright() as driver:
        port = listener.getsockname()[1]
        server = Server(Playground(pipe), port)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        link = f"http://127.0.0.1:{port}/#{urlencode({'text': TEXT, 'seconds': 4, 'seed': 4})}"
        picture(browser, link, "play.jpg", (1280, 800), "light", 2.0, made=True)
        picture(browser, link, "phone.jpg", (390, 844), "light", 2.0, made=True)
        turns = ("a person walks and turns to the left", "a person walks and turns to the right")
        clips = [pipe.generate(text, seconds=4, seed=6) for text in turns]
        file = Path(folder) / "view.html"
        file.write_bytes(page_of(clips))
        picture(browser, file.as_uri(), "view.jpg", (1080, 620), "dark", 3.2, made=False)
        browser.close()
        server.should_exit = True
        thread.join()


if __name__ == "__main__":
    main()
