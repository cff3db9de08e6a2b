"""The web application of the service: five calls, a bounded queue, and the times of the stages."""

from __future__ import annotations

import asyncio
import base64
import json
import logging
import secrets
import threading
import time
from collections import deque
from collections.abc import AsyncGenerator, Callable
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route

from kinegraph import __version__
from kinegraph.clip import Clip
from kinegraph.diffusion.sampling import StepInfo
from kinegraph.errors import Cancelled, InvalidInputError, KinegraphError
from kinegraph.pipeline import MotionPipeline
from kinegraph.playground.app import EventStream, run_in_thread
from kinegraph.playground.fair_queue import FairQueue, TooBusyError
from kinegraph.playground.guards import UNEXPECTED, RequestGuard, ServerLimits, run_until_left
from kinegraph.playground.jobs import TookTooLongError, generate_clip
from kinegraph.playground.middleware import GateMiddleware, only_loopback
from kinegraph.playground.schemas import parse_json
from kinegraph.service.openapi import API_PAGE, openapi
from kinegraph.service.requests import MEDIA_TYPES, ServiceRequest, parse_request

logger = logging.getLogger(__name__)

STAGES: Final = ("queue", "generate", "encode")
KEPT_TIMES: Final = 1000
"""Latest clips over which p50 and p95 are taken."""
_STEP_PAUSE: Final = 0.04
"""Shortest time between two step events, seconds."""


class StageTimes:
    """Seconds that the stages of the latest clips took, and counts of answers; used from one event loop."""

    def __init__(self) -> None:
        self.seconds: dict[str, deque[float]] = {stage: deque(maxlen=KEPT_TIMES) for stage in STAGES}
        self.counts = dict.fromkeys(("made", "failed", "cancelled", "refused"), 0)

    def quantiles(self) -> dict[str, tuple[float, float]]:
        """Compute p50 and p95 in seconds of every stage that has run."""
        return {
            stage: (float(np.quantile(values, 0.5)), float(np.quantile(values, 0.95)))
            for stage, values in self.seconds.items()
            if values
        }

    def summary(self) -> str:
        """Format counts and times for a terminal."""
        times = (f"{stage} {1000 * a:.1f} / {1000 * b:.1f} ms" for stage, (a, b) in self.quantiles().items())
        counts = ", ".join(f"{count} {name}" for name, count in self.counts.items())
        return "; ".join([f"clips: {counts}", *(["p50 / p95: " + ", ".join(times)] if self.seconds["queue"] else [])])

    def prometheus(self, waiting: int) -> str:
        """Format them in Prometheus' text format."""
        lines = ["# TYPE kinegraph_clips_total counter"]
        lines += [f'kinegraph_clips_total{{result="{name}"}} {count}' for name, count in self.counts.items()]
        lines += ["# TYPE kinegraph_waiting gauge", f"kinegraph_waiting {waiting}"]
        lines.append("# TYPE kinegraph_stage_seconds summary")
        for stage, values in self.quantiles().items():
            lines += [
                f'kinegraph_stage_seconds{{stage="{stage}",quantile="{q}"}} {value:.6f}'
                for q, value in zip(("0.5", "0.95"), values, strict=True)
            ]
        return "\n".join(lines) + "\n"

    @contextmanager
    def counting(self) -> Any:
        """Count how the block ends."""
        try:
            yield
        except (Cancelled, asyncio.CancelledError):
            self.counts["cancelled"] += 1
            raise
        except TooBusyError:
            self.counts["refused"] += 1
            raise
        except Exception:
            self.counts["failed"] += 1
            raise
        self.counts["made"] += 1

    @contextmanager
    def counting_refusals(self) -> Any:
        """Count a request that cannot even wait."""
        try:
            yield
        except TooBusyError:
            self.counts["refused"] += 1
            raise


class Service:
    """Handlers of the calls, with the pipeline and the queue in front of it."""

    def __init__(self, pipeline: MotionPipeline, characters: Path | None = None) -> None:
        self.times = StageTimes()
        self._pipeline, self._characters = pipeline, characters
        self._queue = FairQueue()
        self._jobs: dict[str, asyncio.Task[None]] = {}

    def stop(self) -> None:
        """Cancel all streamed clips, at the end of the server."""
        for job in self._jobs.values():
            job.cancel()

    async def clips(self, request: Request) -> Response:
        """Make a clip: answer with its file, or with events where the client accepts `text/event-stream`."""
        wanted = parse_request(parse_json(await request.body()), self._characters)
        client = request.client.host if request.client else ""
        with self.times.counting_refusals():
            self._queue.check_room(client)
        if "text/event-stream" in request.headers.get("accept", ""):
            return EventStream(self._events(wanted, client), media_type="text/event-stream")
        made: list[dict[str, Any]] = []

        async def make() -> bytes:
            data, facts = await self._make(wanted, client, lambda _: None)
            made.append(facts)
            return data

        data = await run_until_left(make(), request.receive)
        headers = {f"Kinegraph-{name}": str(value) for name, value in made[0].items() if name != "notes"}
        return Response(data, media_type=MEDIA_TYPES[wanted.suffix], headers=headers)

    async def cancel(self, request: Request) -> Response:
        """Cancel a streamed clip."""
        job = self._jobs.get(request.path_params["clip"])
        if job is None:
            return JSONResponse({"error": "no clip of that id is being made"}, 404)
        job.cancel()
        return Response(status_code=204)

    async def words(self, request: Request) -> Response:
        """Answer with the actions and styles that the bundle was shown."""
        vocabulary, manifest = self._pipeline.vocabulary, self._pipeline.manifest
        record: dict[str, Any] = {"name": manifest.name, "version": manifest.version}
        for kind in ("action", "style"):
            phrases = () if vocabulary is None else vocabulary.facts.phrases
            record[f"{kind}s"] = [
                {"name": phrase.name, "example": phrase.example, "clips": phrase.clips}
                for phrase in phrases
                if phrase.kind == kind
            ]
        return JSONResponse(record)

    async def health(self, request: Request) -> Response:
        """Answer that the server is there, and with what."""
        manifest = self._pipeline.manifest
        bundle = f"{manifest.name} {manifest.version}"
        return JSONResponse({"status": "ok", "kinegraph": __version__, "bundle": bundle, "waiting": len(self._queue)})

    async def metrics(self, request: Request) -> Response:
        """Answer with counts and times in Prometheus' text format."""
        return PlainTextResponse(self.times.prometheus(len(self._queue)))

    async def openapi(self, request: Request) -> Response:
        """Answer with the OpenAPI description."""
        return JSONResponse(openapi())

    async def page(self, request: Request) -> Response:
        """Answer with the description as a page."""
        policy = "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'"
        return Response(API_PAGE, media_type="text/html; charset=utf-8", headers={"Content-Security-Policy": policy})

    async def _make(
        self, wanted: ServiceRequest, client: str, on_step: Callable[[StepInfo], None]
    ) -> tuple[bytes, dict[str, Any]]:
        """Wait for a turn, make the clip in a thread, and return its file and what is to be said of it."""
        asked = time.perf_counter()

        def work(stop: threading.Event) -> tuple[Clip, bytes, float, float, float]:
            start = time.perf_counter()

            def watch(info: StepInfo) -> bool:
                on_step(info)
                return not stop.is_set()

            clip = generate_clip(self._pipeline, wanted.clip, watch)
            generated = time.perf_counter()
            data, fps = wanted.encode(clip)
            return clip, data, fps, generated - start, time.perf_counter() - generated

        with self.times.counting():
            async with self._queue.turn(client):
                waited = time.perf_counter() - asked
                clip, data, fps, generating, encoding = await run_in_thread(work)
        for stage, seconds in zip(STAGES, (waited, generating, encoding), strict=True):
            self.times.seconds[stage].append(seconds)
        facts = {"seed": clip.seed, "seconds": round(clip.duration, 3), "fps": fps, "bundle": clip.bundle}
        facts |= {"unknown": len(clip.unknown), "notes": [*clip.notes]}
        return data, facts

    async def _events(self, wanted: ServiceRequest, client: str) -> AsyncGenerator[str]:
        """Make a clip and yield server-sent events: queued, step, and clip or error; closing it cancels the clip."""
        events: asyncio.Queue[tuple[str, dict[str, Any]] | None] = asyncio.Queue()
        name = secrets.token_hex(8)
        events.put_nowait(("queued", {"id": name, "ahead": self._queue.ahead(client)}))
        job = asyncio.create_task(self._run(wanted, client, events))
        self._jobs[name] = job
        job.add_done_callback(lambda _: self._jobs.pop(name, None))
        try:
            while (event := await events.get()) is not None:
                yield f"event: {event[0]}\ndata: {json.dumps(event[1])}\n\n"
        finally:
            job.cancel()

    async def _run(
        self, wanted: ServiceRequest, client: str, events: asyncio.Queue[tuple[str, dict[str, Any]] | None]
    ) -> None:
        """Make one streamed clip; None in `events` marks the end."""
        loop, last = asyncio.get_running_loop(), 0.0

        def on_step(info: StepInfo) -> None:
            nonlocal last
            if info.done == info.total or time.perf_counter() - last > _STEP_PAUSE:
                last = time.perf_counter()
                step = {key: getattr(info, key) for key in ("level", "step", "steps", "done", "total")}
                loop.call_soon_threadsafe(events.put_nowait, ("step", step))

        try:
            data, facts = await self._make(wanted, client, on_step)
            file = {"format": wanted.suffix[1:], "data": base64.b64encode(data).decode()}
            events.put_nowait(("clip", {**facts, **file}))
        except KinegraphError as error:
            events.put_nowait(("error", {"error": _sentence(error), "status": status_of(error)}))
        except asyncio.CancelledError:
            events.put_nowait(("error", {"error": "the clip was cancelled", "status": 499}))
            raise
        except BaseException:  # a panic of a library in Rust is no Exception
            logger.exception("the clip failed")
            events.put_nowait(("error", {"error": UNEXPECTED, "status": 500}))
        finally:
            loop.call_soon_threadsafe(events.put_nowait, None)  # behind the events of the thread


def status_of(error: Exception) -> int:
    """Choose the HTTP status of an error."""
    if isinstance(error, TooBusyError | TookTooLongError):
        return 503
    return 400 if isinstance(error, InvalidInputError) else 500


def _sentence(error: Exception) -> str:
    return " ".join(str(error).split())


async def _answer_error(request: Request, error: Exception) -> Response:
    """Answer a KinegraphError with a status and one sentence; `RequestGuard` answers any other exception."""
    status = status_of(error)
    return JSONResponse({"error": _sentence(error)}, status, {"Retry-After": "2"} if status == 503 else None)


async def _answer_unknown(request: Request, error: Exception) -> Response:
    status = getattr(error, "status_code", 500)
    return JSONResponse({"error": "there is no such call; see /v1/docs"}, status)


def application(service: Service, port: int, limits: ServerLimits, outermost: Middleware | None) -> Starlette:
    """Build the ASGI application.

    Args:
        service: the calls.
        port: of the server.
        limits: of a request.
        outermost: what admits requests from elsewhere, by token; None admits this machine's own alone.
    """
    routes = [
        Route("/", service.page),
        Route("/v1/docs", service.page),
        Route("/v1/openapi.json", service.openapi),
        Route("/v1/clips", service.clips, methods=["POST"]),
        Route("/v1/clips/{clip}", service.cancel, methods=["DELETE"]),
        Route("/v1/words", service.words),
        Route("/v1/health", service.health),
        Route("/v1/metrics", service.metrics),
    ]
    handlers: dict[Any, Any] = {KinegraphError: _answer_error, 404: _answer_unknown, 405: _answer_unknown}
    admit = outermost or Middleware(GateMiddleware, refuse=only_loopback(port))
    guards = [admit, Middleware(RequestGuard, limits=limits)]
    return Starlette(routes=routes, exception_handlers=handlers, middleware=guards)
