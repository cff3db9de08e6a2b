"""The page of integrations/three, served with three.js of npm, plays a VRM character that the service moved."""

from __future__ import annotations

import io
import os
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from kinegraph import MotionPipeline
from support.characters import BUILDS, make_character

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

PAGE = Path(__file__).resolve().parents[2] / "integrations" / "three" / "index.html"


class Site(SimpleHTTPRequestHandler):
    """Files of a folder, the page, and /v1 from the service."""

    service = 0

    def do_GET(self) -> None:
        if self.path.startswith("/index.html"):
            self._answer(200, PAGE.read_bytes(), "text/html")
        else:
            super().do_GET()

    def do_POST(self) -> None:
        data = self.rfile.read(int(self.headers["Content-Length"]))
        request = urllib.request.Request(
            f"http://127.0.0.1:{self.service}{self.path}", data, {"Content-Type": "application/json"}
        )
        try:
            with urllib.request.urlopen(request, timeout=60) as response:
                self._answer(200, response.read(), "model/gltf-binary")
        except urllib.error.HTTPError as error:
            self._answer(error.code, error.read(), "application/json")

    def _answer(self, status: int, body: bytes, kind: str) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@contextmanager
def running(folder: Path, toy: MotionPipeline, characters: Path) -> Iterator[str]:
    from kinegraph.playground.server import open_socket
    from kinegraph.service.app import Service
    from kinegraph.service.server import ServiceServer

    with open_socket(None, 0, None) as listener:
        port = listener.getsockname()[1]
        server = ServiceServer(Service(toy, characters), port)
        threads = [threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)]
        site = ThreadingHTTPServer(
            ("127.0.0.1", 0), partial(type("Here", (Site,), {"service": port}), directory=str(folder))
        )
        threads.append(threading.Thread(target=site.serve_forever, daemon=True))
        for thread in threads:
            thread.start()
        try:
            yield f"http://127.0.0.1:{site.server_address[1]}/index.html"
        finally:
            site.shutdown()
            site.server_close()
            server.should_exit = True
            for thread in threads:
                thread.join(20)


def seen(page: Page) -> np.ndarray:
    """Pixels of the page: (height, width, 3)."""
    image = pytest.importorskip("PIL.Image", reason="needs Pillow, of the extra plot")
    return np.asarray(image.open(io.BytesIO(page.screenshot())).convert("RGB")).astype(int)


def test_the_page_for_three_plays_a_vrm_character(browser: Browser, toy: MotionPipeline, tmp_path: Path) -> None:
    pytest.importorskip("starlette")
    folder = Path(os.environ.get("KINEGRAPH_NODE", ""))
    if not (folder / "node_modules" / "three").is_dir():
        pytest.skip("needs KINEGRAPH_NODE, a folder in which npm installed three")
    (tmp_path / "hero.vrm").write_bytes(make_character(BUILDS["VRM 1, long legs"]))
    with running(folder, toy, tmp_path) as url:
        page = browser.new_page(viewport={"width": 480, "height": 360})
        complaints: list[str] = []
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", lambda message: message.type == "error" and complaints.append(message.text))
        page.goto(f"{url}?character=hero.vrm")
        page.get_by_role("button", name="Make").wait_for()
        page.wait_for_timeout(300)
        empty = seen(page)
        with page.expect_response("**/v1/clips") as answer:
            page.get_by_role("button", name="Make").click()
        assert answer.value.status == 200
        page.wait_for_timeout(600)
        first = seen(page)
        page.wait_for_timeout(600)
        second = seen(page)
        drawn, moved = (np.abs(first - other).max(axis=-1) > 40 for other in (empty, second))
        assert drawn.mean() > 0.005, "nobody is seen"
        assert moved.mean() > 0.0005, "nobody moves"
        page.locator("[name=text]").fill("")
        page.get_by_role("button", name="Make").click()
        page.wait_for_function("document.querySelector('output').value !== ''")
        page.close()
    assert [text for text in complaints if "400" not in text and "favicon" not in text and "404" not in text] == []
