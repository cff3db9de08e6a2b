"""What a clip costs, counted and not timed: runs of the models, operators of the graphs, bytes of the bundle."""

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
from kinegraph.bundle.reader import DEFAULT_BUNDLE, read_bundle
from kinegraph.bundle.sessions import Sessions

pytestmark = pytest.mark.skipif(not (DEFAULT_BUNDLE / "manifest.json").is_file(), reason="no default bundle")

STEPS = {"motion": 2, "action": 3, "specific": 4}
ONCE = {"text_encoder", "graph_encoder", "decoder", *(f"{part}_{x}" for part in ("context", "clock") for x in LEVELS)}


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
    for part in ("context", "clock", "step"):
        found = {level: Counted(own, f"{part}_{level}", runs) for level, own in getattr(sessions, part).items()}
        changes[part] = MappingProxyType(found)
    return replace(sessions, **changes)


@pytest.fixture(scope="module")
def pipe() -> MotionPipeline:
    return MotionPipeline.load(threads=1)


@pytest.mark.parametrize(
    ("make", "captions"),
    [
        (lambda pipe: pipe.generate(GRAPH, seconds=1, seed=1, steps=STEPS), 1),
        (lambda pipe: pipe.takes(GRAPH, 5, seconds=1, seed=1, steps=STEPS), 1),
        (lambda pipe: pipe.batch([GRAPH] * 3, takes=2, seconds=1, seed=1, steps=STEPS), 3),
        (lambda pipe: pipe.compose([Concept(GRAPH), Concept(GRAPH, -0.5)], text=GRAPH, seconds=1, steps=STEPS), 3),
    ],
    ids=["one clip", "five takes", "a batch", "a fused composition"],
)
def test_a_call_runs_every_model_once_and_every_step_once(
    pipe: MotionPipeline, monkeypatch: pytest.MonkeyPatch, make: Callable[[MotionPipeline], object], captions: int
) -> None:
    runs: Counter[str] = Counter()
    make(pipe.with_sessions(counted(pipe.sampler.sessions, runs)))
    once = dict.fromkeys(ONCE, 1) | {"text_encoder": captions}
    assert runs == {**once, **{f"step_{level}": count for level, count in STEPS.items()}}


@pytest.mark.parametrize(("seconds", "modulations"), [((1.0, 1.0), 1), ((1.0, 2.0), 4)])
def test_rows_of_one_length_share_their_modulation(
    pipe: MotionPipeline, monkeypatch: pytest.MonkeyPatch, seconds: tuple[float, float], modulations: int
) -> None:
    seen: set[tuple[int, int]] = set()

    class Watched(Counted):
        def run(self, names: Any, feeds: dict[str, Any]) -> Any:
            seen.add((len(feeds["latent"]), len(feeds["modulation"])))
            return super().run(names, feeds)

    steps = {level: Watched(own, level, Counter()) for level, own in pipe.sampler.sessions.step.items()}
    sessions = replace(pipe.sampler.sessions, step=MappingProxyType(steps))
    pipe.with_sessions(sessions).batch([GRAPH, GRAPH], seconds=seconds, seed=1, steps=STEPS)
    assert seen == {(4, modulations)}


def test_a_session_does_not_keep_its_file(pipe: MotionPipeline) -> None:
    every = [pipe.sampler.sessions.text_encoder, pipe.sampler.sessions.decoder, *pipe.sampler.sessions.step.values()]
    assert all(session._model_bytes is None for session in every)


def test_the_bundle_is_small() -> None:
    assert sum(entry.bytes for entry in read_bundle(None).manifest.files.values()) <= 64_000_000


def test_steps_in_int8_are_made_of_fused_operators() -> None:
    manifest = read_bundle(None).manifest
    if manifest.precision != "int8":
        pytest.skip("the default bundle is fp32")
    wanted = {"QAttention", "MultiHeadAttention", "DynamicQuantizeMatMul"}
    for level in LEVELS:
        found = {operator.split("::")[1] for operator in manifest.operators[f"step_{level}.onnx"]}
        assert wanted <= found and not found & {"Softmax", "Transpose", "MatMulInteger"}
