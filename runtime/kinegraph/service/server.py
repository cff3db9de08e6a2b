"""The server of the service: its socket, its token, its start and end."""

from __future__ import annotations

import contextlib
import hmac
import socket
from collections.abc import Callable
from functools import partial
from pathlib import Path

from starlette.middleware import Middleware
from starlette.responses import JSONResponse

from kinegraph.pipeline import MotionPipeline
from kinegraph.playground.connections import GuardedServer
from kinegraph.playground.guards import App, Receive, Scope, Send, ServerLimits
from kinegraph.playground.server import ADDRESS, warm_up
from kinegraph.service.app import Service, application


class TokenMiddleware:
    """Middleware that admits requests with `Authorization: Bearer TOKEN`, and no page of a browser.

    `/v1/health` needs no token.
    """

    def __init__(self, app: App, token: str) -> None:
        self._app, self._expected = app, f"Bearer {token}".encode()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and scope["path"] != "/v1/health":
            headers: dict[bytes, bytes] = dict(scope["headers"])
            if b"origin" in headers:
                await JSONResponse({"error": "pages of a browser may not ask this server"}, 403)(scope, receive, send)
                return
            if not hmac.compare_digest(headers.get(b"authorization", b""), self._expected):
                wanted = {"WWW-Authenticate": "Bearer"}
                message = {"error": "send the token of this server: Authorization: Bearer TOKEN"}
                await JSONResponse(message, 401, wanted)(scope, receive, send)
                return
        await self._app(scope, receive, send)


def serve(
    pipeline: MotionPipeline,
    listener: socket.socket,
    token: str | None,
    characters: Path | None,
    on_start: Callable[[str], None],
) -> Service:
    """Serve until interrupted, and return the service with its times.

    Args:
        pipeline: a loaded bundle.
        listener: from `open_socket`.
        token: that requests must send; None admits this machine's own requests.
        characters: folder of characters that requests may name.
        on_start: called with the address when the server is ready.
    """
    host, port = listener.getsockname()[:2]
    service = Service(pipeline, characters)
    warm_up(pipeline)
    server = ServiceServer(service, port, token)
    server.on_ready = partial(on_start, f"http://{host if host != '0.0.0.0' else ADDRESS}:{port}/")
    with contextlib.suppress(KeyboardInterrupt):  # the normal end
        server.run(sockets=[listener])
    return service


class ServiceServer(GuardedServer):
    """Server that cancels streamed clips when it shuts down."""

    def __init__(
        self, service: Service, port: int, token: str | None = None, limits: ServerLimits | None = None
    ) -> None:
        self._service = service
        limits = limits or ServerLimits()
        outermost = None if token is None else Middleware(TokenMiddleware, token=token)
        super().__init__(application(service, port, limits, outermost), limits)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._service.stop()
        await super().shutdown(sockets)
