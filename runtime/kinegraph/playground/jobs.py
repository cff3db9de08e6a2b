"""Generation of one requested clip, in a thread of its own: events on the way, the clip, and the time of each stage."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Final

from kinegraph.clip import Clip
from kinegraph.diffusion.sampling import OnStep, StepInfo
from kinegraph.errors import KinegraphError
from kinegraph.formats.html import clip_record
from kinegraph.graph import SemanticGraph
from kinegraph.part_memory import PartMemory
from kinegraph.pipeline import MotionPipeline, OnLevel
from kinegraph.playground.drafts import Drafts
from kinegraph.playground.schemas import ClipRequest
from kinegraph.timeline import generate_timeline

MAX_SECONDS: Final = 300.0
"""Time of one clip; meanwhile the others wait."""

SendEvent = Callable[[dict[str, Any]], None]
"""Takes one event; called from the thread that generates the clip."""

STEP_PAUSE: Final = 0.04
"""Shortest time between two step events, seconds; nobody would see them more often."""

STAGES: Final = {"motion": "text and motion", "action": "action", "specific": "specific", "constraints": "constraints"}
"""Level -> stage that ends with its last step; the text is encoded before the first step."""


class TookTooLongError(KinegraphError):
    """The clip took longer than the server gives one."""


def generate_clip(
    pipeline: MotionPipeline,
    request: ClipRequest,
    on_step: OnStep,
    on_level: OnLevel | None = None,
    memory: PartMemory | None = None,
    on_made: Callable[[Clip], None] | None = None,
) -> Clip:
    """Generate the clip of a request, equal to that of the command line for the same arguments.

    Args:
        pipeline: a loaded bundle.
        request: what is asked for.
        on_step, on_level: as in `MotionPipeline.generate`.
        memory: parts of sequences and timelines that need not be made again.
        on_made: called with the clip before it is looped or set in place.

    Raises:
        TookTooLongError: it took `MAX_SECONDS`.
        KinegraphError: as in `MotionPipeline.generate`, `compose` and `sequence`.
    """
    end = time.monotonic() + MAX_SECONDS

    def on_step_in_time(info: StepInfo) -> bool | None:
        if time.monotonic() > end:
            raise TookTooLongError(f"a clip may take {MAX_SECONDS:g} seconds; ask for fewer steps or concepts")
        return on_step(info)

    clip = _generate(pipeline, request, on_step_in_time, on_level, memory)
    if on_made is not None:
        on_made(clip)
    return shaped(clip, request)


def shaped(clip: Clip, request: ClipRequest) -> Clip:
    """Loop a clip and set it in place, as a request asks."""
    clip = clip.looped(foot_fix=request.foot_fix) if request.loop else clip
    return clip.in_place() if request.in_place else clip


def _generate(
    pipeline: MotionPipeline,
    request: ClipRequest,
    on_step: OnStep,
    on_level: OnLevel | None,
    memory: PartMemory | None,
) -> Clip:
    """Generate the clip as the pipeline makes it: neither looped nor in place."""
    sampling: dict[str, Any] = {
        name: getattr(request, name) for name in ("seconds", "seed", "steps", "guidance", "foot_fix")
    }
    sampling["on_step"] = on_step
    constraining: dict[str, Any] = {}
    if request.constraints:
        constraining = {"constraints": request.constraints, "constraint_weight": request.constraint_weight}
    if request.texts is not None:
        sampling |= {"seed_offsets": request.seed_offsets, "memory": memory}
        if request.constraints or request.layers:
            return generate_timeline(pipeline, request.texts, **sampling, **constraining, layers=request.layers)
        return pipeline.sequence(request.texts, **sampling)
    if request.concepts is None:
        return pipeline.generate(request.text or "", **sampling, **constraining, on_level=on_level)
    mixing = {name: getattr(request, name) for name in ("method", "text", "lambdas", "agd")}
    return pipeline.compose(request.concepts, **mixing, **sampling, **constraining, on_level=on_level)


@dataclass
class GenerationJob:
    """Generation of one clip that reports each step, level and stage as an event."""

    pipeline: MotionPipeline
    request: ClipRequest
    send: SendEvent
    stop: threading.Event
    """Set it to give up; checked after every diffusion step."""
    memory: PartMemory | None = None
    """Of parts; afterwards it tells which were made."""
    drafts: Drafts | None = None
    """Clips that are bent where the request asks for a draft; the clip that is made is kept there."""
    stages: dict[str, float] = field(default_factory=dict)
    """Stage -> milliseconds."""
    _stage_start: float = 0.0
    _last_step_event: float = 0.0

    def run(self) -> None:
        """Generate the clip, or bend a draft of it; the last event holds it, or none where there is nothing to bend.

        Raises:
            KinegraphError: as in `generate_clip`; `Cancelled` after `stop`.
        """
        self._stage_start = time.perf_counter()
        if self.request.draft:
            self._draft()
            return
        request = self.request
        if request.concepts is None and request.texts is None and not isinstance(request.text, SemanticGraph):
            graph = self.pipeline.parse(request.text or "")
            self._end_stage("parser")
            self.send({"event": "graph", "graph": graph.to_dict()})
            request = replace(request, text=graph)
        clip = generate_clip(self.pipeline, request, self._on_step, self._on_level, self.memory, self._keep)
        self._end_stage("decoder, feet")
        record = clip_record(clip)
        self._end_stage("body")
        stages = {name: round(milliseconds, 1) for name, milliseconds in self.stages.items()}
        event: dict[str, Any] = {"event": "clip", "clip": record, "stages": stages}
        if request.texts is not None and self.memory is not None:
            event["made"] = self.memory.made
        self.send(event)

    def _draft(self) -> None:
        clip = None if self.drafts is None else self.drafts.draft(self.request)
        if clip is not None:
            self.send({"event": "draft", "clip": {**clip_record(shaped(clip, self.request)), "level": "draft"}})

    def _keep(self, clip: Clip) -> None:
        if self.drafts is not None:
            self.drafts.keep(replace(self.request, seed=clip.seed), clip)

    def _on_step(self, info: StepInfo) -> bool:
        is_last = info.step == info.steps
        if is_last:
            self._end_stage(STAGES[info.level])
        now = time.perf_counter()
        if is_last or now - self._last_step_event > STEP_PAUSE:
            self._last_step_event = now
            keys = ("level", "step", "steps", "done", "total")
            self.send({"event": "step", **{key: getattr(info, key) for key in keys}})
        return not self.stop.is_set()

    def _on_level(self, level: str, clip: Clip) -> None:
        self.send({"event": "level", "level": level, "clip": {**clip_record(clip), "level": level}})
        self._end_stage("previews")

    def _end_stage(self, stage: str) -> None:
        """Add the time since the last stage ended to this one."""
        now = time.perf_counter()
        self.stages[stage] = self.stages.get(stage, 0.0) + 1000 * (now - self._stage_start)
        self._stage_start = now
