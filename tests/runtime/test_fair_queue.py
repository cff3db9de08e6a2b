"""The fair queue: one turn at a time, tabs in rotation, bounded, and no turn lost when waiting requests leave."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor

import pytest

pytest.importorskip("starlette")

from kinegraph.playground.fair_queue import FairQueue, TooBusyError


class Log:
    """Requests that hold a turn for a moment, and the order in which they had it."""

    def __init__(self, queue: FairQueue) -> None:
        self.queue = queue
        self.order: list[str] = []
        self.at_once = 0
        self._most_at_once = 0

    async def request(self, name: str) -> None:
        async with self.queue.turn(name[0]):
            self.at_once += 1
            self._most_at_once = max(self._most_at_once, self.at_once)
            self.order.append(name)
            try:
                await asyncio.sleep(0.001)
            finally:
                self.at_once -= 1
        assert self._most_at_once == 1


def run(body: Callable[[], Awaitable[None]]) -> None:
    """Run in a thread of its own, because a browser of another test keeps an event loop running in this one."""
    with ThreadPoolExecutor(1) as thread:
        thread.submit(lambda: asyncio.run(asyncio.wait_for(body(), 10))).result()  # type: ignore[arg-type]


async def started(log: Log, *names: str) -> list[asyncio.Task[None]]:
    tasks = []
    for name in names:
        tasks.append(asyncio.create_task(log.request(name)))
        await asyncio.sleep(0)
    return tasks


def test_tabs_take_turns_however_much_one_of_them_asks() -> None:
    async def body() -> None:
        log = Log(FairQueue())
        await asyncio.gather(*await started(log, "a1", "a2", "a3", "a4", "b1", "c1", "b2"))
        assert log.order == ["a1", "a2", "b1", "c1", "a3", "b2", "a4"]
        assert len(log.queue) == 0

    run(body)


def test_how_many_are_ahead_is_never_understated() -> None:
    async def body() -> None:
        log = Log(FairQueue())
        tasks = await started(log, "a1")
        assert log.queue.ahead("b") == 1
        tasks += await started(log, "a2", "a3", "c1")
        assert log.queue.ahead("b") == 3  # a1, then a2 and c1
        tasks += await started(log, "b1")
        await asyncio.gather(*tasks)
        assert log.order.index("b1") <= 3
        assert log.queue.ahead("b") == 0

    run(body)


def test_a_full_queue_says_so_and_goes_on() -> None:
    async def body() -> None:
        log = Log(FairQueue(max_waiting=3, max_per_tab=2))
        tasks = await started(log, "a1", "a2", "a3")
        with pytest.raises(TooBusyError, match="2 requests are waiting"):
            await log.request("a4")
        tasks += await started(log, "b1")
        with pytest.raises(TooBusyError, match="3 requests are waiting"):
            log.queue.check_room("c")
        await asyncio.gather(*tasks)
        assert log.order == ["a1", "a2", "b1", "a3"]
        await log.request("a5")

    run(body)


@pytest.mark.parametrize("leaves", ["a1", "a2", "b1", "b2"])
def test_whoever_leaves_holds_up_nobody(leaves: str) -> None:
    async def body() -> None:
        log = Log(FairQueue())
        names = ["a1", "a2", "b1", "b2"]
        tasks = await started(log, *names)
        tasks[names.index(leaves)].cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        assert {*log.order} | {leaves} == {*names}
        await log.request("c1")
        assert len(log.queue) == 0

    run(body)


@pytest.mark.parametrize("stays", ["a1", "a2", "b1", "b2", "none"])
def test_who_leave_at_the_same_moment_hold_up_nobody(stays: str) -> None:
    """The turn must not go to a request that is cancelled and has not run since."""

    async def body() -> None:
        log = Log(FairQueue())
        names = ["a1", "a2", "b1", "b2"]
        tasks = await started(log, *names)
        for name, task in zip(names, tasks, strict=True):
            if name != stays:
                task.cancel()
        results = await asyncio.gather(*tasks, return_exceptions=True)
        left = [isinstance(result, asyncio.CancelledError) for result in results]
        assert left == [name != stays for name in names]
        assert len(log.queue) == log.queue.ahead("c") == 0
        await log.request("c1")

    run(body)


def test_a_turn_that_came_to_one_who_just_left_passes_on() -> None:
    async def body() -> None:
        queue = FairQueue()
        first, second, third = (queue.turn(name) for name in "abc")
        await first.__aenter__()
        waits = asyncio.create_task(second.__aenter__())
        last = asyncio.create_task(third.__aenter__())
        await asyncio.sleep(0)
        await first.__aexit__(None, None, None)  # b's turn comes,
        waits.cancel()  # and b goes before it notices
        await last
        await third.__aexit__(None, None, None)
        async with queue.turn("d"):
            pass

    run(body)
