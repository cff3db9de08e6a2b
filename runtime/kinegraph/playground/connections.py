"""Connections of uvicorn that do not wait for ever, and are bounded in number with room for a quick client.

uvicorn calls an application only when a head is complete, and counts no time until then. So what concerns heads and
the number of connections is kept here, below the middleware. At any moment a connection either keeps the server
waiting (for a head, a body, or for the client to read) or is being served. Only the waiting ones may be ended.
"""

from __future__ import annotations

import asyncio
import errno
import math
import socket
from collections.abc import Callable
from typing import Any, Final

import h11
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from kinegraph.playground.guards import ServerLimits

CHECK_SECONDS: Final = 0.25
"""Time between two looks at a connection that keeps the server waiting."""
LINGER_SECONDS: Final = 2.0
"""Time beyond that of its body in which a client may finish sending what is not read, so that it sees the answer."""
MOST_FRAMING: Final = 16
"""So many times the limit of a body may come for one request, read or not; beyond it the connection is cut."""
MOST_LINES: Final = 4096
"""Lines of one request on the wire. A chunk has two: a body in chunks of one byte costs 10 microseconds a byte.

A body of known length is not cut into lines, so those of a file do not count.
"""

FIRST_SECONDS: Final = 0.1
"""Time that each new client has to ask, however many others wait."""
ROOM_SECONDS: Final = 0.02
"""Time between two looks for room, when there is none."""
BACKLOG: Final = 1024
"""Connections that the operating system holds meanwhile; who comes beyond them tries again after a second."""


class GuardedServer(uvicorn.Server):
    """uvicorn server of one process whose connections are guarded: no reload, no name resolution, no request log.

    It is run with sockets that listen, `run(sockets=...)`. The application needs `RequestGuard` in front of it.
    """

    on_ready: Callable[[], None] | None = None
    """Called once connections are accepted and Ctrl+C ends the server: told before, an interrupt may be lost."""

    def __init__(self, app: Any, limits: ServerLimits) -> None:
        self._limits = limits
        self._accepting: list[asyncio.Task[None]] = []
        super().__init__(
            uvicorn.Config(
                app,
                http=GuardedProtocol,
                h11_max_incomplete_event_size=limits.head,
                loop="asyncio",
                ws="none",
                log_level="error",
                access_log=False,
                server_header=False,
                proxy_headers=False,
                timeout_graceful_shutdown=2,
                # `limit_concurrency` stays off: it counts slow clients too, and then refuses the quick ones.
            )
        )

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start to accept connections.

        Args:
            sockets: listening already, at least one.
        """
        # asyncio's own servers accept whatever comes; without sockets uvicorn makes none of them
        await super().startup([])
        self._accepting = [asyncio.create_task(self._accept(listener)) for listener in sockets or ()]
        if self.on_ready is not None:
            self.on_ready()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Accept no more, and end."""
        for task in self._accepting:
            task.cancel()
        await asyncio.gather(*self._accepting, return_exceptions=True)
        await super().shutdown(sockets)

    async def _accept(self, listener: socket.socket) -> None:
        """Accept one connection after another while there is room; the others wait in the operating system."""
        loop = asyncio.get_running_loop()
        listener.listen(BACKLOG)
        listener.setblocking(False)
        while True:
            await self._wait_for_room()
            try:
                connection, _ = await loop.sock_accept(listener)
                await loop.connect_accepted_socket(self._new_protocol, connection)
            except OSError as error:  # the client has left again, or there are too many open files for one more
                if error.errno in (errno.EMFILE, errno.ENFILE):
                    self._end_longest()
                await asyncio.sleep(ROOM_SECONDS)

    def _new_protocol(self) -> asyncio.Protocol:
        state, lifespan = self.server_state, self.lifespan.state
        return GuardedProtocol(self.config, state, lifespan, limits=self._limits)

    async def _wait_for_room(self) -> None:
        """Wait until one more connection fits; the one that has kept the server waiting longest may be ended for it."""
        while len(self.server_state.connections) >= self._limits.connections:
            if not self._end_longest():
                await asyncio.sleep(ROOM_SECONDS)

    def _end_longest(self) -> bool:
        """End the connection that has kept the server waiting longest, unless it is quite new; return whether."""
        connections: set[Any] = self.server_state.connections
        longest = min(connections, key=lambda other: other.waiting_since, default=None)
        if longest is None or longest.loop.time() - longest.waiting_since <= FIRST_SECONDS:
            return False
        longest.drop()
        return True


class GuardedProtocol(H11Protocol):
    """uvicorn's HTTP connection with time limits."""

    def __init__(self, *args: Any, limits: ServerLimits, **options: Any) -> None:
        super().__init__(*args, **options)
        self._limits = limits
        self._awaited: tuple[object, str] | None = None
        """Request, and what of it the server waits for; None while the request is served."""
        self._since = 0.0
        """Loop time at which that began."""
        self._bytes = self._lines = 0
        """Received since then."""
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for a head."""
        super().connection_made(transport)
        self._follow()
        self._timer = self.loop.call_later(CHECK_SECONDS, self._check)

    def data_received(self, data: bytes) -> None:
        """Take a part of a request; what comes before the present one is answered is dropped.

        Dropped requests are to be sent again on another connection (RFC 9112, 9.3.2). Kept, they would stop reading,
        and so hide that the client leaves.
        """
        self._follow()
        if self._awaited is None:
            self.cycle.keep_alive = False
            return
        self._bytes += len(data)
        self._lines += 0 if self._has_length() else data.count(b"\n")
        if (
            self._bytes > max(MOST_FRAMING * self._limits.body, 2 * self._limits.longest_body)
            or self._lines > MOST_LINES
        ):
            self.drop()
            return
        super().data_received(data)
        self._follow()
        if self._awaited is None and self.conn.trailing_data[0]:
            self.cycle.keep_alive = False
            self.flow.resume_reading()

    def on_response_complete(self) -> None:
        """Begin to wait for the next request."""
        super().on_response_complete()
        self._follow()

    def pause_writing(self) -> None:
        """Begin to wait for the client to read."""
        super().pause_writing()
        self._follow()

    def resume_writing(self) -> None:
        """Go on when the client has read."""
        super().resume_writing()
        self._follow()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop to look at the connection."""
        if self._timer is not None:
            self._timer.cancel()
        super().connection_lost(exc)

    def send_400_response(self, msg: str) -> None:
        """Refuse what is no HTTP, and stop what the request began; behind an answer that has begun only end."""
        if self.cycle is not None:
            self.cycle.disconnected = True
            self.cycle.message_event.set()
        if self.conn.our_state in (h11.IDLE, h11.SEND_RESPONSE):
            super().send_400_response(msg)
        else:
            self.drop()

    def shutdown(self) -> None:
        """End at the end of the server; only a request that is being served is waited for."""
        self._follow()
        if self._awaited is None:
            super().shutdown()
        else:
            self.drop()

    @property
    def waiting_since(self) -> float:
        """Loop time since which the client has kept the server waiting; infinity while the request is served."""
        return self._since if self._awaited is not None else math.inf

    def drop(self) -> None:
        """End at once, whatever is unsent."""
        self.connections.discard(self)  # no longer counts; uvicorn discards it later
        self.transport.abort()

    def _follow(self) -> None:
        """Note what the server waits for, and since when."""
        awaited = self._what_is_awaited()
        if awaited != self._awaited:
            self._awaited, self._since = awaited, self.loop.time()
            self._bytes = self._lines = 0

    def _has_length(self) -> bool:
        """Tell whether a body of known length is awaited."""
        is_body = self._awaited is not None and self._awaited[1] == "body"
        return is_body and any(name == b"content-length" for name, _ in self.headers)

    def _what_is_awaited(self) -> tuple[object, str] | None:
        if self.transport.is_closing() or self.flow.write_paused:
            return self.cycle, "reader"
        if self.cycle is None:
            return None, "head"
        if self.conn.their_state is h11.SEND_BODY:
            return self.cycle, "body"  # or its rest, which nobody reads, after the answer
        return (self.cycle, "head") if self.cycle.response_complete else None

    def _check(self) -> None:
        """End the connection if the client has kept the server waiting too long; look again later otherwise."""
        self._timer = self.loop.call_later(CHECK_SECONDS, self._check)
        self._follow()
        if self._awaited is None:
            return
        limits, kind = self._limits, self._awaited[1]
        longest = {
            "head": limits.head_seconds,
            "body": limits.body_seconds + LINGER_SECONDS,
            "reader": limits.write_seconds,
        }[kind]
        if self.loop.time() - self._since <= longest:
            return
        if kind == "head" and self.conn.trailing_data[0]:
            self._refuse_head()
        else:
            self.drop()

    def _refuse_head(self) -> None:
        """Answer a head that is not complete, and close."""
        if self.conn.our_state is not h11.IDLE:
            self.drop()
            return
        headers = [(b"connection", b"close"), (b"content-length", b"0")]
        response = h11.Response(status_code=408, headers=headers, reason=b"Request Timeout")
        self.transport.write((self.conn.send(response) or b"") + (self.conn.send(h11.EndOfMessage()) or b""))
        self.transport.close()
