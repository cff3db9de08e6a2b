"""The server of the playground: its socket, its start and end, and the browser."""

from __future__ import annotations

import os
import secrets
import socket
import threading
import webbrowser
from collections.abc import Callable
from functools import partial
from typing import Final

from kinegraph.errors import InvalidInputError, KinegraphError, OutputError
from kinegraph.pipeline import MotionPipeline
from kinegraph.playground.app import LIMITS, Playground, application
from kinegraph.playground.connections import GuardedServer
from kinegraph.playground.guards import ServerLimits
from kinegraph.playground.page import EXAMPLE

ADDRESS: Final = "127.0.0.1"
SHORTEST_TOKEN: Final = 16
"""Characters."""
TOKEN_VARIABLE: Final = "KINEGRAPH_TOKEN"
"""Environment variable of the token: arguments of a program are seen by all users of a machine."""
ANY_ADDRESS: Final = "0.0.0.0"


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


def open_socket(host: str | None, port: int, token: str | None) -> socket.socket:
    """Open the socket of a service.

    Args:
        host: address to answer at; None is this machine alone.
        port: 0 takes any free port.
        token: that requests must send.

    Raises:
        InvalidInputError: another host without a token, a token that is too short, or no port.
        OutputError: the address cannot be used.
    """
    if token is not None and (len(token) < SHORTEST_TOKEN or not token.isascii() or not token.isprintable()):
        raise InvalidInputError(f"the token must have {SHORTEST_TOKEN} or more ASCII characters; openssl rand -hex 16")
    if host is None:
        return listen(port)
    if token is None:
        raise InvalidInputError(f"--host lets other machines in; give them a --token, or set {TOKEN_VARIABLE}")
    if not 0 <= port <= 65535:
        raise InvalidInputError(f"port must be 0 to 65535, not {port}")
    try:
        return socket.create_server((host, port), backlog=128)
    except (OSError, OverflowError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise OutputError(f"{host}:{port} cannot be used ({reason}); choose another --host or --port") from error


def listen_at(host: str | None, port: int, token: str | None) -> tuple[socket.socket, str | None]:
    """Open the socket of a playground, with its token: drawn, where other machines are let in and none is given.

    Raises:
        InvalidInputError, OutputError: as in `open_socket`.
    """
    token = token_of(token) if host is not None else None
    if host is not None and token is None:
        token = secrets.token_urlsafe(SHORTEST_TOKEN)
    return open_socket(host, port, token), token


def token_of(argument: str | None) -> str | None:
    """Return the token of the command line, or of the environment."""
    return argument if argument is not None else os.environ.get(TOKEN_VARIABLE) or None


def serve(
    pipeline: MotionPipeline, listener: socket.socket, on_start: Callable[[str], None], token: str | None = None
) -> None:
    """Serve until interrupted.

    Args:
        pipeline: a loaded bundle.
        listener: from `listen` or `open_socket`.
        on_start: called with the address when the server is ready; with a token, it is in the address.
        token: that the calls of the page must send; None admits this machine's own requests.
    """
    host, port = listener.getsockname()[:2]
    playground = Playground(pipeline)
    server = Server(playground, port, token=token)
    warm_up(pipeline)
    playground.prepare()
    url = f"http://{reachable_address(host)}:{port}/{'' if token is None else f'#token={token}'}"
    server.on_ready = partial(on_start, url)
    server.run(sockets=[listener])


def reachable_address(host: str) -> str:
    """Return the address at which other machines find a server that listens at `host`."""
    if host != ANY_ADDRESS:
        return host
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # of RFC 5737, for documents: nothing is sent, only a route is chosen
        except OSError:
            return ADDRESS
        return str(probe.getsockname()[0])


class Server(GuardedServer):
    """Server of a playground that cancels open streams when it shuts down; by itself it would wait for them."""

    def __init__(
        self, playground: Playground, port: int, limits: ServerLimits | None = None, token: str | None = None
    ) -> None:
        self._playground = playground
        limits = limits or LIMITS
        super().__init__(application(playground, port, limits, token), limits)

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
