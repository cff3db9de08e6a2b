"""What a clip costs, counted and not timed: runs of the models and rows of each run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import pytest

from kinegraph import Concept, MotionPipeline
from kinegraph.bench import GRAPH
from kinegraph.bundle.contract import LEVELS
from kinegraph.bundle.sessions import Sessions

STEPS = {"motion": 2, "action": 3, "specific": 4}
ONCE = {
    "text_encoder",
    "graph_encoder",
    "decoder",
    *(f"{part}_{x}" for part in ("context", "modulation") for x in LEVELS),
}


class Counted:
    """A session that counts its runs."""

    def __init__(self, inner: Any, name: str, runs: Counter[str]) -> None:
        self._inner, self._name, self._runs = inner, name, runs

    def run(self, *arguments: Any) -> Any:
        self._runs[self._name] += 1
        return self._inner.run(*arguments)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)


def counted(sessions: Sessions, runs: Counter[str]) -> Sessions:
    single = ("text_encoder", "graph_encoder", "decoder")
    changes: dict[str, Any] = {name: Counted(getattr(sessions, name), name, runs) for name in single}
    for part in ("context", "modulation", "denoiser"):
        watched = {
            level: Counted(session, f"{part}_{level}", runs) for level, session in getattr(sessions, part).items()
        }
        changes[part] = MappingProxyType(watched)
    return replace(sessions, **changes)


@pytest.mark.parametrize(
    ("make", "captions"),
    [
        (lambda pipe: pipe.generate(GRAPH, seconds=1, seed=1, steps=STEPS), 1),
        (lambda pipe: pipe.takes(GRAPH, 5, seconds=1, seed=1, steps=STEPS, shared_run=True), 1),
        (lambda pipe: pipe.batch([GRAPH] * 3, takes=2, seconds=1, seed=1, steps=STEPS, shared_run=True), 3),
        (lambda pipe: pipe.compose([Concept(GRAPH), Concept(GRAPH, -0.5)], text=GRAPH, seconds=1, steps=STEPS), 3),
    ],
    ids=["one clip", "five takes", "a batch", "a fused composition"],
)
def test_a_call_runs_every_model_once_and_every_step_once(
    toy: MotionPipeline, make: Callable[[MotionPipeline], object], captions: int
) -> None:
    runs: Counter[str] = Counter()
    make(toy.with_sessions(counted(toy.sampler.sessions, runs)))
    once = dict.fromkeys(ONCE, 1) | {"text_encoder": captions}
    assert runs == {**once, **{f"denoiser_{level}": count for level, count in STEPS.items()}}


@pytest.mark.parametrize(("seconds", "modulations"), [((1.0, 1.0), 1), ((1.0, 2.0), 4)])
def test_rows_of_one_length_share_their_modulation(
    toy: MotionPipeline, seconds: tuple[float, float], modulations: int
) -> None:
    seen: set[tuple[int, int]] = set()

    class Watched(Counted):
        def run(self, names: Any, feeds: dict[str, Any]) -> Any:
            seen.add((len(feeds["latent"]), len(feeds["modulation"])))
            return super().run(names, feeds)

    steps = {level: Watched(session, level, Counter()) for level, session in toy.sampler.sessions.denoiser.items()}
    sessions = replace(toy.sampler.sessions, denoiser=MappingProxyType(steps))
    toy.with_sessions(sessions).batch([GRAPH, GRAPH], seconds=seconds, seed=1, steps=STEPS, shared_run=True)
    assert seen == {(4, modulations)}


def test_a_session_does_not_keep_its_file(toy: MotionPipeline) -> None:
    every = [toy.sampler.sessions.text_encoder, toy.sampler.sessions.decoder, *toy.sampler.sessions.denoiser.values()]
    assert all(session._model_bytes is None for session in every)
