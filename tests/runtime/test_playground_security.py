"""`kinegraph play` over HTTP: who may use it, which requests it refuses and how, and what it never does."""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from kinegraph import MotionPipeline
from support.cli_runs import fails, whole
from support.playground import REQUEST, TEXT, PlaygroundClient, running_playground

pytest.importorskip("spacy")
pytest.importorskip("starlette")
pytest.importorskip("uvicorn")

from kinegraph.playground.guards import UNEXPECTED


def test_the_page_is_whole_and_may_talk_to_this_server_alone(server: PlaygroundClient) -> None:
    response = server.send("GET", "/")
    assert response.status == 200 and response.headers["content-type"] == "text/html; charset=utf-8"
    assert len(response.body) <= 1_500_000
    policy = response.headers["content-security-policy"]
    assert "default-src 'none'" in policy and "connect-src 'self'" in policy and "frame-ancestors 'none'" in policy
    assert "http" not in policy and "unsafe" not in policy and "*" not in policy


def test_a_page_of_another_site_opens_it_and_drives_nothing(server: PlaygroundClient) -> None:
    for site, waits in (("cross-site", b"true"), ("same-site", b"true"), ("same-origin", b"false"), ("none", b"false")):
        assert b'"waits":' + waits in server.send("GET", "/", sec_fetch_site=site).body
    assert b'"waits":false' in server.send("GET", "/").body


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "localhost.:{port}", ""]
)
def test_other_names_for_this_machine_are_refused(server: PlaygroundClient, host: str) -> None:
    for method, path in (("GET", "/"), ("POST", "/api/parse")):
        response = server.send(method, path, b"{}", Host=host.format(port=server.port), content_type="application/json")
        assert response.status in (400, 421), response  # 400: the server's own, for no Host at all
        assert b"graph" not in response.body


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost", "LOCALHOST", "[::1]"])
def test_the_names_of_loopback_are_taken(server: PlaygroundClient, name: str) -> None:
    host = f"{name}:{server.port}"
    response = server.send(
        "POST",
        "/api/parse",
        b'{"text": "a person walks"}',
        Host=host,
        origin=f"http://{host}",
        content_type="application/json",
    )
    assert response.status == 200


@pytest.mark.parametrize(
    "headers",
    [
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "https://127.0.0.1:{port}"},
        {"origin": "http://127.0.0.1:1"},
        {"sec_fetch_site": "cross-site"},
        {"sec_fetch_site": "same-site"},
    ],
)
def test_pages_from_elsewhere_are_refused(server: PlaygroundClient, headers: dict[str, str]) -> None:
    formatted = {name: value.format(port=server.port) for name, value in headers.items()}
    response = server.send(
        "POST", "/api/parse", b'{"text": "a person walks"}', content_type="application/json", **formatted
    )
    assert response.status == 403 and response.json == {"error": "another page may not ask this server"}


@pytest.mark.parametrize("kind", ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data", ""])
def test_what_a_page_may_send_without_asking_is_no_json(server: PlaygroundClient, kind: str) -> None:
    assert server.send("POST", "/api/parse", b'{"text": "a person walks"}', content_type=kind).status == 415


def test_no_page_from_elsewhere_is_ever_given_leave(server: PlaygroundClient) -> None:
    preflight = {"origin": "http://evil.example", "access_control_request_method": "POST"}
    responses = [
        server.send("OPTIONS", "/api/clip", **preflight),
        server.send("OPTIONS", "/api/clip"),
        server.send("GET", "/"),
    ]
    assert [response.status for response in responses] == [403, 405, 200]
    for response in responses:
        assert not [name for name in response.headers if name.startswith("access-control")]
        assert response.headers["x-frame-options"] == "DENY" and response.headers["cache-control"] == "no-store"


def test_requests_are_bounded(server: PlaygroundClient) -> None:
    response = server.post("/api/parse", {"text": "x" * 70_000})
    assert response.status == 413 and "65536 bytes" in response.json["error"]
    # Without a body: what is sent after the refusal resets the connection, and the answer may be lost with it.
    overstated = server.send("POST", "/api/parse", b"", content_type="application/json", content_length="9" * 40)
    assert overstated.status in (400, 413)
    body = b'{"text": "%s"}' % (b"x" * 70_000)
    for headers in ({}, {"content_length": "2"}):
        chunked = server.send(
            "POST", "/api/parse", b"%x\r\n%s\r\n0\r\n\r\n" % (len(body), body), content_type="application/json",
            transfer_encoding="chunked", **headers,
        )  # fmt: skip
        assert chunked.status == (400 if headers else 413), chunked


@pytest.mark.parametrize(
    "path", ["/viewer.js", "/../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "//etc/passwd", "/api/", "/api/files"]
)
def test_there_are_no_files_to_be_had(server: PlaygroundClient, path: str) -> None:
    for method in ("GET", "POST"):
        response = server.send(method, path, b"{}", content_type="application/json")
        assert response.status == 404 and b"root:" not in response.body


GRAPH = whole(TEXT).to_dict()
BAD: list[tuple[str, Any, str]] = [
    ("parse", b"{", "not valid JSON"),
    ("parse", b"\xff\xfe", "not valid JSON"),
    ("parse", b"[" * 60_000, "not valid JSON"),
    ("parse", [], "must be a JSON object"),
    ("parse", {}, "text"),
    ("parse", {"text": " "}, "caption is empty"),
    ("parse", {"text": 7}, "text"),
    ("parse", {"text": TEXT, "file": "/etc/passwd"}, "unknown 'file'"),
    ("edit", {"edit": {"kind": "drop", "node": 1}}, "the graph must be a JSON object"),
    ("edit", {"graph": GRAPH, "edit": {"kind": "drop", "node": 1}}, "the only action"),
    ("edit", {"graph": GRAPH, "edit": {"kind": "mask", "node": 9}}, "no node 9"),
    ("edit", {"graph": GRAPH, "edit": {"kind": "shell", "node": 1}}, "edit.kind must be"),
    ("edit", {"graph": GRAPH, "edit": {"kind": "argument", "node": 1, "text": "x", "role": "Z"}}, "role"),
    ("clip", {"seed": 1}, "text"),
    ("clip", {"text": TEXT, "graph": GRAPH, "concepts": []}, "either concepts or the graph"),
    ("clip", {"text": TEXT, "method": "fused"}, "method is for concepts"),
    ("clip", {"text": TEXT, "lambdas": "0,0,1"}, "lambdas is for concepts"),
    ("clip", {"graph": GRAPH, "agd": "0.2,0.2"}, "agd is for concepts"),
    ("clip", {"concepts": [], "lambdas": "a,b,c"}, "lambdas: 'a,b,c' is not a number"),
    ("clip", {"concepts": [], "agd": "much"}, "agd: 'much' is not a number"),
    ("clip", {"text": TEXT, "steps": "many"}, "steps: 'many' is not a number"),
    ("clip", {"text": TEXT, "on_step": "x"}, "unknown 'on_step'"),
    ("clip", {"concepts": [{"text": TEXT, "weight": "heavy"}]}, "weight"),
    ("clip", {"concepts": "walk"}, "concepts must be a list"),
    ("file", {"wish": REQUEST, "suffix": ".exe"}, "suffix must be one of"),
    ("file", {"wish": REQUEST, "suffix": ["x"]}, "suffix must be one of"),
    ("file", {"wish": 1, "suffix": ".bvh"}, "wish must be"),
    ("file", {"wish": {"text": TEXT}, "suffix": ".bvh"}, "needs the seed"),
    ("file", {"wish": {**REQUEST, "seed": None}, "suffix": ".bvh"}, "needs the seed"),
    ("file", {"wish": {**REQUEST, "seed": ""}, "suffix": ".bvh"}, "seed: '' is not a number"),
    ("file", {"wish": REQUEST, "suffix": ".bvh", "seed": 7}, "unknown 'seed'"),
    ("file", {"wish": REQUEST, "suffix": ".bvh", "names": ["smpl"]}, "names must be text"),
    ("clip", b'{"text": "\\ud800"}', "half of a surrogate pair"),
    ("clip", b'{"text": "a", "text": "b"}', "repeated key 'text'"),
    ("clip", b'{"text": "a person walks", "seconds": NaN}', "NaN is not a number"),
    ("clip", b'{"text": ' + b"[" * 17 + b"]" * 17 + b"}", "nested more than 16 deep"),
    ("clip", b'{"text": "' + b'\\"' * 30_000, "not valid JSON"),
    ("file", {"wish": REQUEST, "suffix": ".bvh", "names": "unreal"}, "one of smpl, mixamo"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "value", "message"), BAD, ids=range(len(BAD)))
def test_bad_requests_are_told_what_is_wrong(server: PlaygroundClient, call: str, value: Any, message: str) -> None:
    response = server.post(f"/api/{call}", value)
    assert response.status == 400, response
    assert message in response.json["error"] and "\n" not in response.json["error"]


def refusal(server: PlaygroundClient, request: object) -> str:
    """Return the error message of the last event of an invalid clip."""
    last = server.clip(request)[-1]
    assert last["event"] == "error"
    return str(last["message"])


@pytest.mark.parametrize(
    ("changes", "message"), [({"seconds": 90}, "seconds"), ({"seed": -1}, "seed"), ({"foot_fix": "x"}, "foot_fix")]
)
def test_what_the_model_does_not_take_ends_the_stream_with_its_message(
    server: PlaygroundClient, changes: dict[str, Any], message: str
) -> None:
    assert message in refusal(server, {**REQUEST, **changes})


@pytest.mark.parametrize(
    ("changes", "flags"),
    [
        ({"lambdas": "0.5,0.4,0.2"}, ["--lambdas", "0.5,0.4,0.2"]),
        ({"lambdas": "0.5"}, ["--lambdas", "0.5"]),
        ({"lambdas": "2,-1,0"}, ["--lambdas", "2,-1,0"]),
        ({"lambdas": "nan,0,1"}, ["--lambdas", "nan,0,1"]),
        ({"lambdas": "0,0,1", "method": "latent"}, ["--lambdas", "0,0,1", "--method", "latent"]),
        ({"text": "a person bows", "method": "semantic"}, ["--text", "a person bows", "--method", "semantic"]),
        ({"text": " "}, ["--text", " "]),
        ({"agd": "3,0.2"}, ["--agd", "3,0.2"]),
        ({"agd": "0.2"}, ["--agd", "0.2"]),
        ({"method": "melted"}, ["--method", "melted"]),
    ],
)
def test_compositions_are_refused_in_the_words_of_the_command_line(
    server: PlaygroundClient, changes: dict[str, Any], flags: list[str], capsys: pytest.CaptureFixture[str], here: Path
) -> None:
    message = refusal(server, {"concepts": [{"text": "a person walks"}], **changes})
    assert message and message in fails(capsys, "compose", "--and", "a person walks", *flags, "-o", "x.npz")
    assert list(here.iterdir()) == []


def test_no_concepts_are_called_that(server: PlaygroundClient) -> None:
    assert refusal(server, {"concepts": []}) == "a composition has 1 to 8 concepts, not 0"


def test_nothing_is_written_and_nothing_asked_of_the_network(server: PlaygroundClient) -> None:
    seen: list[str] = []
    watching = threading.Event()

    def watch(event: str, arguments: tuple[Any, ...]) -> None:
        if not watching.is_set():
            return
        if event == "open" and isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR):
            seen.append(f"writes {arguments[0]}")
        elif event == "socket.connect" and arguments[1][:2] != ("127.0.0.1", server.port):
            seen.append(f"connects to {arguments[1]}")
        elif event in ("os.remove", "os.rename", "os.mkdir", "subprocess.Popen", "os.system"):
            seen.append(event)

    sys.addaudithook(watch)  # stays until the process ends, and asleep after this test
    watching.set()
    try:
        server.send("GET", "/")
        assert server.clip(REQUEST)[-1]["event"] == "clip"
        for suffix in (".bvh", ".glb", ".npz", ".html"):
            assert server.post("/api/file", {"wish": REQUEST, "suffix": suffix}).status == 200
    finally:
        watching.clear()
    assert seen == []


HUGE: list[Any] = [
    10**400, -(10**400), 10**40, 2**64, 1e308, -1e308, 5e-324, True, None, "", " ", "9" * 400, "9" * 5000, "1e400",
    "nan", "inf", "-0", "\ud800", "\x00", "a" * 60_000, [], {}, [[[[[[[[]]]]]]]], [10**400] * 3, {"motion": 10**400},
    ["9" * 4000],
]  # fmt: skip
"""Values that some reader could fail on; JSON may hold them all."""


def places(value: Any) -> Iterator[tuple[Any, ...]]:
    """Yield the path of every value inside a JSON value."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        yield (key,)
        yield from ((key, *rest) for rest in places(item))


def put(value: Any, path: tuple[Any, ...], new: Any) -> Any:
    """Copy a JSON value with another value at a path."""
    if not path:
        return new
    copy = dict(value) if isinstance(value, dict) else list(value)
    copy[path[0]] = put(value[path[0]], path[1:], new)
    return copy


MIX = {
    "concepts": [{"text": TEXT, "weight": 1.0}], "text": TEXT, "method": "fused", "lambdas": [1, 0, 0],
    "agd": [0.1, 0.1], "seconds": 1, "seed": 7, "steps": [1, 1, 1], "guidance": [1, 1, 1], "foot_fix": True,
}  # fmt: skip
TEMPLATES: list[tuple[str, Any]] = [
    ("parse", {"text": TEXT}),
    ("unknown", {"graph": GRAPH}),
    ("edit", {"graph": GRAPH, "edit": {"kind": "argument", "node": 1, "text": "fast", "role": "ARGM-MNR"}}),
    ("clip", {"graph": GRAPH, "seconds": 1, "steps": 1, "seed": 1}),
    ("clip", MIX),
    ("file", {"wish": MIX, "suffix": ".npz", "names": "smpl"}),
]


@pytest.mark.parametrize(
    "call, template", TEMPLATES, ids=[f"{number} {call}" for number, (call, _) in enumerate(TEMPLATES)]
)
def test_no_value_at_any_place_is_more_than_refused(
    toy: MotionPipeline, call: str, template: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """Numbers of any size, texts of any length, any kind of value: an answer, or a 4xx that says why, and no log."""
    with running_playground(toy) as server:
        for path in places(template):
            for value in HUGE:
                response = server.post(f"/api/{call}", put(template, path, value))
                assert response.status in (200, 400, 413), (path, value, response)
                if response.status != 200:
                    assert response.json["error"]
                elif call == "clip":
                    last = json.loads(response.body.splitlines()[-1])
                    assert last["event"] in ("clip", "error") and last.get("message") != UNEXPECTED, (path, value, last)
    assert caplog.records == []


@pytest.mark.parametrize("depth", [17, 500, 990, 1000, 5000, 30_000])
@pytest.mark.parametrize("call", ["parse", "unknown", "edit", "clip", "file"])
def test_nesting_of_any_depth_is_refused(server: PlaygroundClient, call: str, depth: int) -> None:
    for start, end in ((b"[", b"]"), (b'{"a":', b"}")):
        deep = (start * min(depth, 9000) + b"1" + end * min(depth, 9000))[:60_000]
        for body in (deep, b'{"text":' + deep + b"}", b'{"graph":' + deep + b"}"):
            response = server.post(f"/api/{call}", body)
            assert response.status == 400 and "nested more than 16 deep" in response.json["error"]
