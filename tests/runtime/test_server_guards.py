"""Guards of a server beside raw sockets: bounded bodies and heads, time limits, and room for quick clients.

The application behind them is none of the playground's, so any server may stand on the same guards.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import random
import socket
import threading
import time
import tracemalloc
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any

import pytest

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")

from kinegraph.playground.connections import GuardedServer
from kinegraph.playground.guards import RequestGuard, ServerLimits

LONG = "KINEGRAPH_LONG" in os.environ
CROWD = 200 if LONG else 40
"""Slow clients, and as many quick ones."""

HEAD = b"POST / HTTP/1.1\r\nHost: x\r\n"
QUICK = b"GET / HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n"
BRIEF = ServerLimits(body=1000, head_seconds=0.5, body_seconds=0.5, write_seconds=0.5)


@dataclass
class Echo:
    """Application that answers with the length of the body, or with what a path asks for."""

    seen: list[tuple[str, bytes]] = field(default_factory=list)
    """Path and body of the requests that came through."""
    cancelled: threading.Event = field(default_factory=threading.Event)

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] != "http":
            return  # uvicorn asks for a lifespan, and goes on without
        message = await receive()
        assert not message["more_body"]
        self.seen.append((scope["path"], message["body"]))
        if scope["path"] == "/fails":
            raise ZeroDivisionError("on purpose")
        if scope["path"] == "/waits":
            assert (await receive())["type"] == "http.disconnect"
            self.cancelled.set()
            return
        size = 8_000_000 if scope["path"] == "/much" else 0
        body = b"%d" % len(message["body"]) + b"." * size
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"%d" % len(body))]})
        await send({"type": "http.response.body", "body": body})


@dataclass
class Guarded:
    port: int
    app: Echo
    server: GuardedServer

    def connect(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.port), timeout=30)

    def ask(self, data: bytes) -> bytes:
        """Send bytes and return all that comes until the server closes."""
        with self.connect() as client:
            with contextlib.suppress(ConnectionError):  # it may close before it has read all
                client.sendall(data)
            return read_all(client)

    @property
    def open_connections(self) -> int:
        return len(self.server.server_state.connections)


def read_all(client: socket.socket) -> bytes:
    parts = []
    with contextlib.suppress(ConnectionError):
        while part := client.recv(1 << 20):
            parts.append(part)
    return b"".join(parts)


@contextmanager
def guarded(limits: ServerLimits) -> Iterator[Guarded]:
    """Run a guarded server until the end of the block."""
    app = Echo()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        server = GuardedServer(RequestGuard(app, limits), limits)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
        thread.start()
        assert wait_until(lambda: server.started)
        try:
            yield Guarded(listener.getsockname()[1], app, server)
        finally:
            server.should_exit = True
            thread.join(20)
            assert not thread.is_alive()


def wait_until(holds: Callable[[], bool], seconds: float = 20) -> bool:
    deadline = time.monotonic() + seconds
    while not holds():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True


@pytest.fixture(scope="module")
def plain() -> Iterator[Guarded]:
    with guarded(ServerLimits()) as server:
        yield server


@pytest.fixture(scope="module")
def brief() -> Iterator[Guarded]:
    with guarded(BRIEF) as server:
        yield server


def status(answer: bytes) -> int:
    return int(answer.split(b" ", 2)[1]) if answer else 0


def chunked(size: int, chunk: int = 50_000) -> Iterator[bytes]:
    for _ in range(size // chunk):
        yield b"%x\r\n" % chunk + b"x" * chunk + b"\r\n"
    yield b"0\r\n\r\n"


@pytest.mark.parametrize(
    ("headers", "body", "answer"),
    [
        ("Content-Length: 3", b"abc", 200),
        ("Content-Length: 65537", b"", 413),
        ("Content-Length: " + "9" * 18, b"", 413),
        ("Content-Length: -1", b"", 400),
        ("Content-Length: 1\r\nContent-Length: 2", b"ab", 400),
        ("Transfer-Encoding: chunked", b"3\r\nabc\r\n0\r\n\r\n", 200),
        ("Transfer-Encoding: chunked\r\nContent-Length: 2", b"3\r\nabc\r\n0\r\n\r\n", 400),
        ("Transfer-Encoding: gzip", b"", 400),
        ("Transfer-Encoding: chunked", b"f" * 30 + b"\r\n", 400),
        ("Transfer-Encoding: chunked", b"x\r\n", 400),
        ("Host: x\r\nContent-Length: 0", b"", 400),
        ("Origin: http://a\r\nOrigin: http://b\r\nContent-Length: 0", b"", 400),
        ("Content-Type: a/b\r\ncontent-type: a/c\r\nContent-Length: 0", b"", 400),
        ("X: " + "y" * 20_000 + "\r\nContent-Length: 0", b"", 431),
        ("\r\n".join(f"X{number}: y" for number in range(100)) + "\r\nContent-Length: 0", b"", 431),
        ("Expect: 100-continue\r\nContent-Length: 99999", b"", 413),
    ],
)
def test_heads_and_bodies_are_taken_or_refused(plain: Guarded, headers: str, body: bytes, answer: int) -> None:
    seen = len(plain.app.seen)
    data = HEAD + headers.encode() + b"\r\nConnection: close\r\n\r\n" + body
    assert status(plain.ask(data)) == answer
    assert len(plain.app.seen) - seen == (answer == 200)


@pytest.mark.parametrize("length", [b"", b"Content-Length: 2\r\n"])
def test_a_chunked_body_beyond_the_limit_is_not_read_into_memory(plain: Guarded, length: bytes) -> None:
    tracemalloc.start()
    try:
        with plain.connect() as client:
            client.sendall(HEAD + length + b"Transfer-Encoding: chunked\r\n\r\n")
            sent = 0
            with contextlib.suppress(ConnectionError):  # the server ends what does not end by itself
                for part in chunked(400_000_000):
                    client.sendall(part)
                    sent += len(part)
            assert status(read_all(client)) in (0, 400, 413)  # 0: overtaken by the end of the connection
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert sent < 50_000_000 and peak < 5_000_000


@pytest.mark.parametrize("start", [b"", b"Content-Length: 60000\r\n"])
def test_a_body_in_crumbs_is_cut(plain: Guarded, start: bytes) -> None:
    """Each chunk costs the same, however small; beside a wrong length they are not even a body."""
    began = time.monotonic()
    crumbs = HEAD + start + b"Transfer-Encoding: chunked\r\n\r\n" + b"1\r\nx\r\n" * 40_000
    assert status(plain.ask(crumbs)) in (0, 400)
    assert time.monotonic() - began < 2
    assert status(plain.ask(QUICK)) == 200


def test_too_few_files_make_room_like_too_many_connections(monkeypatch: pytest.MonkeyPatch) -> None:
    with guarded(ServerLimits()) as server, ExitStack() as held:
        for _ in range(3):
            held.enter_context(server.connect()).sendall(HEAD)
        assert wait_until(lambda: server.open_connections == 3)
        accept = socket.socket.accept

        def accept_few(listener: socket.socket) -> Any:
            if server.open_connections >= 3:
                raise OSError(errno.EMFILE, "too many open files")
            return accept(listener)

        monkeypatch.setattr(socket.socket, "accept", accept_few)
        assert [status(server.ask(QUICK)) for _ in range(3)] == [200] * 3


def test_who_sends_a_little_too_much_sees_why(plain: Guarded) -> None:
    """No matter whether the length was told: what was not read must not reset the connection."""
    body = b"x" * 300_000
    told = HEAD + b"Content-Length: %d\r\n\r\n" % len(body) + body
    untold = HEAD + b"Transfer-Encoding: chunked\r\n\r\n" + b"".join(chunked(300_000))
    for data in (told, untold):
        with plain.connect() as client:
            client.sendall(data)
            first = b""
            while b"}" not in first:
                first += client.recv(1000)
            assert status(first) == 413 and b"65536 bytes" in first
            client.sendall(HEAD + b"Content-Length: 0\r\nConnection: close\r\n\r\n")  # and may go on
            assert status(read_all(client)) == 200


@pytest.mark.parametrize(
    ("start", "answer"),
    [
        (b"", 0),
        (b"POST / HT", 408),
        (HEAD, 408),
        (HEAD + b"Content-Length: 9\r\n\r\n", 408),
        (HEAD + b"Transfer-Encoding: chunked\r\n\r\n5\r\nab", 408),
        (QUICK.replace(b"close", b"keep-alive"), 200),
    ],
)
@pytest.mark.parametrize("dribble", [False, True])
def test_who_does_not_finish_a_request_is_let_go(brief: Guarded, start: bytes, answer: int, dribble: bool) -> None:
    """However slowly bytes come: the time runs from the start of the head, or of the body."""
    began = time.monotonic()
    with brief.connect() as client:
        client.sendall(start)
        stop = threading.Event()

        def send_slowly() -> None:
            with contextlib.suppress(OSError):
                while start and not stop.wait(0.1):
                    client.send(b"1")

        sender = threading.Thread(target=send_slowly, daemon=True)
        if dribble:
            sender.start()
        try:
            answered = read_all(client)
        finally:
            stop.set()
    assert 0.4 < time.monotonic() - began < 6
    assert status(answered) in ((answer, 400) if dribble else (answer,))
    assert wait_until(lambda: brief.open_connections == 0)


def test_who_does_not_read_is_let_go(brief: Guarded) -> None:
    with brief.connect() as client:
        client.sendall(b"GET /much HTTP/1.1\r\nHost: x\r\n\r\n")
        assert wait_until(lambda: brief.open_connections == 1)
        assert wait_until(lambda: brief.open_connections == 0, 6)
        assert len(read_all(client)) < 8_000_000


def test_who_reads_slowly_but_steadily_gets_everything(brief: Guarded) -> None:
    with brief.connect() as client:
        client.sendall(b"GET /much HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n")
        got = 0
        while part := client.recv(200_000):
            got += len(part)
            time.sleep(0.02)
    assert got > 8_000_000


def test_a_client_that_leaves_is_noticed_even_behind_another_request(plain: Guarded) -> None:
    for more in (b"", QUICK, QUICK * 1000):
        plain.app.seen.clear()
        plain.app.cancelled.clear()
        with plain.connect() as client:
            client.sendall(b"GET /waits HTTP/1.1\r\nHost: x\r\n\r\n" + more)
            assert wait_until(lambda: ("/waits", b"") in plain.app.seen)
            assert not plain.app.cancelled.is_set()
        assert plain.app.cancelled.wait(5)


CHUNKED = b"Transfer-Encoding: chunked\r\n\r\n"


@pytest.mark.parametrize(
    ("first", "then", "answer"),
    [
        (HEAD + CHUNKED + b"oops\r\n", b"", 400),
        (HEAD + CHUNKED + b"1\r\na\r\n", b"oops\r\n", 400),
        (HEAD + b"Content-Length: 9\r\n" + CHUNKED + b"oops\r\n", b"", 400),  # refused twice over
        (HEAD + b"Content-Length: 9\r\n" + CHUNKED, b"oops\r\n", 400),  # after the answer
        (b"GET /much HTTP/1.1\r\nHost: x\r\n\r\n", b"oops\r\n\r\n", 200),  # during the answer
        (b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", b"oops\r\n\r\n", 200),  # instead of the next request
        (HEAD + b"Expect: 100-continue\r\n" + CHUNKED, b"oops\r\n", 100),
    ],
)
def test_what_is_no_http_is_refused_wherever_it_comes(
    plain: Guarded, first: bytes, then: bytes, answer: int, caplog: pytest.LogCaptureFixture
) -> None:
    with plain.connect() as client:
        client.sendall(first)
        time.sleep(0.1 if then else 0)
        with contextlib.suppress(ConnectionError):
            client.sendall(then)
        assert status(read_all(client)) == answer
    assert wait_until(lambda: plain.open_connections == 0)
    assert caplog.records == []


def test_what_was_not_foreseen_is_a_json_error_and_logged(plain: Guarded, caplog: pytest.LogCaptureFixture) -> None:
    answer = plain.ask(b"GET /fails HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n")
    assert status(answer) == 500 and b'{"error":"the server failed' in answer and b"purpose" not in answer
    assert [record.levelno for record in caplog.records] == [logging.ERROR]
    assert "ZeroDivisionError: on purpose" in caplog.text


@pytest.mark.parametrize(
    "data",
    [
        b"", b"\r\n", b"\x00" * 1000, b"GET", HEAD, HEAD + b"Content-Length: 9\r\n\r\n", b"GET / HTTP/9.9\r\n\r\n",
        HEAD + b"Content-Length: 9\r\n\r\nabc", HEAD + b"Transfer-Encoding: chunked\r\n\r\n5\r\nab",
        HEAD + b"Expect: 100-continue\r\nContent-Length: 9\r\n\r\n", QUICK, QUICK * 3, b"\x16\x03\x01" + bytes(300),
        b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", b"GET /much HTTP/1.1\r\nHost: x\r\n\r\n", b"GET / HTTP/1.0\r\n\r\n",
        b"CONNECT x:1 HTTP/1.1\r\nHost: x\r\n\r\nabc", b"GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\n"
        b"Connection: upgrade\r\n\r\nabc", b"GET /%00%ff HTTP/1.1\r\nHost: x\r\n\r\n",
        b"OPTIONS * HTTP/1.1\r\nHost: x\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: x\r\nX: \xff\xfe\r\n\r\n", b"HEAD / HTTP/1.1\r\nHost: x\r\n\r\n",
    ],
    ids=range(22),
)  # fmt: skip
def test_leaving_at_any_time_in_any_way_prints_nothing(
    plain: Guarded, data: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    for way in ("close", "half", "reset", "half and stay"):
        with plain.connect() as client:
            client.sendall(data)
            if way.startswith("half"):
                client.shutdown(socket.SHUT_WR)
            if way == "reset":
                client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
            if way == "half and stay":
                read_all(client)
    assert wait_until(lambda: plain.open_connections == 0)
    assert caplog.records == []
    assert status(plain.ask(QUICK)) == 200


STARTS = [
    b"%s %s HTTP/1.%d\r\nHost: x\r\n" % (method, path, minor)
    for method in (b"GET", b"HEAD", b"POST", b"CONNECT")
    for path in (b"/", b"/waits", b"/much", b"*")
    for minor in (0, 1)
]
PIECES = [
    b"\r\n", b"Content-Length: 5\r\n", b"Content-Length: 70000\r\n", b"Transfer-Encoding: chunked\r\n", b"abcde",
    b"\x00\xff", b"5\r\nabcde\r\n", b"0\r\n\r\n", b"0\r\nX: y\r\n\r\n", b"Expect: 100-continue\r\n", b"A" * 70_000,
    b"Connection: close\r\n", b"Upgrade: h2c\r\nConnection: Upgrade\r\n", b"X: y\r\n" * 50, b"\n" * 5000, *STARTS,
]  # fmt: skip


def test_any_bytes_and_any_end_print_nothing_and_leave_nothing(
    brief: Guarded, caplog: pytest.LogCaptureFixture
) -> None:
    chance = random.Random(23)
    for _ in range(10_000 if LONG else 400):
        with brief.connect() as client, contextlib.suppress(OSError):
            for _ in range(chance.randrange(1, 4)):
                client.sendall(chance.choice(STARTS) + b"".join(chance.choices(PIECES, k=chance.randrange(1, 7))))
                time.sleep(chance.choice((0, 0, 0.002)))
            end = chance.choice(("close", "half", "reset", "read"))
            if end == "half":
                client.shutdown(socket.SHUT_WR)
            elif end == "reset":
                client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
            elif end == "read":
                client.settimeout(0.02)
                client.recv(4096)
    assert wait_until(lambda: brief.open_connections == 0)
    assert wait_until(lambda: not brief.server.server_state.tasks)
    assert caplog.records == []
    assert status(brief.ask(QUICK)) == 200


SLOW = (
    b"",
    b"POST / HT",
    HEAD + b"X-Dribble: ",
    HEAD + b"Content-Length: 999\r\n\r\nab",
    HEAD + b"Transfer-Encoding: chunked\r\n\r\n5\r\nab",
    b"GET /much HTTP/1.1\r\nHost: x\r\n\r\n",  # and reads nothing
    QUICK.replace(b"close", b"keep-alive"),  # and asks nothing more
)


@pytest.mark.parametrize("limit", [ServerLimits().connections, 16], ids=["as shipped", "few connections"])
def test_a_crowd_of_slow_clients_holds_no_quick_one_up(limit: int, figure: Callable[[str], None]) -> None:
    """All at once: slow clients of every kind that never finish, and quick ones, each of which must be answered.

    Set KINEGRAPH_LONG=1 for 200 of each.
    """
    with guarded(ServerLimits(connections=limit)) as server, ExitStack() as held:
        clients = [held.enter_context(server.connect()) for _ in range(CROWD)]
        began = time.monotonic()

        def be_slow(number: int) -> None:
            with contextlib.suppress(ConnectionError):
                clients[number].sendall(SLOW[number % len(SLOW)])

        def be_quick(_: int) -> float:
            start = time.monotonic()
            assert status(server.ask(QUICK)) == 200
            return time.monotonic() - start

        with ThreadPoolExecutor(2 * CROWD) as threads:
            slow = [threads.submit(be_slow, number) for number in range(CROWD)]
            waits = sorted(threads.map(be_quick, range(CROWD)))
            for job in slow:
                job.result()
        assert time.monotonic() - began < ServerLimits().head_seconds  # none had to wait for a time limit
        assert server.open_connections <= limit
        # and the slow ones that are still there hold nobody up later either
        waits_later = sorted(be_quick(0) for _ in range(10))
    median, slowest, later = (1000 * wait for wait in (waits[len(waits) // 2], waits[-1], waits_later[-1]))
    figure(
        f"{CROWD} quick clients beside {CROWD} slow ones, {limit} connections: median {median:.0f} ms, slowest "
        f"{slowest:.0f} ms; alone beside the slow ones that are left {later:.0f} ms at most"
    )


def test_clients_who_are_served_are_not_ended_for_new_ones() -> None:
    with guarded(ServerLimits(connections=4)) as server, ExitStack() as held:
        waiting = [held.enter_context(server.connect()) for _ in range(4)]
        for client in waiting:
            client.sendall(b"GET /waits HTTP/1.1\r\nHost: x\r\n\r\n")
        assert wait_until(lambda: len(server.app.seen) == 4)
        with server.connect() as fifth:
            fifth.sendall(QUICK)
            time.sleep(0.5)
            assert server.open_connections == 4 and len(server.app.seen) == 4
            waiting.pop().close()
            assert status(read_all(fifth)) == 200
        assert server.open_connections >= 3
