"""The socket, the browser, the end."""

from __future__ import annotations

import socket
import threading
import webbrowser
from collections.abc import Callable
from typing import Final

import uvicorn

from kinegraph.errors import InvalidInputError, KinegraphError, OutputError
from kinegraph.pipeline import MotionPipeline
from kinegraph.playground.app import EXAMPLE, Playground, application

ADDRESS: Final = "127.0.0.1"


def listen(port: int) -> socket.socket:
    """A socket on loopback; port 0 takes any that is free.

    Raises:
        InvalidInputError: no port has that number.
        OutputError: another program has it.
    """
    if not 0 <= port <= 65535:
        raise InvalidInputError(f"port must be 0 to 65535, not {port}")
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((ADDRESS, port))
        listener.listen()  # a browser that is quicker than the server waits
    except OSError as error:
        listener.close()
        raise OutputError(
            f"port {port} cannot be had ({error.strerror}); choose another with --port, or 0 for any"
        ) from error
    return listener


def serve(pipeline: MotionPipeline, listener: socket.socket, on_start: Callable[[str], None]) -> None:
    """Serve until interrupted; `on_start` is told the address once it answers."""
    port = listener.getsockname()[1]
    server = Server(Playground(pipeline), port)
    warm_up(pipeline)
    on_start(f"http://{ADDRESS}:{port}/")
    server.run(sockets=[listener])


class Server(uvicorn.Server):
    """uvicorn, which waits for the streams that are open; so they must end when it does."""

    def __init__(self, playground: Playground, port: int) -> None:
        self._playground = playground
        # Nothing that it can do without: one process, no reload, no lookup of names, no log of requests.
        super().__init__(
            uvicorn.Config(
                application(playground, port),
                log_level="error",
                access_log=False,
                server_header=False,
                proxy_headers=False,
                ws="none",
                limit_concurrency=64,
                timeout_graceful_shutdown=2,
            )
        )

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._playground.stop()
        await super().shutdown(sockets)


def warm_up(pipeline: MotionPipeline) -> None:
    """One short clip, so that the first one asked for does not wait for spaCy or a lazy session."""
    try:
        shortest, _ = pipeline.manifest.seconds_limits
        pipeline.generate(EXAMPLE, seconds=shortest, steps=1, seed=0, on_level=lambda level, clip: None)
    except KinegraphError:
        return  # whatever it is, the page tells it when it is asked


def open_browser(url: str) -> None:
    """In the background: some browsers only return when they are closed."""
    threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()
