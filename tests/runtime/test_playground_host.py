"""`kinegraph play --host`: other devices get in with the token of a link, which a QR code holds."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import kinegraph
from kinegraph import MotionPipeline
from support.cli_runs import fails
from support.playground import PlaygroundClient

pytest.importorskip("spacy")
pytest.importorskip("uvicorn")
segno = pytest.importorskip("segno")

from kinegraph.cli.pages import qr_code
from kinegraph.playground.app import Playground
from kinegraph.playground.server import Server, listen_at, reachable_address

TOKEN = "0123456789abcdef"
BODY = json.dumps({"text": "a person walks"}).encode()


@pytest.fixture(scope="module")
def hosted(toy: MotionPipeline) -> Iterator[PlaygroundClient]:
    listener, token = listen_at("127.0.0.1", 0, TOKEN)
    with listener:
        port = listener.getsockname()[1]
        server = Server(Playground(toy), port, token=token)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
        thread.start()
        while not server.started:
            time.sleep(0.01)
        yield PlaygroundClient(port)
        server.should_exit = True
        thread.join(20)


def test_calls_need_the_token_and_the_page_does_not(hosted: PlaygroundClient) -> None:
    page = hosted.send("GET", "/", Host="192.168.1.7:8420")
    assert page.status == 200 and TOKEN.encode() not in page.body
    for authorization, status in (
        (None, 401), ("Bearer", 401), (f"Bearer {TOKEN}x", 401), (f"Basic {TOKEN}", 401), (f"Bearer {TOKEN}", 200),
    ):  # fmt: skip
        headers = {} if authorization is None else {"authorization": authorization}
        response = hosted.send("POST", "/api/parse", BODY, content_type="application/json", **headers)
        assert response.status == status, (authorization, response)
        assert response.headers["x-frame-options"] == "DENY"
    assert "scan the code" in hosted.post("/api/clip", {}).json["error"]


def test_with_the_token_other_pages_still_stay_outside(hosted: PlaygroundClient) -> None:
    known = {"authorization": f"Bearer {TOKEN}", "content_type": "application/json"}
    for headers in ({"origin": "http://evil.example"}, {"sec_fetch_site": "cross-site"}):
        assert hosted.send("POST", "/api/parse", BODY, **known, **headers).status == 403
    assert hosted.send("POST", "/api/parse", BODY, **{**known, "content_type": "text/plain"}).status == 415


def test_a_token_is_drawn_where_none_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("KINEGRAPH_TOKEN", raising=False)
    drawn = set()
    for _ in range(3):
        listener, token = listen_at("127.0.0.1", 0, None)
        listener.close()
        assert token is not None and len(token) >= 16
        drawn.add(token)
    assert len(drawn) == 3
    monkeypatch.setenv("KINEGRAPH_TOKEN", TOKEN)
    listener, token = listen_at("127.0.0.1", 0, None)
    listener.close()
    assert token == TOKEN
    listener, token = listen_at(None, 0, None)  # this machine alone needs none
    listener.close()
    assert token is None


def test_the_code_holds_the_link() -> None:
    url = f"http://192.168.1.23:8420/#token={TOKEN}"
    rows = qr_code(url).split("\n")
    matrix = [list(row) for row in segno.make(url, error="l", micro=False).matrix_iter(border=2)]
    blocks = {(0, 0): "█", (0, 1): "▀", (1, 0): "▄", (1, 1): " "}
    for index, line in enumerate(rows[: len(matrix) // 2]):
        upper, lower = matrix[2 * index], matrix[2 * index + 1]
        assert [blocks[pair] for pair in zip(upper, lower, strict=True)] == list(line)
    assert max(map(len, rows)) <= 60


def test_addresses_that_cannot_be_used_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert reachable_address("192.168.1.7") == "192.168.1.7" and reachable_address("0.0.0.0") != "0.0.0.0"
    assert "the token must have" in fails(capsys, "play", "--host", "127.0.0.1", "--token", "short", "--no-browser")
    assert "cannot be used" in fails(capsys, "play", "--host", "203.0.113.7", "--no-browser")


def test_the_command_prints_the_code_and_the_link(toy_bundle: Path) -> None:
    command = [sys.executable, "-m", "kinegraph", "play", "--host", "127.0.0.1", "--port", "0", "--no-browser"]
    environment = {**os.environ, "PYTHONPATH": str(Path(kinegraph.__file__).parents[1]), "KINEGRAPH_TOKEN": TOKEN}
    with subprocess.Popen(
        [*command, "--bundle", str(toy_bundle)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=environment, encoding="utf-8",
    ) as process:  # fmt: skip
        assert process.stdout is not None
        lines = []
        while not lines or "Ctrl+C" not in lines[-1]:
            lines.append(process.stdout.readline())
            assert lines[-1], process.stderr and process.stderr.read()
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
    assert lines[-1].startswith("http://127.0.0.1:") and lines[-1].split()[0].endswith(f"/#token={TOKEN}")
    assert len(lines) > 15 and set("".join(lines[:-1])) <= set("█▀▄ \n")
