"""A bounded queue that serves the tabs of the browser in rotation, so that a busy tab starves no other."""

from __future__ import annotations

import asyncio
from collections import OrderedDict, deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Final

from kinegraph.errors import KinegraphError

MAX_WAITING: Final = 16
"""Waiting requests of all tabs together."""
MAX_PER_TAB: Final = 4
"""Waiting requests of one tab."""


class TooBusyError(KinegraphError):
    """The queue is full."""


class FairQueue:
    """Round-robin queue in which one request at a time has its turn.

    It belongs to one event loop; threads must not share it.
    """

    def __init__(self, max_waiting: int = MAX_WAITING, max_per_tab: int = MAX_PER_TAB) -> None:
        self._max_waiting, self._max_per_tab = max_waiting, max_per_tab
        self._waiting: OrderedDict[str, deque[asyncio.Future[None]]] = OrderedDict()
        """Tab -> its waiting requests, never empty; the first tab is served next."""
        self._busy = False
        """True while a request has its turn."""

    def __len__(self) -> int:
        """Count the waiting requests."""
        return sum(map(len, self._waiting.values()))

    def ahead(self, tab: str) -> int:
        """Count the turns before that of a new request of this tab, including the present turn."""
        waiting = len(self._waiting.get(tab, ()))
        others = sum(min(len(queue), waiting + 1) for name, queue in self._waiting.items() if name != tab)
        return self._busy + others + waiting

    def check_room(self, tab: str) -> None:
        """Refuse a request of this tab if it could not even wait.

        Raises:
            TooBusyError: too many requests are waiting, in total or in this tab.
        """
        if len(self) >= self._max_waiting or len(self._waiting.get(tab, ())) >= self._max_per_tab:
            raise TooBusyError(f"{len(self)} requests are waiting already; try again in a moment")

    @asynccontextmanager
    async def turn(self, tab: str) -> AsyncIterator[None]:
        """Wait for a turn and hold it for the block; a cancelled request leaves the queue.

        Raises:
            TooBusyError: as in `check_room`.
        """
        await self._wait(tab)
        try:
            yield
        finally:
            self._next()

    async def _wait(self, tab: str) -> None:
        if not self._busy:
            self._busy = True
            return
        self.check_room(tab)
        turn = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(tab, deque()).append(turn)
        try:
            await turn
        except asyncio.CancelledError:
            if turn.done() and not turn.cancelled():
                self._next()  # the turn had come already: pass it on
            else:
                self._leave(tab, turn)
            raise

    def _next(self) -> None:
        """Give the turn to the first tab, and move that tab behind all others."""
        while self._waiting:
            tab, queue = self._waiting.popitem(last=False)
            turn = queue.popleft()
            if queue:
                self._waiting[tab] = queue
            if not turn.done():  # otherwise cancelled, and its request has not run since
                turn.set_result(None)
                return
        self._busy = False

    def _leave(self, tab: str, turn: asyncio.Future[None]) -> None:
        queue = self._waiting.get(tab, deque())
        if turn not in queue:
            return  # passed over by `_next`
        queue.remove(turn)
        if not queue:
            del self._waiting[tab]
