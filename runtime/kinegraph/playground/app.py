"""The web application of the playground: the page, and six calls that store nothing."""

from __future__ import annotations

import asyncio
import json
import logging
import re
import threading
from collections.abc import AsyncGenerator, Callable
from typing import Any, Final, TypeVar

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from kinegraph.clip import Clip
from kinegraph.errors import InvalidInputError, KinegraphError
from kinegraph.formats.html import content_security_policy
from kinegraph.part_memory import PartMemory
from kinegraph.pipeline import MotionPipeline
from kinegraph.playground import page
from kinegraph.playground.drafts import Drafts
from kinegraph.playground.fair_queue import FairQueue, TooBusyError
from kinegraph.playground.guards import UNEXPECTED, Receive, RequestGuard, Scope, Send, ServerLimits, run_until_left
from kinegraph.playground.jobs import GenerationJob, TookTooLongError, generate_clip
from kinegraph.playground.middleware import GateMiddleware, only_loopback, only_token
from kinegraph.playground.schemas import (
    MAX_CHARACTER_LINE,
    ClipRequest,
    apply_edit,
    parse_caption,
    parse_character_request,
    parse_clip_request,
    parse_file_request,
    parse_graph,
    parse_json,
)

T = TypeVar("T")

logger = logging.getLogger(__name__)

CHARACTER_PATH: Final = "/api/character"
LIMITS: Final = ServerLimits(files={CHARACTER_PATH: page.CHARACTER_BYTES + MAX_CHARACTER_LINE})


class Playground:
    """Handlers of the page and the calls, with the pipeline and the queues in front of it."""

    def __init__(self, pipeline: MotionPipeline) -> None:
        self._pipeline = pipeline
        self._clip_queue, self._parse_queue = FairQueue(), FairQueue()
        self._jobs: set[asyncio.Task[None]] = set()
        self._memory, self._drafts = PartMemory(), Drafts()  # of one clip at a time, as the queue has it
        self._pages: dict[bool, bytes] = {}
        """The page, and the page that waits to be asked; empty until the first clip is made."""

    def stop(self) -> None:
        """Cancel all running jobs, at the end of the server."""
        for job in self._jobs:
            job.cancel()

    def prepare(self) -> None:
        """Make the clip that the page opens with, and the page; also loads what the first request needs."""
        self._pages = page.render_pages(self._pipeline)

    async def page(self, request: Request) -> Response:
        """Answer with the page.

        A page of another site may open this one with any link, and may not drive it: then it waits to be asked.
        """
        if not self._pages:
            async with self._clip_queue.turn(_tab(request)):
                if not self._pages:
                    await asyncio.to_thread(self.prepare)
        waits = request.headers.get("sec-fetch-site", "none") not in ("none", "same-origin")
        policy = f"{content_security_policy(page.CONNECT)}; frame-ancestors 'none'"
        return Response(
            self._pages[waits], media_type="text/html; charset=utf-8", headers={"Content-Security-Policy": policy}
        )

    async def parse(self, request: Request) -> Response:
        """Parse {text} and answer with its graph."""
        text = parse_caption(parse_json(await request.body()))
        async with self._parse_queue.turn(_tab(request)):
            graph = await asyncio.to_thread(self._pipeline.parse, text)
        return JSONResponse(graph.to_dict())

    async def unknown(self, request: Request) -> Response:
        """Find what the bundle was never shown in the sentence of {graph}, and answer with {unknown}."""
        graph = parse_graph(parse_json(await request.body()))
        async with self._parse_queue.turn(_tab(request)):
            unknown = await asyncio.to_thread(self._pipeline.find_unknown, graph)
        return JSONResponse({"unknown": [words.to_dict() for words in unknown]})

    async def edit(self, request: Request) -> Response:
        """Apply the edit of {graph, edit} and answer with the graph."""
        return JSONResponse(apply_edit(parse_json(await request.body())).to_dict())

    async def clip(self, request: Request) -> Response:
        """Generate a clip and answer with events as JSON lines: queued, graph, step, level, and draft, clip or error.

        A client that disconnects stops the generation.
        """
        clip_request = parse_clip_request(parse_json(await request.body()), drafts=True)
        tab = _tab(request)
        self._clip_queue.check_room(tab)
        return EventStream(self._events(clip_request, tab), media_type="application/x-ndjson")

    async def file(self, request: Request) -> Response:
        """Generate the clip of {wish, suffix, names, root, fps} and answer with the file that the command line writes.

        A client that disconnects stops the generation.
        """
        wanted = parse_file_request(parse_json(await request.body()), tuple(page.FILES))
        data = await self._make_file(request, wanted.clip, lambda clip: wanted.encode(clip)[0])
        return Response(data, media_type=page.FILES[wanted.suffix])

    async def character(self, request: Request) -> Response:
        """Generate a clip and answer with the character that came with the request, which makes it."""
        wanted = parse_character_request(await request.body())
        return Response(await self._make_file(request, wanted.clip, wanted.encode), media_type="model/gltf-binary")

    async def _make_file(self, request: Request, wanted: ClipRequest, encode: Callable[[Clip], bytes]) -> bytes:
        def make(stop: threading.Event) -> bytes:
            return encode(generate_clip(self._pipeline, wanted, lambda _: not stop.is_set(), memory=self._memory))

        async def make_in_turn() -> bytes:
            async with self._clip_queue.turn(_tab(request)):
                return await run_in_thread(make)

        return await run_until_left(make_in_turn(), request.receive)

    async def _events(self, clip_request: ClipRequest, tab: str) -> AsyncGenerator[str]:
        """Run a job and yield its events as lines; closing the iterator cancels the job."""
        events: asyncio.Queue[dict[str, Any] | None] = asyncio.Queue()
        job = asyncio.create_task(self._run_job(clip_request, tab, events))
        self._jobs.add(job)
        job.add_done_callback(self._jobs.discard)
        try:
            while (event := await events.get()) is not None:
                yield json.dumps(event, ensure_ascii=False) + "\n"
        finally:
            job.cancel()

    async def _run_job(self, clip_request: ClipRequest, tab: str, events: asyncio.Queue[dict[str, Any] | None]) -> None:
        """Wait for a turn and generate the clip; None in `events` marks the end."""
        loop = asyncio.get_running_loop()

        def send(event: dict[str, Any] | None) -> None:
            loop.call_soon_threadsafe(events.put_nowait, event)

        events.put_nowait({"event": "queued", "ahead": self._clip_queue.ahead(tab)})
        try:
            async with self._clip_queue.turn(tab):
                await run_in_thread(
                    lambda stop: GenerationJob(
                        self._pipeline, clip_request, send, stop, self._memory, self._drafts
                    ).run()
                )
        except KinegraphError as error:
            send({"event": "error", "message": str(error)})
        except asyncio.CancelledError:
            raise
        except BaseException:  # a panic of a library in Rust is no Exception
            logger.exception("the clip failed")
            send({"event": "error", "message": UNEXPECTED})
        finally:
            send(None)  # the same way as the events of the thread, and so behind them


class EventStream(StreamingResponse):
    """Stream that closes its iterator however it ends; by itself it may leave that to the garbage collector."""

    body_iterator: AsyncGenerator[str]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            await self.body_iterator.aclose()


async def run_in_thread(work: Callable[[threading.Event], T]) -> T:
    """Run `work(stop)` in a thread; on cancellation set `stop` and wait until the thread has ended."""
    stop = threading.Event()
    task = asyncio.ensure_future(asyncio.to_thread(work, stop))
    try:
        return await asyncio.shield(task)
    except asyncio.CancelledError:
        stop.set()
        await asyncio.gather(task, return_exceptions=True)
        raise


def _tab(request: Request) -> str:
    """Return the name that a tab of the browser gives itself; it only decides whose turn comes next."""
    name = request.headers.get("kinegraph-tab", "")
    return name if re.fullmatch(r"[\w-]{1,40}", name) else ""


async def _answer_error(request: Request, error: Exception) -> Response:
    """Answer a KinegraphError with a status and one sentence; `RequestGuard` answers any other exception."""
    busy = isinstance(error, TooBusyError | TookTooLongError)
    status = 503 if busy else 400 if isinstance(error, InvalidInputError) else 500
    headers = {"Retry-After": "2"} if status == 503 else None
    return JSONResponse({"error": " ".join(str(error).split())}, status, headers)


async def _answer_unknown(request: Request, error: Exception) -> Response:
    """Answer a wrong path or method."""
    status = getattr(error, "status_code", 500)
    return JSONResponse({"error": {404: "there is no such page", 405: "not that way"}.get(status, "failed")}, status)


def application(playground: Playground, port: int, limits: ServerLimits, token: str | None = None) -> Starlette:
    """Build the ASGI application of a playground, behind its middleware.

    Args:
        playground: the page and the calls.
        port: of the server.
        limits: of a request.
        token: that calls must send; None admits this machine's own page alone.
    """
    routes = [Route("/", playground.page)]
    for name in ("parse", "unknown", "edit", "clip", "file", "character"):
        routes.append(Route(f"/api/{name}", getattr(playground, name), methods=["POST"]))
    handlers: dict[Any, Any] = {KinegraphError: _answer_error, 404: _answer_unknown, 405: _answer_unknown}
    gate = Middleware(GateMiddleware, refuse=only_loopback(port) if token is None else only_token(token))
    guards = [gate, Middleware(RequestGuard, limits=limits)]
    return Starlette(routes=routes, exception_handlers=handlers, middleware=guards)
