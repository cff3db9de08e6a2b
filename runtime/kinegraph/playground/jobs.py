"""A wish made: events on the way, the clip, and how long each stage took. Runs in a thread of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Final

from kinegraph.clip import Clip
from kinegraph.diffusion.sampling import OnStep, StepInfo
from kinegraph.formats.html import clip_record
from kinegraph.graph import SemanticGraph
from kinegraph.pipeline import MotionPipeline, OnLevel
from kinegraph.playground.schemas import ClipRequest

Tell = Callable[[dict[str, Any]], None]
"""Takes one event; called from the thread that makes the clip."""

STEP_PAUSE: Final = 0.04
"""Seconds between two events of steps: more often nobody sees them."""

STAGES: Final = {"motion": "text and motion", "action": "action", "specific": "specific"}
"""Level -> what the time until its last step went into: sentences are encoded before the first."""


def generate_clip(
    pipeline: MotionPipeline, wish: ClipRequest, on_step: OnStep, on_level: OnLevel | None = None
) -> Clip:
    """The clip of a wish: what the command line makes of the same arguments.

    Raises:
        KinegraphError: as `MotionPipeline.generate` and `compose`.
    """
    if wish.concepts is not None:
        return pipeline.compose(wish.concepts, on_step=on_step, on_level=on_level, **wish.composing, **wish.sampling)
    return pipeline.generate(wish.text or "", on_step=on_step, on_level=on_level, **wish.sampling)


@dataclass
class GenerationJob:
    """One clip in the making, told step by step."""

    pipeline: MotionPipeline
    wish: ClipRequest
    tell: Tell
    stop: threading.Event
    """Set to give up; heeded after every diffusion step."""
    stages: dict[str, float] = field(default_factory=dict)
    """Stage -> milliseconds."""
    _since: float = 0.0
    _told: float = 0.0

    def run(self) -> None:
        """Make it; the last event holds the clip.

        Raises:
            KinegraphError: as `generate_clip`; `Cancelled` after `stop`.
        """
        self._since = time.perf_counter()
        wish = self.wish
        if wish.concepts is None and not isinstance(wish.text, SemanticGraph):
            graph = self.pipeline.parse(wish.text or "")
            self._lap("parser")
            self.tell({"event": "graph", "graph": graph.to_dict()})
            wish = replace(wish, text=graph)
        clip = generate_clip(self.pipeline, wish, self._step, self._level)
        self._lap("decoder, feet")
        shown = clip_record(clip)
        self._lap("body")
        self.tell({"event": "clip", "clip": shown, "stages": {name: round(ms, 1) for name, ms in self.stages.items()}})

    def _step(self, info: StepInfo) -> bool:
        last = info.step == info.steps
        if last:
            self._lap(STAGES[info.level])
        now = time.perf_counter()
        if last or now - self._told > STEP_PAUSE:
            self._told = now
            keys = ("level", "step", "steps", "done", "total")
            self.tell({"event": "step", **{key: getattr(info, key) for key in keys}})
        return not self.stop.is_set()

    def _level(self, level: str, clip: Clip) -> None:
        self.tell({"event": "level", "level": level, "clip": {**clip_record(clip), "level": level}})
        self._lap("previews")

    def _lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.stages[stage] = self.stages.get(stage, 0.0) + 1000 * (now - self._since)
        self._since = now
