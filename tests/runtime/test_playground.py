"""`kinegraph play` over the wire: who may ask, what comes back, that it is the command line's, and that it stops."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from cli_runs import fails, whole
from playing import Playing, playing

import kinegraph
from kinegraph import MotionPipeline, cli
from kinegraph.errors import Cancelled

pytest.importorskip("spacy")
pytest.importorskip("starlette")
pytest.importorskip("uvicorn")

from kinegraph.play.turns import MAX_PER_TAB

RUNTIME = Path(kinegraph.__file__).resolve().parents[1]
TEXT = "a person walks slowly to the left"
WISH = {"text": TEXT, "seconds": 2, "seed": 7, "steps": 3}
LONG = {**WISH, "seconds": 9.8, "steps": 900}
"""Would take ten seconds and more."""


@pytest.fixture(scope="module")
def pipe() -> MotionPipeline:
    found = MotionPipeline.load(threads=1)
    found.parse(TEXT)
    return found


@pytest.fixture(scope="module")
def server(pipe: MotionPipeline) -> Iterator[Playing]:
    with playing(pipe) as found:
        yield found


def test_the_page_is_whole_and_may_talk_to_this_server_alone(server: Playing) -> None:
    answer = server.send("GET", "/")
    assert answer.status == 200 and answer.headers["content-type"] == "text/html; charset=utf-8"
    assert len(answer.body) <= 1_500_000
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy and "connect-src 'self'" in policy and "frame-ancestors 'none'" in policy
    assert "http" not in policy and "unsafe" not in policy and "*" not in policy


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "localhost.:{port}", ""]
)
def test_other_names_for_this_machine_are_refused(server: Playing, host: str) -> None:
    for method, path in (("GET", "/"), ("POST", "/api/parse")):
        answer = server.send(method, path, b"{}", Host=host.format(port=server.port), content_type="application/json")
        assert answer.status in (400, 421), answer  # 400: the server's own, for no Host at all
        assert b"graph" not in answer.body


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost", "LOCALHOST", "[::1]"])
def test_the_names_of_loopback_are_taken(server: Playing, name: str) -> None:
    host = f"{name}:{server.port}"
    answer = server.send(
        "POST",
        "/api/parse",
        b'{"text": "a person walks"}',
        Host=host,
        origin=f"http://{host}",
        content_type="application/json",
    )
    assert answer.status == 200


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
def test_pages_from_elsewhere_are_refused(server: Playing, headers: dict[str, str]) -> None:
    own = {name: value.format(port=server.port) for name, value in headers.items()}
    answer = server.send("POST", "/api/parse", b'{"text": "a person walks"}', content_type="application/json", **own)
    assert answer.status == 403 and answer.json == {"error": "another page may not ask this server"}


@pytest.mark.parametrize("kind", ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data", ""])
def test_what_a_page_may_send_without_asking_is_no_json(server: Playing, kind: str) -> None:
    assert server.send("POST", "/api/parse", b'{"text": "a person walks"}', content_type=kind).status == 415


def test_no_page_from_elsewhere_is_ever_given_leave(server: Playing) -> None:
    asks = {"origin": "http://evil.example", "access_control_request_method": "POST"}
    answers = [
        server.send("OPTIONS", "/api/clip", **asks),
        server.send("OPTIONS", "/api/clip"),
        server.send("GET", "/"),
    ]
    assert [answer.status for answer in answers] == [403, 405, 200]
    for answer in answers:
        assert not [name for name in answer.headers if name.startswith("access-control")]
        assert answer.headers["x-frame-options"] == "DENY" and answer.headers["cache-control"] == "no-store"


def test_requests_are_bounded(server: Playing) -> None:
    answer = server.post("/api/parse", {"text": "x" * 70_000})
    assert answer.status == 413 and "65536 bytes" in answer.json["error"]
    told = server.send("POST", "/api/parse", b"{}", content_type="application/json", content_length="9" * 40)
    assert told.status in (400, 413)
    chunked = server.send(
        "POST", "/api/parse", b"2\r\n{}\r\n0\r\n\r\n", content_type="application/json", transfer_encoding="chunked"
    )
    assert chunked.status == 411


@pytest.mark.parametrize(
    "path", ["/viewer.js", "/../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "//etc/passwd", "/api/", "/api/files"]
)
def test_there_are_no_files_to_be_had(server: Playing, path: str) -> None:
    for method in ("GET", "POST"):
        answer = server.send(method, path, b"{}", content_type="application/json")
        assert answer.status == 404 and b"root:" not in answer.body


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
    ("file", {"wish": WISH, "suffix": ".exe"}, "suffix must be one of"),
    ("file", {"wish": WISH, "suffix": ["x"]}, "suffix must be one of"),
    ("file", {"wish": 1, "suffix": ".bvh"}, "wish must be"),
    ("file", {"wish": {"text": TEXT}, "suffix": ".bvh"}, "needs the seed"),
    ("file", {"wish": WISH, "suffix": ".bvh", "names": "unreal"}, "one of smpl, mixamo"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "value", "message"), BAD, ids=range(len(BAD)))
def test_bad_requests_are_told_what_is_wrong(server: Playing, call: str, value: Any, message: str) -> None:
    answer = server.post(f"/api/{call}", value)
    assert answer.status == 400, answer
    assert message in answer.json["error"] and "\n" not in answer.json["error"]


def refusal(server: Playing, wish: object) -> str:
    """What the last event of a clip that cannot be says."""
    last = server.clip(wish)[-1]
    assert last["event"] == "error"
    return str(last["message"])


@pytest.mark.parametrize(
    ("changes", "message"), [({"seconds": 90}, "seconds"), ({"seed": -1}, "seed"), ({"foot_fix": "x"}, "foot_fix")]
)
def test_what_the_model_does_not_take_ends_the_stream_with_its_message(
    server: Playing, changes: dict[str, Any], message: str
) -> None:
    assert message in refusal(server, {**WISH, **changes})


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
    server: Playing, changes: dict[str, Any], flags: list[str], capsys: pytest.CaptureFixture[str], here: Path
) -> None:
    message = refusal(server, {"concepts": [{"text": "a person walks"}], **changes})
    assert message and message in fails(capsys, "compose", "--and", "a person walks", *flags, "-o", "x.npz")
    assert list(here.iterdir()) == []


def test_no_concepts_are_called_that(server: Playing) -> None:
    assert refusal(server, {"concepts": []}) == "a composition has 1 to 8 concepts, not 0"


def test_a_clip_comes_with_its_graph_its_steps_and_the_time_of_each_stage(
    server: Playing, pipe: MotionPipeline
) -> None:
    events = server.clip(WISH)
    kinds = [event["event"] for event in events]
    assert kinds[:2] == ["queued", "graph"] and kinds[-1] == "clip" and {*kinds[2:-1]} == {"step", "level"}
    coarse = [(place, event["level"]) for place, event in enumerate(events) if event["event"] == "level"]
    assert [level for _, level in coarse] == ["motion", "action"]
    assert all(kinds[place - 1] == kinds[place + 1] == "step" for place, _ in coarse)  # between one level and the next
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
def test_files_are_those_of_the_command_line(server: Playing, here: Path, suffix: str, names: str) -> None:
    answer = server.post("/api/file", {"wish": WISH, "suffix": suffix, "names": names})
    assert cli.main(["generate", TEXT, *FLAGS, "--names", names, "-o", f"walk{suffix}"]) == 0
    assert answer.status == 200 and answer.body == (here / f"walk{suffix}").read_bytes()


def test_an_edited_graph_gives_the_clip_of_the_edits(server: Playing, here: Path) -> None:
    graph = server.post("/api/parse", {"text": TEXT}).json
    graph = server.post("/api/edit", {"graph": graph, "edit": {"kind": "drop", "node": 3}}).json
    assert graph["caption"] == "a person walks to the left"
    graph["actions"][0]["arguments"][-1]["weight"] = 0.25
    answer = server.post("/api/file", {"wish": {**WISH, "text": TEXT, "graph": graph}, "suffix": ".npz"})
    edits = ["--drop", "slowly", "--weight", "to the left=0.25"]
    assert cli.main(["generate", TEXT, *FLAGS, *edits, "-o", "walk.npz"]) == 0
    assert answer.body == (here / "walk.npz").read_bytes()
    assert answer.body != server.post("/api/file", {"wish": WISH, "suffix": ".npz"}).body


def test_concepts_give_the_clip_of_compose(server: Playing, here: Path) -> None:
    concepts = [{"text": "a person walks"}, {"text": "a person runs", "weight": -0.5}]
    wish = {"concepts": concepts, "method": "latent", "seed": str(2**62 + 1), "seconds": "2", "steps": "3"}
    answer = server.post("/api/file", {"wish": wish, "suffix": ".npz"})
    flags = [*FLAGS, "--seed", str(2**62 + 1), "--method", "latent"]
    assert cli.main(["compose", "--and", "a person walks", "--not", "a person runs:0.5", *flags, "-o", "x.npz"]) == 0
    assert answer.body == (here / "x.npz").read_bytes()


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
    server: Playing, here: Path, changes: dict[str, Any], flags: list[str]
) -> None:
    wish = {"concepts": [{"text": "a person walks"}, {"text": "a person waves"}], "seed": 7, "seconds": 2, "steps": 3}
    answer = server.post("/api/file", {"wish": {**wish, **changes}, "suffix": ".npz"})
    words = ["--and", "a person walks", "--and", "a person waves"]
    assert cli.main(["compose", *words, *FLAGS, *flags, "-o", "x.npz"]) == 0
    assert answer.body == (here / "x.npz").read_bytes()
    assert answer.body != server.post("/api/file", {"wish": wish, "suffix": ".npz"}).body


def test_adding_and_hiding_change_the_graph(server: Playing) -> None:
    graph = server.post("/api/parse", {"text": "a person walks"}).json
    for edit in (
        {"kind": "argument", "node": 1, "role": "ARGM-MNR", "text": "slowly"},
        {"kind": "action", "text": "waves"},
        {"kind": "mask", "node": 1},
        {"kind": "replace", "node": 2, "text": "bows"},
    ):
        answer = server.post("/api/edit", {"graph": graph, "edit": edit})
        assert answer.status == 200, answer
        graph = answer.json
    assert graph["caption"] == "a person [MASK] slowly and bows"


def test_a_reader_who_leaves_stops_the_clip(
    server: Playing, pipe: MotionPipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    stopped = threading.Event()
    generate = pipe.generate

    def watched(*arguments: Any, **options: Any) -> Any:
        try:
            return generate(*arguments, **options)
        except Cancelled:
            stopped.set()
            raise

    monkeypatch.setattr(pipe, "generate", watched)
    with server.events(LONG, tab="leaves") as events:
        while next(events)["event"] != "step":
            pass
        assert not stopped.is_set()
    assert stopped.wait(5)
    # and one who leaves while waiting is not waited for
    with server.events(LONG, tab="first"), server.events(LONG, tab="second"):
        time.sleep(0.1)
    assert server.clip(WISH, tab="third")[-1]["event"] == "clip"


def test_a_second_tab_is_not_starved_by_the_first(server: Playing) -> None:
    order: list[str] = []

    def ask(tab: str) -> None:
        assert server.clip({**WISH, "steps": 20}, tab)[-1]["event"] == "clip"
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


def test_a_full_queue_is_said_at_once(server: Playing) -> None:
    with ExitStack() as open_streams:
        for _ in range(1 + MAX_PER_TAB):
            events = open_streams.enter_context(server.events(LONG, "full"))
            assert next(events)["event"] == "queued"
        # the last of them takes its place in the queue right after it said so
        time.sleep(0.2)
        answer = server.post("/api/clip", WISH, "full")
        assert answer.status == 503 and answer.headers["retry-after"] == "2"
        assert f"{MAX_PER_TAB} requests are waiting already" in answer.json["error"]
        assert server.post("/api/parse", {"text": TEXT}, "full").status == 200
    assert server.clip(WISH, "full")[-1]["event"] == "clip"


def test_nothing_is_written_and_nothing_asked_of_the_network(server: Playing) -> None:
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
        assert server.clip(WISH)[-1]["event"] == "clip"
        for suffix in (".bvh", ".glb", ".npz", ".html"):
            assert server.post("/api/file", {"wish": WISH, "suffix": suffix}).status == 200
    finally:
        watching.clear()
    assert seen == []


def test_a_port_that_cannot_be_had_is_said_before_anything_is_loaded(
    server: Playing, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cli, "_load", lambda *_: pytest.fail("loaded"))
    assert "choose another with --port" in fails(capsys, "play", "--no-browser", "--port", str(server.port))
    assert "port must be 0 to 65535" in fails(capsys, "play", "--no-browser", "--port", "70000")


def test_the_command_says_its_address_answers_and_ends_with_ctrl_c() -> None:
    environment = {**os.environ, "PYTHONPATH": str(RUNTIME)}
    process = subprocess.Popen(
        [sys.executable, "-m", "kinegraph.cli", "play", "--port", "0", "--no-browser", "--threads", "1"],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("http://127.0.0.1:"), process.communicate()
        own = Playing(int(line.split(":")[2].split("/")[0]))
        assert own.clip(WISH)[-1]["event"] == "clip"
        with own.events(LONG) as events:
            while next(events)["event"] != "step":
                pass
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=20)
        assert (process.returncode, errors) == (0, "")
    finally:
        process.kill()
        process.wait()
