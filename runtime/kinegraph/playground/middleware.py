"""ASGI middleware that admits requests of this machine's own pages, or those with a token.

A page of another site can make a browser send requests to this machine. It cannot send them with our Host, even by
DNS rebinding, nor with our Origin, nor as JSON without a CORS preflight request, which nothing here answers.
"""

from __future__ import annotations

import hmac
from collections.abc import Callable, Mapping
from typing import Final

from starlette.responses import JSONResponse

from kinegraph.playground.guards import App, Message, Receive, Scope, Send

REQUEST_KINDS: Final = (b"application/json", b"application/octet-stream")
"""Media types of requests: a page of another site may send neither without asking first."""
LOOPBACK_NAMES: Final = ("127.0.0.1", "localhost", "[::1]")

RESPONSE_HEADERS: Final = (
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
)


Refuse = Callable[[str, str, Mapping[bytes, bytes]], tuple[int, str] | None]
"""Method, path, headers -> status and message of a refusal; None admits the request."""


class GateMiddleware:
    """Middleware that admits some requests, and adds security headers to every response."""

    def __init__(self, app: App, refuse: Refuse) -> None:
        self._app, self._refuse = app, refuse

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers: dict[bytes, bytes] = dict(scope["headers"])

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message["headers"], *RESPONSE_HEADERS]
            await send(message)

        refusal = self._refuse(scope["method"], scope["path"], headers)
        if refusal is not None:
            await JSONResponse({"error": refusal[1]}, refusal[0])(scope, receive, send_with_headers)
            return
        await self._app(scope, receive, send_with_headers)


def only_loopback(port: int) -> Refuse:
    """Refuse requests from elsewhere than this machine."""
    hosts = frozenset(f"{name}:{port}" for name in LOOPBACK_NAMES)
    if port == 80:  # which browsers leave out
        hosts |= frozenset(LOOPBACK_NAMES)

    def refuse(method: str, path: str, headers: Mapping[bytes, bytes]) -> tuple[int, str] | None:
        if headers.get(b"host", b"").decode("latin-1").lower() not in hosts:
            return 421, f"this server answers as 127.0.0.1:{port} only"
        return refuse_other_pages(method, headers)

    return refuse


def only_token(token: str) -> Refuse:
    """Let other machines in: anybody gets the page, calls need `Authorization: Bearer TOKEN`.

    The page has the token from its link, behind `#`, which no server sees; another page does not have it.
    """
    expected = f"Bearer {token}".encode()

    def refuse(method: str, path: str, headers: Mapping[bytes, bytes]) -> tuple[int, str] | None:
        if path != "/" and not hmac.compare_digest(headers.get(b"authorization", b""), expected):
            return 401, "this page has no token, or an old one: open the link, or scan the code, of the terminal again"
        return refuse_other_pages(method, headers)

    return refuse


def refuse_other_pages(method: str, headers: Mapping[bytes, bytes]) -> tuple[int, str] | None:
    """Return status and message of a refusal of a request that another page may have sent; None admits it."""
    host = headers.get(b"host", b"").decode("latin-1").lower()
    origin = headers.get(b"origin")
    if origin is not None and origin.decode("latin-1").lower() != f"http://{host}":
        return 403, "another page may not ask this server"
    if method == "POST":
        if headers.get(b"sec-fetch-site", b"same-origin") != b"same-origin":
            return 403, "another page may not ask this server"
        if headers.get(b"content-type", b"").split(b";")[0].strip().lower() not in REQUEST_KINDS:
            return 415, "send JSON, with the header Content-Type: application/json"
    return None
