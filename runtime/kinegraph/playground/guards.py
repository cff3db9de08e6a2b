"""Limits of a server on this machine, and the ASGI middleware that keeps those of one request.

`connections` keeps the limits of connections. Neither knows what is served: any ASGI application may stand behind.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Iterable, Mapping, MutableMapping
from dataclasses import dataclass, field
from typing import Any, Final

from starlette.responses import JSONResponse

from kinegraph.errors import Cancelled

Message = MutableMapping[str, Any]
Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

logger = logging.getLogger(__name__)

UNEXPECTED: Final = "the server failed; its terminal says why"
"""What a client is told of an error that nobody foresaw."""

SENT_ONCE: Final = frozenset(
    (b"host", b"origin", b"content-type", b"content-length", b"transfer-encoding", b"sec-fetch-site", b"authorization")
)
"""Headers that may come once: of two, one reader might heed the first and another the last."""

PIECE: Final = 64 * 1024
"""Bytes of an answer that are handed to the server at once; it takes the next piece when the client has read on."""


@dataclass(frozen=True)
class ServerLimits:
    """What one client may ask of a server."""

    body: int = 64 * 1024
    """Bytes of a request body; a graph of 32 nodes or 8 concepts of 512 characters fit several times."""
    files: Mapping[str, int] = field(default_factory=dict)
    """Path -> bytes of a request body that holds a file, where that may be more."""
    files_at_once: int = 2
    """Bodies with files that are held at once; one more is told to come again."""
    head: int = 16 * 1024
    """Bytes of the request line and the headers."""
    headers: int = 64
    """Number of headers."""
    head_seconds: float = 10.0
    """Time for a head, from the start of the connection or the end of the last answer."""
    body_seconds: float = 10.0
    """Time for a body, from the end of its head."""
    write_seconds: float = 30.0
    """Longest time in which a client reads nothing of what waits for it."""
    connections: int = 128
    """Open connections. One more ends the one that has kept the server waiting longest."""

    def body_of(self, path: str) -> int:
        """Return the bytes that a body sent to a path may have."""
        return self.files.get(path, self.body)

    @property
    def longest_body(self) -> int:
        """Bytes of the longest body that any path takes."""
        return max(self.body, *self.files.values(), 0)


class _BodyTooLargeError(Exception):
    """The body is longer than the limit."""


class _ClientLeftError(Exception):
    """The client left before its body was complete."""


class RequestGuard:
    """Middleware that reads the body itself, within its limits, and lets no error of the application through.

    The application gets the body as one message. Errors nobody foresaw are logged and answered as JSON.
    """

    def __init__(self, app: App, limits: ServerLimits) -> None:
        self._app, self._limits = app, limits
        self._files = 0
        """Requests with files that are being read or served."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        if scope["path"] not in self._limits.files:
            await self._guard(scope, receive, send)
            return
        if self._files >= self._limits.files_at_once:
            message = {"error": "other files are being read; try again in a moment"}
            await JSONResponse(message, 503, {"Retry-After": "2"})(scope, receive, send)
            return
        self._files += 1
        try:
            await self._guard(scope, receive, send)
        finally:
            self._files -= 1

    async def _guard(self, scope: Scope, receive: Receive, send: Send) -> None:
        refusal, body = self._refusal(scope), b""
        if refusal is None:
            try:
                async with asyncio.timeout(self._limits.body_seconds):
                    body = await _read_body(receive, self._limits.body_of(scope["path"]))
            except _ClientLeftError:
                return
            except _BodyTooLargeError:
                refusal = self._too_large(scope)
            except TimeoutError:
                refusal = 408, f"the body did not come within {self._limits.body_seconds:g} seconds"
        if refusal is not None:
            # The rest of a body that is too long is read and dropped (see `connections`): a client that is still
            # sending when its connection closes would never see the answer.
            headers = {"Connection": "close"} if refusal[0] == 408 else None
            await JSONResponse({"error": refusal[1]}, refusal[0], headers)(scope, receive, send)
            return
        await self._run(scope, _replay(body, receive), send)

    async def _run(self, scope: Scope, receive: Receive, send: Send) -> None:
        started = False

        async def send_in_pieces(message: Message) -> None:
            nonlocal started
            started = True
            body = message.get("body", b"")
            for start in range(0, len(body) - PIECE, PIECE):
                await send({"type": message["type"], "body": body[start : start + PIECE], "more_body": True})
                await asyncio.sleep(0)  # the server notices that the client left, and others have their turn
            if len(body) > PIECE:
                message = {**message, "body": body[(len(body) - 1) // PIECE * PIECE :]}
            await send(message)

        try:
            await self._app(scope, receive, send_in_pieces)
        except asyncio.CancelledError:
            raise
        except BaseException:  # a panic of a library in Rust is no Exception
            if started:
                raise  # the answer cannot be taken back: the server logs the error and closes the connection
            logger.exception("%s %s failed", scope["method"], scope["path"])
            await JSONResponse({"error": UNEXPECTED}, 500)(scope, receive, send)

    def _refusal(self, scope: Scope) -> tuple[int, str] | None:
        """Return status and message for a head that is not answered; None admits it."""
        if scope["method"] == "CONNECT":
            return 405, "this server is no proxy"
        headers: list[tuple[bytes, bytes]] = scope["headers"]
        size = len(scope.get("raw_path") or b"") + len(scope["query_string"]) + sum(len(a) + len(b) for a, b in headers)
        if len(headers) > self._limits.headers or size > self._limits.head:
            return 431, f"a request may have {self._limits.headers} headers and {self._limits.head} bytes of them"
        if repeated := _repeated(name for name, _ in headers):
            return 400, f"the header {repeated} may come once"
        named = dict(headers)
        if b"transfer-encoding" in named and b"content-length" in named:
            return 400, "a request has either Content-Length or Transfer-Encoding"
        length = named.get(b"content-length", b"0")
        if not length.isdigit():
            return 400, "Content-Length is not a number"
        if len(length) > 15 or int(length) > self._limits.body_of(scope["path"]):
            return self._too_large(scope)
        return None

    def _too_large(self, scope: Scope) -> tuple[int, str]:
        return 413, f"a request may have {self._limits.body_of(scope['path'])} bytes"


async def run_until_left(work: Awaitable[bytes], receive: Receive) -> bytes:
    """Await `work`, and cancel it when the client leaves.

    Args:
        work: what makes the answer.
        receive: of the request, whose body has been read.

    Raises:
        Cancelled: the client left; nobody will read the error.
    """

    async def wait_for_end() -> None:
        while (await receive())["type"] != "http.disconnect":
            pass

    job, end = asyncio.ensure_future(work), asyncio.ensure_future(wait_for_end())
    try:
        await asyncio.wait((job, end), return_when=asyncio.FIRST_COMPLETED)
        if job.done():
            return job.result()
        raise Cancelled("the client left")
    finally:
        for task in (job, end):
            task.cancel()
        await asyncio.gather(job, end, return_exceptions=True)


async def _read_body(receive: Receive, limit: int) -> bytes:
    body = bytearray()
    while True:
        message = await receive()
        if message["type"] == "http.disconnect":
            raise _ClientLeftError
        body += message.get("body", b"")
        if len(body) > limit:
            raise _BodyTooLargeError
        if not message.get("more_body", False):
            return bytes(body)


def _replay(body: bytes, receive: Receive) -> Receive:
    """Return a `receive` that gives the whole body first."""
    given = False

    async def receive_again() -> Message:
        nonlocal given
        if given:
            return await receive()
        given = True
        return {"type": "http.request", "body": body, "more_body": False}

    return receive_again


def _repeated(names: Iterable[bytes]) -> str | None:
    """Return a header that comes twice and may not."""
    seen: set[bytes] = set()
    for name in names:
        if name in SENT_ONCE and name in seen:
            return name.decode("ascii")
        seen.add(name)
    return None
