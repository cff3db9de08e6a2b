"""Who may ask, and how much: an ASGI layer in front of the application.

A page from elsewhere can make a browser send requests to this machine. It cannot send them with our Host (DNS
rebinding), nor with our Origin, nor as JSON without asking first, which nothing here answers.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any, Final

from starlette.responses import JSONResponse

Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[MutableMapping[str, Any], Receive, Send], Awaitable[None]]

NAMES: Final = ("127.0.0.1", "localhost", "[::1]")
MAX_BODY: Final = 64 * 1024
"""Bytes: a graph of 32 nodes or 8 concepts of 512 characters fit several times."""

HEADERS: Final = (
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
)


class LoopbackOnlyMiddleware:
    """Answers what must not reach the application itself."""

    def __init__(self, app: App, port: int) -> None:
        self._app = app
        self._hosts = frozenset(f"{name}:{port}" for name in NAMES)
        self._port = port

    async def __call__(self, scope: MutableMapping[str, Any], receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers: dict[bytes, bytes] = dict(scope["headers"])

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message["headers"], *HEADERS]
            await send(message)

        refusal = self._refusal(scope["method"], headers)
        if refusal is not None:
            await JSONResponse({"error": refusal[1]}, refusal[0])(scope, receive, send_with_headers)
            return
        await self._app(scope, receive, send_with_headers)

    def _refusal(self, method: str, headers: dict[bytes, bytes]) -> tuple[int, str] | None:
        """Status and message, or None for a request that may pass."""
        host = headers.get(b"host", b"").decode("latin-1").lower()
        if host not in self._hosts:
            return 421, f"this server answers as 127.0.0.1:{self._port} only"
        origin = headers.get(b"origin")
        if origin is not None and origin.decode("latin-1").lower() != f"http://{host}":
            return 403, "another page may not ask this server"
        if method == "POST":
            if headers.get(b"sec-fetch-site", b"same-origin") != b"same-origin":
                return 403, "another page may not ask this server"
            if headers.get(b"content-type", b"").split(b";")[0].strip().lower() != b"application/json":
                return 415, "send JSON, with the header Content-Type: application/json"
            length = headers.get(b"content-length", b"")
            if not length.isdigit():
                return 411, "the request must state its length"
            if len(length) > 9 or int(length) > MAX_BODY:
                return 413, f"a request may have {MAX_BODY} bytes"
        return None
