"""What may be asked: the page, and four calls that keep no state."""

from __future__ import annotations

import asyncio
import json
import re
import threading
from collections.abc import AsyncIterator, Callable
from typing import Any, Final, TypeVar

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from kinegraph.bundle.contract import AGD_DENOISERS
from kinegraph.concepts import DEFAULT_LAMBDAS
from kinegraph.errors import InvalidInputError, KinegraphError
from kinegraph.formats import NAMED, encode
from kinegraph.formats.html import content_security_policy, render_page
from kinegraph.graph import ARGUMENT_ROLES
from kinegraph.pipeline import MotionPipeline
from kinegraph.playground.fair_queue import FairQueue, TooBusyError
from kinegraph.playground.jobs import GenerationJob, generate_clip
from kinegraph.playground.middleware import LoopbackOnlyMiddleware
from kinegraph.playground.schemas import ClipRequest, caption_of, clip_request, edited_graph, parse_json

T = TypeVar("T")

FILES: Final = {
    ".bvh": "text/plain; charset=us-ascii",
    ".glb": "model/gltf-binary",
    ".npz": "application/zip",
    ".html": "text/html; charset=utf-8",
}
"""What a clip may be fetched as."""

CONNECT: Final = "'self'"
EXAMPLE: Final = "a person walks forward and waves the right hand"


class Playground:
    """The handlers and what they share: the pipeline, and the queues in front of it."""

    def __init__(self, pipeline: MotionPipeline) -> None:
        self._pipeline = pipeline
        self._clips, self._parses = FairQueue(), FairQueue()
        self._made: set[asyncio.Task[None]] = set()
        self._page = render_page("kinegraph", {"play": _facts(pipeline)}, CONNECT)

    def stop(self) -> None:
        """End what is being made, at the end of the server."""
        for task in self._made:
            task.cancel()

    async def page(self, request: Request) -> Response:
        own = {"Content-Security-Policy": f"{content_security_policy(CONNECT)}; frame-ancestors 'none'"}
        return Response(self._page, media_type="text/html; charset=utf-8", headers=own)

    async def parse(self, request: Request) -> Response:
        """{text} -> its graph."""
        text = caption_of(parse_json(await request.body()))
        async with self._parses.turn(_tab(request)):
            graph = await asyncio.to_thread(self._pipeline.parse, text)
        return JSONResponse(graph.to_dict())

    async def edit(self, request: Request) -> Response:
        """{graph, edit} -> the graph after the edit."""
        return JSONResponse(edited_graph(parse_json(await request.body())).to_dict())

    async def clip(self, request: Request) -> Response:
        """A wish -> events as JSON lines: queued, graph, step, level, clip or error; a reader who leaves stops it."""
        wish, tab = clip_request(parse_json(await request.body())), _tab(request)
        self._clips.check_room(tab)
        return StreamingResponse(self._events(wish, tab), media_type="application/x-ndjson")

    async def file(self, request: Request) -> Response:
        """{wish, suffix, names} -> the file, as the command line writes it."""
        asked = parse_json(await request.body())
        suffix, names = asked.get("suffix"), asked.get("names", "smpl")
        if not isinstance(suffix, str) or suffix not in FILES:
            raise InvalidInputError(f"suffix must be one of {', '.join(FILES)}, not {str(suffix)[:40]!r}")
        if not isinstance(asked.get("wish"), dict):
            raise InvalidInputError("wish must be a JSON object")
        wish = clip_request(asked["wish"])
        if "seed" not in wish.sampling:
            raise InvalidInputError("a file needs the seed of its clip: without one it would be another clip")

        def made(stop: threading.Event) -> bytes:
            return encode(generate_clip(self._pipeline, wish, lambda _: not stop.is_set()), suffix, str(names))

        async with self._clips.turn(_tab(request)):
            data = await _in_thread(made)
        return Response(data, media_type=FILES[suffix])

    async def _events(self, wish: ClipRequest, tab: str) -> AsyncIterator[str]:
        events: asyncio.Queue[dict[str, Any] | None] = asyncio.Queue()
        task = asyncio.create_task(self._make(wish, tab, events))
        self._made.add(task)
        task.add_done_callback(self._made.discard)
        try:
            while (event := await events.get()) is not None:
                yield json.dumps(event, ensure_ascii=False) + "\n"
        finally:
            task.cancel()

    async def _make(self, wish: ClipRequest, tab: str, events: asyncio.Queue[dict[str, Any] | None]) -> None:
        loop = asyncio.get_running_loop()

        def tell(event: dict[str, Any] | None) -> None:
            loop.call_soon_threadsafe(events.put_nowait, event)

        events.put_nowait({"event": "queued", "ahead": self._clips.ahead(tab)})
        try:
            async with self._clips.turn(tab):
                await _in_thread(lambda stop: GenerationJob(self._pipeline, wish, tell, stop).run())
        except KinegraphError as error:
            tell({"event": "error", "message": str(error)})
        finally:
            tell(None)  # behind the events of the thread, which come the same way


async def _in_thread(make: Callable[[threading.Event], T]) -> T:
    """Run `generate_clip(stop)` in a thread. Cancelled, it sets `stop` and waits until the thread has heeded it."""
    stop = threading.Event()
    task = asyncio.ensure_future(asyncio.to_thread(make, stop))
    try:
        return await asyncio.shield(task)
    except asyncio.CancelledError:
        stop.set()
        await asyncio.gather(task, return_exceptions=True)
        raise


def _tab(request: Request) -> str:
    """Which tab asks: a name it gives itself, which counts for nothing but its turn."""
    name = request.headers.get("kinegraph-tab", "")
    return name if re.fullmatch(r"[\w-]{1,40}", name) else ""


def _facts(pipeline: MotionPipeline) -> dict[str, Any]:
    """What the page must know of the bundle."""
    manifest = pipeline.manifest
    return {
        "bundle": f"{manifest.name} {manifest.version}",
        "seconds": manifest.seconds_limits,
        "steps": dict(manifest.defaults.steps),
        "guidance": dict(manifest.defaults.guidance),
        "lambdas": DEFAULT_LAMBDAS,
        "agd": manifest.contracts.keys() >= set(AGD_DENOISERS.values()),
        "roles": list(ARGUMENT_ROLES),
        "files": list(FILES),
        "named": sorted(NAMED),
        "example": EXAMPLE,
    }


async def _refused(request: Request, error: Exception) -> Response:
    """Errors of ours as a status and one sentence; anything else ends as a bare 500."""
    status = 503 if isinstance(error, TooBusyError) else 400 if isinstance(error, InvalidInputError) else 500
    headers = {"Retry-After": "2"} if status == 503 else None
    return JSONResponse({"error": " ".join(str(error).split())}, status, headers)


async def _unknown(request: Request, error: Exception) -> Response:
    status = getattr(error, "status_code", 500)
    return JSONResponse({"error": {404: "there is no such page", 405: "not that way"}.get(status, "failed")}, status)


def application(own: Playground, port: int) -> LoopbackOnlyMiddleware:
    """The ASGI application, behind its guard."""
    routes = [Route("/", own.page)]
    for name in ("parse", "edit", "clip", "file"):
        routes.append(Route(f"/api/{name}", getattr(own, name), methods=["POST"]))
    handlers: dict[Any, Any] = {KinegraphError: _refused, 404: _unknown, 405: _unknown}
    return LoopbackOnlyMiddleware(Starlette(routes=routes, exception_handlers=handlers), port)
