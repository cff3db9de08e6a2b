"""A wish made: events on the way, the clip, and how long each stage took. Runs in a thread of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

from kinegraph.diffusion.sampler import StepInfo
from kinegraph.formats.html import record
from kinegraph.graph import SemanticGraph
from kinegraph.motion.clip import Clip
from kinegraph.pipeline import MotionPipeline
from kinegraph.play.wishes import Wish

Tell = Callable[[dict[str, Any]], None]
"""Takes one event; called from the thread that makes the clip."""

STEP_PAUSE: Final = 0.04
"""Seconds between two events of steps: more often nobody sees them."""

STAGES: Final = {"motion": "text and motion", "action": "action", "specific": "specific"}
"""Level -> what the time until its last step went into: sentences are encoded before the first."""


@dataclass
class Making:
    """One clip in the making."""

    pipeline: MotionPipeline
    wish: Wish
    tell: Tell
    stop: threading.Event
    """Set to give up; heeded after every diffusion step."""
    stages: dict[str, float] = field(default_factory=dict)
    """Stage -> milliseconds."""
    _since: float = 0.0
    _told: float = 0.0

    def run(self) -> Clip:
        """The clip; its events have been told, the last one too.

        Raises:
            KinegraphError: as `MotionPipeline.generate` and `compose`; `Cancelled` after `stop`.
        """
        self._since = time.perf_counter()
        wish, step, level = self.wish, self._step, self._level
        if wish.concepts:
            clip = self.pipeline.compose(
                wish.concepts, method=wish.method, on_step=step, on_level=level, **wish.sampling
            )
        else:
            clip = self.pipeline.generate(self._graph(), on_step=step, on_level=level, **wish.sampling)
        self._lap("decoder, feet")
        body = record(clip)
        self._lap("body")
        self.tell({"event": "clip", "clip": body, "stages": {name: round(ms, 1) for name, ms in self.stages.items()}})
        return clip

    def _graph(self) -> SemanticGraph:
        text = self.wish.text
        if isinstance(text, SemanticGraph):
            return text
        graph = self.pipeline.parse(text or "")
        self._lap("parser")
        self.tell({"event": "graph", "graph": graph.to_dict()})
        return graph

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
        self.tell({"event": "level", "level": level, "clip": {**record(clip), "level": level}})
        self._lap("previews")

    def _lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.stages[stage] = self.stages.get(stage, 0.0) + 1000 * (now - self._since)
        self._since = now
