"""The server of the playground: its socket, its start and end, and the browser."""

from __future__ import annotations

import socket
import threading
import webbrowser
from collections.abc import Callable
from typing import Final

from kinegraph.errors import InvalidInputError, KinegraphError, OutputError
from kinegraph.pipeline import MotionPipeline
from kinegraph.playground.app import EXAMPLE, Playground, application
from kinegraph.playground.connections import GuardedServer
from kinegraph.playground.guards import ServerLimits

ADDRESS: Final = "127.0.0.1"


def listen(port: int) -> socket.socket:
    """Open a socket on loopback.

    Args:
        port: 0 takes any free port.

    Raises:
        InvalidInputError: the port is not 0 to 65535.
        OutputError: the port cannot be used, mostly because another program uses it.
    """
    if not 0 <= port <= 65535:
        raise InvalidInputError(f"port must be 0 to 65535, not {port}")
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((ADDRESS, port))
        listener.listen()  # from now on a browser that is faster than the server waits
    except OSError as error:
        listener.close()
        raise OutputError(
            f"port {port} cannot be used ({error.strerror}); choose another with --port, or 0 for any"
        ) from error
    return listener


def serve(pipeline: MotionPipeline, listener: socket.socket, on_start: Callable[[str], None]) -> None:
    """Serve until interrupted.

    Args:
        pipeline: a loaded bundle.
        listener: from `listen`.
        on_start: called with the address when the server is ready.
    """
    port = listener.getsockname()[1]
    server = Server(Playground(pipeline), port)
    warm_up(pipeline)
    on_start(f"http://{ADDRESS}:{port}/")
    server.run(sockets=[listener])


class Server(GuardedServer):
    """Server of a playground that cancels open streams when it shuts down; by itself it would wait for them."""

    def __init__(self, playground: Playground, port: int, limits: ServerLimits | None = None) -> None:
        self._playground = playground
        limits = limits or ServerLimits()
        super().__init__(application(playground, port, limits), limits)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._playground.stop()
        await super().shutdown(sockets)


def warm_up(pipeline: MotionPipeline) -> None:
    """Generate one short clip, so that the first request does not wait for spaCy or a lazy session."""
    try:
        shortest, _ = pipeline.manifest.seconds_limits
        pipeline.generate(EXAMPLE, seconds=shortest, steps=1, seed=0, on_level=lambda level, clip: None)
    except KinegraphError:
        return  # the page shows the same error with the first request


def open_browser(url: str) -> None:
    """Open the browser from a thread, because some browsers return only when they are closed."""
    threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()
