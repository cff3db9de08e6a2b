"""`kinegraph play` over HTTP: its answers equal the command line's, and generation stops on request."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import kinegraph
from kinegraph import MotionPipeline, cli
from kinegraph.errors import Cancelled
from kinegraph.formats import encode
from kinegraph.layers import Layer
from kinegraph.timeline import generate_timeline
from support.characters import BUILDS, make_character
from support.cli_runs import fails
from support.playground import REQUEST, TEXT, PlaygroundClient, running_playground

pytest.importorskip("spacy")
pytest.importorskip("starlette")
pytest.importorskip("uvicorn")

from kinegraph.playground import jobs
from kinegraph.playground.app import Playground, application
from kinegraph.playground.fair_queue import MAX_PER_TAB
from kinegraph.playground.guards import UNEXPECTED, ServerLimits

RUNTIME = Path(kinegraph.__file__).resolve().parents[1]
LONG = {**REQUEST, "seconds": 9.8, "steps": 900}
"""A request that takes ten seconds or more."""


def test_a_clip_comes_with_its_graph_its_steps_and_the_time_of_each_stage(
    server: PlaygroundClient, pipe: MotionPipeline
) -> None:
    events = server.clip(REQUEST)
    kinds = [event["event"] for event in events]
    assert kinds[:2] == ["queued", "graph"] and kinds[-1] == "clip" and {*kinds[2:-1]} == {"step", "level"}
    previews = [(index, event["level"]) for index, event in enumerate(events) if event["event"] == "level"]
    assert [level for _, level in previews] == ["motion", "action"]
    assert all(kinds[index - 1] == kinds[index + 1] == "step" for index, _ in previews)  # between two levels
    assert events[1]["graph"] == pipe.parse(TEXT).to_dict()
    assert [(event["level"], event["done"]) for event in events if event.get("step") == 3] == [
        ("motion", 3), ("action", 6), ("specific", 9),
    ]  # fmt: skip
    clip, stages = events[-1]["clip"], events[-1]["stages"]
    assert (clip["text"], clip["seed"], clip["frames"]) == (TEXT, "7", 40)
    assert list(stages) == ["parser", "text and motion", "previews", "action", "specific", "decoder, feet", "body"]
    assert all(milliseconds > 0 for milliseconds in stages.values())


FLAGS = ["--seconds", "2", "--seed", "7", "--steps", "3", "--threads", "1", "--quiet"]


@pytest.mark.parametrize(
    ("suffix", "names"), [(".bvh", "smpl"), (".bvh", "mixamo"), (".glb", "mixamo"), (".npz", "smpl"), (".html", "smpl")]
)
def test_files_are_those_of_the_command_line(server: PlaygroundClient, here: Path, suffix: str, names: str) -> None:
    response = server.post("/api/file", {"wish": REQUEST, "suffix": suffix, "names": names})
    assert cli.main(["generate", TEXT, *FLAGS, "--names", names, "-o", f"walk{suffix}"]) == 0
    assert response.status == 200 and response.body == (here / f"walk{suffix}").read_bytes()


def test_an_edited_graph_gives_the_clip_of_the_edits(server: PlaygroundClient, here: Path) -> None:
    graph = server.post("/api/parse", {"text": TEXT}).json
    graph = server.post("/api/edit", {"graph": graph, "edit": {"kind": "drop", "node": 3}}).json
    assert graph["caption"] == "a person walks to the left"
    graph["actions"][0]["arguments"][-1]["weight"] = 0.25
    response = server.post("/api/file", {"wish": {**REQUEST, "text": TEXT, "graph": graph}, "suffix": ".npz"})
    edits = ["--drop", "slowly", "--weight", "to the left=0.25"]
    assert cli.main(["generate", TEXT, *FLAGS, *edits, "-o", "walk.npz"]) == 0
    assert response.body == (here / "walk.npz").read_bytes()
    assert response.body != server.post("/api/file", {"wish": REQUEST, "suffix": ".npz"}).body


def test_concepts_give_the_clip_of_compose(server: PlaygroundClient, here: Path) -> None:
    concepts = [{"text": "a person walks"}, {"text": "a person runs", "weight": -0.5}]
    request = {"concepts": concepts, "method": "latent", "seed": str(2**62 + 1), "seconds": "2", "steps": "3"}
    response = server.post("/api/file", {"wish": request, "suffix": ".npz"})
    flags = [*FLAGS, "--seed", str(2**62 + 1), "--method", "latent"]
    assert cli.main(["compose", "--and", "a person walks", "--not", "a person runs:0.5", *flags, "-o", "x.npz"]) == 0
    assert response.body == (here / "x.npz").read_bytes()


@pytest.mark.parametrize(
    ("changes", "flags"),
    [
        ({"lambdas": "0.1,0.7,0.2"}, ["--lambdas", "0.1,0.7,0.2"]),
        ({"lambdas": [0.1, 0.7, 0.2]}, ["--lambdas", "0.1,0.7,0.2"]),
        ({"agd": "0.2,0.1"}, ["--agd", "0.2,0.1"]),
        ({"agd": [0.2, 0.1], "method": "semantic"}, ["--agd", "0.2,0.1", "--method", "semantic"]),
        ({"text": "a person walks while waving"}, ["--text", "a person walks while waving"]),
    ],
)
def test_how_concepts_are_mixed_is_that_of_compose(
    server: PlaygroundClient, here: Path, changes: dict[str, Any], flags: list[str]
) -> None:
    request = {
        "concepts": [{"text": "a person walks"}, {"text": "a person waves"}],
        "seed": 7,
        "seconds": 2,
        "steps": 3,
    }
    response = server.post("/api/file", {"wish": {**request, **changes}, "suffix": ".npz"})
    words = ["--and", "a person walks", "--and", "a person waves"]
    assert cli.main(["compose", *words, *FLAGS, *flags, "-o", "x.npz"]) == 0
    assert response.body == (here / "x.npz").read_bytes()
    assert response.body != server.post("/api/file", {"wish": request, "suffix": ".npz"}).body


def test_a_sequence_and_its_shape_are_those_of_the_pipeline(server: PlaygroundClient, pipe: MotionPipeline) -> None:
    graph = pipe.parse("a person bows slowly")
    texts = ["a person walks", graph.to_dict()]
    wish = {"texts": texts, "seconds": [2, 1.5], "seed": 7, "steps": 2, "loop": True, "in_place": True}
    response = server.post("/api/file", {"wish": wish, "suffix": ".bvh", "fps": 30, "root": True})
    assert response.status == 200, response.body
    clip = pipe.sequence(["a person walks", graph], seconds=[2, 1.5], seed=7, steps=2).looped().in_place()
    assert response.body == encode(clip.resampled(30), ".bvh", root=True)
    assert server.clip(wish)[-1]["clip"]["frames"] == clip.frames
    assert server.clip({**wish, "seconds": "2,1.5"})[-1]["clip"]["frames"] == clip.frames  # as typed


def test_a_changed_sequence_tells_which_sentences_were_made(server: PlaygroundClient) -> None:
    wish = {
        "texts": ["a person walks", "a person bows", "a person waves"],
        "seconds": [1, 1, 1],
        "seed": 71,
        "steps": 2,
    }
    assert server.clip(wish)[-1]["made"] == [0, 1, 2]
    changed = server.clip({**wish, "texts": ["a person walks", "a person turns", "a person waves"]})[-1]
    assert changed["made"] == [1]
    assert server.clip(wish)[-1]["made"] == []
    assert "made" not in server.clip(REQUEST)[-1]


def test_layers_are_those_of_a_timeline(server: PlaygroundClient, pipe: MotionPipeline) -> None:
    layer = {"text": "a person waves the right hand", "begin": 0, "end": 1, "weight": 0.5}
    wish = {"texts": ["a person walks"], "seconds": [2], "seed": 7, "steps": 2, "layers": [layer]}
    response = server.post("/api/file", {"wish": wish, "suffix": ".npz"})
    clip = generate_timeline(pipe, ["a person walks"], seconds=2, seed=7, steps=2, layers=[Layer(**layer)])
    assert response.status == 200 and response.body == encode(clip, ".npz")
    assert any("counts from 0 to 2 s" in note for note in server.clip(wish)[-1]["clip"]["notes"])
    for layers, reason in (
        ([{**layer, "end": 0}], "ends after that"),
        ([layer["text"]], "a list of"),
        ([{**layer, "x": 1}], "unknown"),
    ):
        refused = server.post("/api/clip", {**wish, "layers": layers})
        assert refused.status == 400 and reason in refused.json["error"], refused
    refused = server.post("/api/clip", {**REQUEST, "layers": [layer]})
    assert refused.status == 400 and "layers is for a sequence" in refused.json["error"]


def test_sentences_have_the_seeds_that_go_with_them(server: PlaygroundClient, pipe: MotionPipeline) -> None:
    wish = {"texts": ["a person walks", "a person turns"], "seconds": [1, 1], "seed": 7, "steps": 2}
    response = server.post("/api/file", {"wish": {**wish, "seed_offsets": [2, 0]}, "suffix": ".npz"})
    clip = pipe.sequence(wish["texts"], seconds=1, seed=7, steps=2, seed_offsets=[2, 0])
    assert response.status == 200 and response.body == encode(clip, ".npz")
    refused = server.post("/api/clip", {**REQUEST, "seed_offsets": [0]})
    assert refused.status == 400 and "seed_offsets is for a sequence" in refused.json["error"]


def test_a_draft_is_the_last_clip_of_these_words_bent(server: PlaygroundClient, pipe: MotionPipeline) -> None:
    assert pipe.sampler.sessions.decoder_gradients
    wish = {**REQUEST, "seed": 72, "constraints": [{"type": "waypoint", "seconds": 1.5, "position": [0.3, 0.8]}]}
    assert [event["event"] for event in server.clip({**wish, "draft": True})] == ["queued"]  # nothing to bend yet
    server.clip({**REQUEST, "seed": 72})
    _, draft = server.clip({**wish, "draft": True})
    assert draft["event"] == "draft" and draft["clip"]["level"] == "draft"
    assert draft["clip"]["misses"][0]["metres"] < 0.03
    refused = server.post("/api/file", {"wish": {**wish, "draft": True}, "suffix": ".glb"})
    assert refused.status == 400 and "draft" in refused.json["error"]  # a file is of a clip


def character_body(name: str, data: bytes, **changes: Any) -> bytes:
    return json.dumps({"wish": REQUEST, "name": name, **changes}).encode() + b"\n" + data


def send_character(server: PlaygroundClient, body: bytes) -> Any:
    return server.send("POST", "/api/character", body, content_type="application/octet-stream", kinegraph_tab="test")


def test_a_character_comes_back_with_the_clip(server: PlaygroundClient, pipe: MotionPipeline, tmp_path: Path) -> None:
    hero = tmp_path / "hero.glb"
    hero.write_bytes(make_character(BUILDS["Mixamo, T-pose, centimetres"]))
    response = send_character(server, character_body("hero.glb", hero.read_bytes(), fps=24, root=True))
    clip = pipe.generate(TEXT, seconds=2, seed=7, steps=3)
    assert response.status == 200 and response.body == clip.onto(hero, fps=24, root=True).encode()


def referring_to(uri: str) -> bytes:
    """Make a character whose buffer is another file."""
    document = json.dumps({"asset": {"version": "2.0"}, "buffers": [{"uri": uri, "byteLength": 4}]}).encode()
    document += b" " * (-len(document) % 4)
    return struct.pack("<4sIIII", b"glTF", 2, 20 + len(document), len(document), 0x4E4F534A) + document


def test_characters_are_bounded_and_refused_with_a_reason(
    server: PlaygroundClient, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hero = make_character(BUILDS["Mixamo, T-pose, centimetres"])
    (tmp_path / "beside.bin").write_bytes(bytes(4))
    monkeypatch.chdir(tmp_path)  # what lies where the server was started is no business of a character either
    for body, status, reason in (
        (character_body("hero.bvh", b"HIERARCHY"), 400, ".glb or .vrm"),
        (character_body("x" * 300 + ".glb", hero), 400, "at most 200"),
        (character_body("hero.glb", b""), 400, "cannot be used"),
        (character_body("hero.glb", hero[:5000]), 400, "cannot be used"),
        (character_body("hero.glb", referring_to("../../secret.bin")), 400, "refers to"),
        (character_body("hero.glb", referring_to("beside.bin")), 400, "refers to"),
        (character_body("hero.glb", hero, wish={"text": TEXT}), 400, "needs the seed"),
        (character_body("hero.glb", hero, wish=[]), 400, "wish must be"),
        (character_body("hero.glb", hero, suffix=".glb"), 400, "unknown 'suffix'"),
        (b"x" * 200_000, 400, "behind a line of JSON"),
        (b"x" * (33 * 1024 * 1024 + 1), 413, "bytes"),
    ):
        response = send_character(server, body)
        assert response.status == status and reason in response.json["error"], response
    assert server.post("/api/parse", {"text": "x" * 70_000}).status == 413  # other bodies are as short as before


def test_few_characters_are_read_at_once(server: PlaygroundClient) -> None:
    head = f"POST /api/character HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nContent-Length: 1000\r\n"
    head += "Content-Type: application/octet-stream\r\n\r\n"
    with ExitStack() as stack:
        for _ in range(2):
            slow = stack.enter_context(socket.create_connection(("127.0.0.1", server.port)))
            slow.sendall(head.encode())
        time.sleep(0.2)
        response = send_character(server, character_body("hero.glb", b""))
        assert response.status == 503 and "try again" in response.json["error"]
        assert server.post("/api/parse", {"text": TEXT}).status == 200
    deadline = time.monotonic() + 5
    while send_character(server, character_body("hero.glb", b"")).status == 503:
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_adding_and_hiding_change_the_graph(server: PlaygroundClient) -> None:
    graph = server.post("/api/parse", {"text": "a person walks"}).json
    for edit in (
        {"kind": "argument", "node": 1, "role": "ARGM-MNR", "text": "slowly"},
        {"kind": "action", "text": "waves"},
        {"kind": "mask", "node": 1},
        {"kind": "replace", "node": 2, "text": "bows"},
    ):
        response = server.post("/api/edit", {"graph": graph, "edit": edit})
        assert response.status == 200, response
        graph = response.json
    assert graph["caption"] == "a person [MASK] slowly and bows"


def test_a_reader_who_leaves_stops_the_clip(
    server: PlaygroundClient, pipe: MotionPipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    stopped = threading.Event()
    generate = pipe.generate

    def watched(_: MotionPipeline, *arguments: Any, **options: Any) -> Any:
        try:
            return generate(*arguments, **options)
        except Cancelled:
            stopped.set()
            raise

    monkeypatch.setattr(MotionPipeline, "generate", watched)
    with server.events(LONG, tab="leaves") as events:
        while next(events)["event"] != "step":
            pass
        assert not stopped.is_set()
    assert stopped.wait(5)
    # and one who leaves while waiting is not waited for
    with server.events(LONG, tab="first"), server.events(LONG, tab="second"):
        time.sleep(0.1)
    assert server.clip(REQUEST, tab="third")[-1]["event"] == "clip"


def test_who_leaves_a_file_stops_its_clip(
    server: PlaygroundClient, pipe: MotionPipeline, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    started, stopped = threading.Event(), threading.Event()
    generate = pipe.generate

    def watched(_: MotionPipeline, *arguments: Any, **options: Any) -> Any:
        started.set()
        try:
            return generate(*arguments, **options)
        except Cancelled:
            stopped.set()
            raise

    monkeypatch.setattr(MotionPipeline, "generate", watched)
    body = json.dumps({"wish": LONG, "suffix": ".npz"}).encode()
    head = f"POST /api/file HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nContent-Type: application/json\r\n"
    request = f"{head}Content-Length: {len(body)}\r\n\r\n".encode() + body
    with socket.create_connection(("127.0.0.1", server.port)) as working:
        working.sendall(request)
        assert started.wait(10)
        with socket.create_connection(("127.0.0.1", server.port)) as waiting:
            waiting.sendall(request)
            time.sleep(0.1)
        started.clear()
        assert not stopped.is_set()
    assert stopped.wait(5)
    assert server.clip(REQUEST, tab="other")[-1]["event"] == "clip"
    assert caplog.records == []


@pytest.mark.parametrize(
    ("error", "said"), [(RuntimeError("made to fail"), "made to fail"), (ZeroDivisionError("ours"), UNEXPECTED)]
)
def test_a_clip_that_fails_is_told_in_the_stream_and_for_a_file(
    toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch, error: Exception, said: str
) -> None:
    """A session's error has a type and a message; one that nobody foresaw is logged, and the client is told so."""

    def fail(*_: Any, **__: Any) -> Any:
        raise error

    class Failing:
        run = staticmethod(fail)

    pipeline = toy.with_sessions(replace(toy.sampler.sessions, decoder=Failing()))
    if said == UNEXPECTED:
        monkeypatch.setattr(MotionPipeline, "generate", fail)
    with running_playground(pipeline) as server:
        *others, last = server.clip(REQUEST)
        assert last["event"] == "error" and said in last["message"] and "clip" not in [each["event"] for each in others]
        response = server.post("/api/file", {"wish": REQUEST, "suffix": ".npz"})
        assert response.status == 500 and said in response.json["error"]


def test_a_reader_who_does_not_read_holds_nobody_up(toy: MotionPipeline) -> None:
    with running_playground(toy) as server, ExitStack() as open_streams:
        for number in range(4):
            open_streams.enter_context(server.events(REQUEST, f"slow {number}"))  # and reads nothing more
        start = time.monotonic()
        assert server.clip(REQUEST, tab="quick")[-1]["event"] == "clip"
        assert server.send("GET", "/").status == 200
        assert time.monotonic() - start < 10


def test_a_reader_who_stops_reading_and_leaves_stops_the_clip(
    toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even where the server was waiting to write, and something still holds the iterator, as a traceback may."""
    held = []

    async def body() -> None:
        playground = Playground(toy)
        events = playground._events
        monkeypatch.setattr(playground, "_events", lambda *of: held.append(events(*of)) or held[-1])
        data = json.dumps({**LONG, "text": "a person walks"}).encode()
        messages = [{"type": "http.request", "body": data, "more_body": False}]
        writing = asyncio.Event()

        async def receive() -> Any:
            if messages:
                return messages.pop()
            await writing.wait()
            return {"type": "http.disconnect"}

        async def send(message: Any) -> None:
            if message["type"] == "http.response.body":
                writing.set()
                await asyncio.sleep(1000)

        headers = [(b"host", b"localhost:1"), (b"content-type", b"application/json")]
        scope = {"type": "http", "method": "POST", "path": "/api/clip", "query_string": b"", "headers": headers}
        await application(playground, 1, ServerLimits())(scope, receive, send)
        assert len(held) == 1
        await asyncio.sleep(0)
        assert all(job.cancelling() for job in playground._jobs)
        await asyncio.gather(*playground._jobs, return_exceptions=True)

    with ThreadPoolExecutor(1) as thread:  # a browser of another test keeps an event loop running in this one
        thread.submit(lambda: asyncio.run(asyncio.wait_for(body(), 60))).result()


def test_a_clip_has_a_limit_of_time(toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs, "MAX_SECONDS", 0.05)
    with running_playground(toy) as server:
        last = server.clip(LONG)[-1]
        assert last["event"] == "error" and "a clip may take 0.05 seconds" in last["message"]
        response = server.post("/api/file", {"wish": LONG, "suffix": ".npz"})
        assert response.status == 503 and "fewer steps" in response.json["error"]


def test_a_second_tab_is_not_starved_by_the_first(server: PlaygroundClient) -> None:
    order: list[str] = []

    def ask(tab: str) -> None:
        # many steps, so that even on a fast machine the first clip is unfinished when the other tab asks
        assert server.clip({**REQUEST, "steps": 200}, tab)[-1]["event"] == "clip"
        order.append(tab)

    threads = [threading.Thread(target=ask, args=("busy",)) for _ in range(4)]
    for thread in threads:
        thread.start()
    time.sleep(0.1)
    threads.append(threading.Thread(target=ask, args=("other",)))
    threads[-1].start()
    for thread in threads:
        thread.join(60)
    assert len(order) == 5 and order.index("other") <= 2


def test_a_full_queue_is_said_at_once(server: PlaygroundClient) -> None:
    with ExitStack() as open_streams:
        for _ in range(1 + MAX_PER_TAB):
            events = open_streams.enter_context(server.events(LONG, "full"))
            assert next(events)["event"] == "queued"
        # the last of them enters the queue right after its event
        time.sleep(0.2)
        response = server.post("/api/clip", REQUEST, "full")
        assert response.status == 503 and response.headers["retry-after"] == "2"
        assert f"{MAX_PER_TAB} requests are waiting already" in response.json["error"]
        assert server.post("/api/parse", {"text": TEXT}, "full").status == 200
    assert server.clip(REQUEST, "full")[-1]["event"] == "clip"


def test_a_port_that_cannot_be_had_is_said_before_anything_is_loaded(
    server: PlaygroundClient, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(MotionPipeline, "load", lambda *_, **__: pytest.fail("loaded"))
    assert "choose another with --port" in fails(capsys, "play", "--no-browser", "--port", str(server.port))
    assert "port must be 0 to 65535" in fails(capsys, "play", "--no-browser", "--port", "70000")


def test_the_command_says_its_address_answers_and_ends_with_ctrl_c() -> None:
    environment = {**os.environ, "PYTHONPATH": str(RUNTIME)}
    process = subprocess.Popen(
        [sys.executable, "-m", "kinegraph", "play", "--port", "0", "--no-browser", "--threads", "1"],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("http://127.0.0.1:"), process.communicate()
        client = PlaygroundClient(int(line.split(":")[2].split("/")[0]))
        assert client.clip(REQUEST)[-1]["event"] == "clip"
        with client.events(LONG) as events:
            while next(events)["event"] != "step":
                pass
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=20)
        assert (process.returncode, errors) == (0, "")
    finally:
        process.kill()
        process.wait()
