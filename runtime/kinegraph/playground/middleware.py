"""ASGI middleware that admits only requests of this machine's own pages.

A page of another site can make a browser send requests to this machine. It cannot send them with our Host, even by
DNS rebinding, nor with our Origin, nor as JSON without a CORS preflight request, which nothing here answers.
"""

from __future__ import annotations

from typing import Final

from starlette.responses import JSONResponse

from kinegraph.playground.guards import App, Message, Receive, Scope, Send

LOOPBACK_NAMES: Final = ("127.0.0.1", "localhost", "[::1]")

RESPONSE_HEADERS: Final = (
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
)


class LoopbackOnlyMiddleware:
    """Middleware that refuses requests from elsewhere, and adds security headers to every response."""

    def __init__(self, app: App, port: int) -> None:
        self._app = app
        self._hosts = frozenset(f"{name}:{port}" for name in LOOPBACK_NAMES)
        self._port = port

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers: dict[bytes, bytes] = dict(scope["headers"])

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message["headers"], *RESPONSE_HEADERS]
            await send(message)

        refusal = self._refusal(scope["method"], headers)
        if refusal is not None:
            await JSONResponse({"error": refusal[1]}, refusal[0])(scope, receive, send_with_headers)
            return
        await self._app(scope, receive, send_with_headers)

    def _refusal(self, method: str, headers: dict[bytes, bytes]) -> tuple[int, str] | None:
        """Return status and message of a refusal; None admits the request."""
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
        return None
