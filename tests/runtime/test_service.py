"""`kinegraph serve` over HTTP: what it answers, whom it refuses, and that its clips are those of the command line."""

from __future__ import annotations

import base64
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph import MotionPipeline
from kinegraph.errors import InvalidInputError, OutputError
from kinegraph.formats import encode
from support.characters import BUILDS, make_character
from support.cli_runs import fails
from support.playground import PlaygroundClient

pytest.importorskip("spacy")
pytest.importorskip("starlette")
pytest.importorskip("uvicorn")

from kinegraph.playground.server import open_socket
from kinegraph.service.server import ServiceServer

REQUEST = {"text": "a person walks slowly to the left", "seconds": 2, "seed": 7, "steps": 3}
TOKEN = "0123456789abcdef0123"


@contextmanager
def running(pipeline: MotionPipeline, token: str | None = None, characters: Path | None = None) -> Iterator[Any]:
    """Run a service until the end of the block, and give a client of it and the service."""
    from kinegraph.service.app import Service

    service = Service(pipeline, characters)
    with open_socket(None if token is None else "127.0.0.1", 0, token) as listener:
        port = listener.getsockname()[1]
        server = ServiceServer(service, port, token)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
        thread.start()
        deadline = time.monotonic() + 20
        while not server.started:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        try:
            yield PlaygroundClient(port), service
        finally:
            server.should_exit = True
            thread.join(20)
            assert not thread.is_alive()


@pytest.fixture(scope="module")
def served(toy: MotionPipeline, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    folder = tmp_path_factory.mktemp("characters")
    (folder / "hero.glb").write_bytes(make_character(BUILDS["Mixamo, T-pose, centimetres"]))
    (folder / "notes.txt").write_text("no character")
    with running(toy, characters=folder) as both:
        yield both


def events_of(client: PlaygroundClient, request: object) -> list[tuple[str, dict[str, Any]]]:
    return list(stream(client, request))


def stream(client: PlaygroundClient, request: object) -> Iterator[tuple[str, dict[str, Any]]]:
    headers = {"Content-Type": "application/json", "Accept": "text/event-stream"}
    asked = urllib.request.Request(f"{client.url}v1/clips", json.dumps(request).encode(), headers)
    with urllib.request.urlopen(asked, timeout=60) as response:
        assert response.headers["content-type"].startswith("text/event-stream")
        kind = ""
        for line in response:
            if line.startswith(b"event: "):
                kind = line[7:].decode().strip()
            elif line.startswith(b"data: "):
                yield kind, json.loads(line[6:])


def test_a_clip_comes_as_the_file_that_save_writes(served: Any, toy: MotionPipeline) -> None:
    client, _ = served
    clip = toy.generate(REQUEST["text"], seconds=2, seed=7, steps=3)
    for suffix in (".glb", ".bvh", ".npz", ".json", ".vrma"):
        response = client.post("/v1/clips", {**REQUEST, "format": suffix[1:]})
        assert response.status == 200, response.body
        assert response.body == encode(clip, suffix)
        assert response.headers["kinegraph-seed"] == "7" and response.headers["kinegraph-fps"] == "20.0"
    changed = client.post("/v1/clips", {**REQUEST, "format": "bvh", "fps": 30, "in_place": True, "root": True})
    assert changed.body == encode(clip.in_place().resampled(30), ".bvh", root=True)


def test_concepts_sequences_and_characters_are_taken(served: Any, toy: MotionPipeline) -> None:
    client, _ = served
    concepts = [{"text": "a person walks"}, {"text": "a person waves", "weight": 0.5}]
    response = client.post("/v1/clips", {"concepts": concepts, "seconds": 2, "seed": 1, "steps": 2, "format": "npz"})
    assert response.status == 200, response.body
    texts = ["a person walks", "a person bows"]
    response = client.post("/v1/clips", {"texts": texts, "seconds": [2, 2], "seed": 1, "steps": 2, "format": "npz"})
    assert response.body == encode(toy.sequence(texts, seconds=[2, 2], seed=1, steps=2), ".npz")
    response = client.post("/v1/clips", {**REQUEST, "character": "hero.glb"})
    assert response.status == 200 and response.headers["kinegraph-fps"] == "30.0"
    assert b"mixamorig" in response.body
    graph = toy.parse(str(REQUEST["text"])).to_dict()
    assert client.post("/v1/clips", {"graph": graph, "seconds": 2, "seed": 7, "steps": 3}).status == 200


@pytest.mark.parametrize(
    ("request_", "problem"),
    [
        ({}, "text"),
        ({"text": ""}, "caption|blank|empty|text"),
        ({**REQUEST, "format": "fbx"}, "format must be one of glb, bvh"),
        ({**REQUEST, "format": ["glb"]}, "format must be"),
        ({**REQUEST, "colour": "red"}, "colour"),
        ({**REQUEST, "seconds": 1e9}, "seconds"),
        ({**REQUEST, "root": 1}, "root must be true or false"),
        ({**REQUEST, "root": True, "format": "npz"}, "a root joint is for"),
        ({**REQUEST, "fps": 0}, "fps must be"),
        ({**REQUEST, "names": "maya"}, "joint names"),
        ({**REQUEST, "names": 3}, "names must be text"),
        ({**REQUEST, "character": "../hero.glb"}, "there is no character"),
        ({**REQUEST, "character": "hero.glb", "names": "mixamo"}, "leave out names"),
        ({**REQUEST, "character": "notes.txt"}, "there are hero.glb"),
        ({**REQUEST, "character": "hero.glb", "format": "bvh"}, "is a .glb"),
        ({"texts": []}, "list of sentences"),
        ({"texts": ["a person walks"], "graph": {}}, "is not for a sequence"),
        ({"texts": ["a person walks"] * 300}, "sentences"),
        ([], "object"),
    ],
)
def test_bad_requests_are_refused_with_a_sentence(served: Any, request_: Any, problem: str) -> None:
    import re

    response = served[0].post("/v1/clips", request_)
    assert response.status == 400, response.body
    assert re.search(problem, response.json["error"]), response.json


def test_progress_comes_as_events_and_ends_with_the_clip(served: Any, toy: MotionPipeline) -> None:
    events = events_of(served[0], REQUEST)
    assert events[0][0] == "queued" and events[-1][0] == "clip"
    assert {kind for kind, _ in events[1:-1]} == {"step"}
    last = events[-1][1]
    clip = toy.generate(REQUEST["text"], seconds=2, seed=7, steps=3)
    assert base64.b64decode(last["data"]) == encode(clip, ".glb") and last["seed"] == 7
    (only,) = (value for kind, value in events_of(served[0], {**REQUEST, "steps": 10**6}) if kind == "error")
    assert only["status"] == 400 and "steps" in only["error"]


def test_a_streamed_clip_can_be_cancelled(served: Any) -> None:
    client, service = served
    before = service.times.counts["cancelled"]
    long = {**REQUEST, "seconds": 4, "steps": 200}
    found = []
    for kind, value in stream(client, long):
        found.append(kind)
        if kind == "queued":
            clip = value["id"]
        elif kind == "step" and found.count("step") == 1:
            assert client.send("DELETE", f"/v1/clips/{clip}").status == 204
    assert found[-1] == "error" and "clip" not in found
    assert client.send("DELETE", f"/v1/clips/{clip}").status == 404
    deadline = time.monotonic() + 10
    while service.times.counts["cancelled"] == before and time.monotonic() < deadline:
        time.sleep(0.02)
    assert service.times.counts["cancelled"] == before + 1


def test_words_health_metrics_and_the_description_are_there(served: Any, toy: MotionPipeline) -> None:
    client, _ = served
    client.post("/v1/clips", REQUEST)
    assert client.send("GET", "/v1/health").json["status"] == "ok"
    words = client.send("GET", "/v1/words").json
    assert words["name"] == toy.manifest.name and isinstance(words["actions"], list)
    metrics = client.send("GET", "/v1/metrics").body.decode()
    assert 'kinegraph_stage_seconds{stage="generate",quantile="0.95"}' in metrics
    description = client.send("GET", "/v1/openapi.json").json
    properties = description["paths"]["/v1/clips"]["post"]["requestBody"]["content"]["application/json"]["schema"]
    from kinegraph.playground import schemas
    from kinegraph.service import requests

    known = {
        *requests._FILE_KEYS,
        *schemas._SHAPE_KEYS,
        *schemas._CONSTRAINT_KEYS,
        *schemas._SEQUENCE_KEYS,
        *schemas._COMPOSITION_KEYS,
        *schemas._SAMPLING_KEYS,
    }
    assert properties["properties"].keys() == known | {"text", "graph", "concepts", "texts"}
    page = client.send("GET", "/v1/docs")
    assert b"/v1/clips" in page.body and "default-src 'none'" in page.headers["content-security-policy"]
    assert client.send("GET", "/v1/nothing").status == 404
    assert client.send("GET", "/v1/clips").status == 405


def test_pages_of_other_sites_and_other_names_are_refused(served: Any) -> None:
    client, _ = served
    body = json.dumps(REQUEST).encode()
    refused = client.send("POST", "/v1/clips", body, content_type="application/json", origin="http://evil.example")
    assert refused.status == 403
    assert client.send("GET", "/v1/words", Host="evil.example").status == 421
    assert client.send("POST", "/v1/clips", body, content_type="text/plain").status == 415


def test_with_a_token_nobody_else_is_answered(toy: MotionPipeline) -> None:
    with running(toy, TOKEN) as (client, _):
        assert client.send("GET", "/v1/health").status == 200
        for headers in ({}, {"authorization": "Bearer wrong"}, {"authorization": TOKEN}):
            response = client.send("GET", "/v1/words", **headers)
            assert response.status == 401 and response.headers["www-authenticate"] == "Bearer"
        right = {"authorization": f"Bearer {TOKEN}"}
        assert client.send("GET", "/v1/words", **right).status == 200
        assert client.send("GET", "/v1/words", **right, Host="box.example").status == 200
        assert client.send("GET", "/v1/words", **right, origin="http://box.example").status == 403


def test_the_queue_is_bounded(toy: MotionPipeline) -> None:
    with running(toy) as (client, service):
        long = {**REQUEST, "steps": 300, "seconds": 4}
        streams = [stream(client, long) for _ in range(5)]
        for each in streams:
            assert next(each)[0] == "queued"
        deadline = time.monotonic() + 10
        while len(service._queue) < 4 and time.monotonic() < deadline:
            time.sleep(0.02)
        response = client.post("/v1/clips", REQUEST)
        assert response.status == 503 and response.headers["retry-after"] == "2"
        for each in streams:
            each.close()


def test_addresses_that_cannot_be_used_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InvalidInputError, match="give them a --token"):
        open_socket("0.0.0.0", 0, None)
    with pytest.raises(InvalidInputError, match="16 or more"):
        open_socket(None, 0, "short")
    with pytest.raises(InvalidInputError, match="port must be"):
        open_socket("127.0.0.1", 70000, TOKEN)
    with pytest.raises(OutputError, match="cannot be used"):
        open_socket("203.0.113.7", 0, TOKEN)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert "cannot be used" in fails(capsys, "serve", "--port", port)
        assert "cannot be used" in fails(capsys, "serve", "--port", port, "--host", "127.0.0.1", "--token", TOKEN)
    assert "--token" in fails(capsys, "serve", "--host", "127.0.0.1")
    assert "there is no folder" in fails(capsys, "serve", "--characters", "/nowhere")


def test_the_command_serves_and_prints_its_times_at_the_end(toy_bundle: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "kinegraph", "serve", "--port", "0", "--bundle", str(toy_bundle)]
    environment = {**os.environ, "KINEGRAPH_TOKEN": TOKEN}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
    assert process.stdout is not None
    url = process.stdout.readline().split()[0].removesuffix("v1/docs")
    headers = {"Content-Type": "application/json", "Authorization": f"Bearer {TOKEN}"}
    asked = urllib.request.Request(f"{url}v1/clips", json.dumps(REQUEST).encode(), headers)
    with urllib.request.urlopen(asked, timeout=60) as response:
        assert response.read()[:4] == b"glTF"
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
    assert "1 made" in out and "p50 / p95: queue" in out and err == ""


def test_a_clip_costs_hardly_more_than_in_process(served: Any, toy: MotionPipeline, figure: Any) -> None:
    client, _ = served
    request = {**REQUEST, "format": "npz"}
    apart = []
    for _ in range(12):
        start = time.perf_counter()
        encode(toy.generate(REQUEST["text"], seconds=2, seed=7, steps=3), ".npz")
        middle = time.perf_counter()
        assert client.post("/v1/clips", request).status == 200
        apart.append(time.perf_counter() - middle - (middle - start))
    figure(f"a clip by the service takes {1000 * float(np.median(apart)):.1f} ms more than in process")
