"""Whose turn it is: a bounded queue that serves its tabs in rotation, so that a busy one starves nobody."""

from __future__ import annotations

import asyncio
from collections import OrderedDict, deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Final

from kinegraph.errors import KinegraphError

MAX_WAITING: Final = 16
"""Requests of all tabs together."""
MAX_PER_TAB: Final = 4


class TooBusyError(KinegraphError):
    """The queue is full."""


class FairQueue:
    """One turn at a time. Belongs to one event loop; nothing here is shared between threads."""

    def __init__(self, most: int = MAX_WAITING, per_tab: int = MAX_PER_TAB) -> None:
        self._most, self._per_tab = most, per_tab
        self._waiting: OrderedDict[str, deque[asyncio.Future[None]]] = OrderedDict()
        """Tabs in the order in which they are served next; none has an empty queue."""
        self._taken = False

    def __len__(self) -> int:
        return sum(map(len, self._waiting.values()))

    def ahead(self, tab: str) -> int:
        """Turns before the next one of a tab that asks now, the present one included."""
        own = len(self._waiting.get(tab, ()))
        return self._taken + sum(min(len(queue), own + 1) for name, queue in self._waiting.items() if name != tab) + own

    def check_room(self, tab: str) -> None:
        """Raise TooBusyError where a request of this tab could not even wait."""
        if len(self) >= self._most or len(self._waiting.get(tab, ())) >= self._per_tab:
            raise TooBusyError(f"{len(self)} requests are waiting already; try again in a moment")

    @asynccontextmanager
    async def turn(self, tab: str) -> AsyncIterator[None]:
        """Wait for a turn and keep it; whoever is cancelled while waiting leaves the queue.

        Raises:
            TooBusyError: too many wait already, all in all or in this tab.
        """
        await self._wait(tab)
        try:
            yield
        finally:
            self._next()

    async def _wait(self, tab: str) -> None:
        if not self._taken:
            self._taken = True
            return
        self.check_room(tab)
        called = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(tab, deque()).append(called)
        try:
            await called
        except asyncio.CancelledError:
            if called.done() and not called.cancelled():
                self._next()  # the turn had come, and passes on
            else:
                self._leave(tab, called)
            raise

    def _next(self) -> None:
        """Give the turn to the first tab, and put that tab behind all others."""
        if not self._waiting:
            self._taken = False
            return
        tab, queue = self._waiting.popitem(last=False)
        called = queue.popleft()
        if queue:
            self._waiting[tab] = queue
        called.set_result(None)

    def _leave(self, tab: str, called: asyncio.Future[None]) -> None:
        queue = self._waiting[tab]
        queue.remove(called)
        if not queue:
            del self._waiting[tab]
