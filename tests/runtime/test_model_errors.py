"""What a model does wrong while it runs: typed errors that name it, and no NaN that goes on as a motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from kinegraph import Concept, ModelError, MotionPipeline, NonFiniteError
from kinegraph.bench import GRAPH
from kinegraph.bundle.sessions import ORT_ERRORS, Sessions

FEW: dict[str, Any] = {"seconds": 1, "seed": 1, "steps": 2}
PARTS = ("text_encoder", "graph_encoder", "context", "modulation", "denoiser", "decoder")
AGD_PARTS = ("context_agd", "denoiser_agd")


class Altered:
    """A session whose run is replaced."""

    def __init__(self, inner: Any, run: Callable[[Any, list[str], dict[str, Any]], Any]) -> None:
        self._inner, self._run = inner, run

    def run(self, names: list[str], inputs: dict[str, Any]) -> Any:
        return self._run(self._inner, names, inputs)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)


def with_run(pipe: MotionPipeline, part: str, run: Callable[[Any, list[str], dict[str, Any]], Any]) -> MotionPipeline:
    """Replace the run of one kind of session, at the action level where there are several."""
    sessions: Sessions = pipe.sampler.sessions
    assert part in {field.name for field in fields(sessions)}
    inner = getattr(sessions, part)
    if part.endswith("_agd"):
        opened = inner["action"]()
        changed: Any = MappingProxyType({**inner, "action": lambda: Altered(opened, run)})
    elif part in ("context", "modulation", "denoiser"):
        changed = MappingProxyType({**inner, "action": Altered(inner["action"], run)})
    else:
        changed = Altered(inner, run)
    return pipe.with_sessions(replace(sessions, **{part: changed}))


def injecting(value: float, output: int) -> Callable[[Any, list[str], dict[str, Any]], Any]:
    """Put one number into one output of a session."""

    def run(inner: Any, names: list[str], inputs: dict[str, Any]) -> Any:
        results = [np.array(array) for array in inner.run(names, inputs)]
        array = results[output % len(results)]
        array.reshape(-1)[array.size // 2] = value
        return results

    return run


CALLS: dict[str, Callable[[MotionPipeline], object]] = {
    "generate": lambda pipe: pipe.generate(GRAPH, **FEW),
    "own length": lambda pipe: pipe.generate(GRAPH, seed=1, steps=2),
    "compose": lambda pipe: pipe.compose([Concept(GRAPH), Concept(GRAPH, 0.5)], text=GRAPH, **FEW),
    "shared batch": lambda pipe: pipe.batch([GRAPH, GRAPH], shared_run=True, **FEW),
    "sequence": lambda pipe: pipe.sequence([GRAPH, GRAPH], **FEW),
}


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_one_number_that_is_none_is_an_error_at_every_model(
    toy: MotionPipeline, part: str, value: float, call: str
) -> None:
    for output in (0, -1):
        with pytest.raises(NonFiniteError):
            CALLS[call](with_run(toy, part, injecting(value, output)))


@pytest.mark.parametrize("part", AGD_PARTS)
def test_one_number_that_is_none_is_an_error_in_adaptive_gradient_descent(toy: MotionPipeline, part: str) -> None:
    with pytest.raises(NonFiniteError):
        with_run(toy, part, injecting(np.nan, 0)).compose([GRAPH, GRAPH], text=GRAPH, agd=(0.1, 0.1), **FEW)


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize(
    "kind", [*sorted(ORT_ERRORS, key=lambda kind: kind.__name__), MemoryError], ids=lambda k: k.__name__
)
def test_what_onnxruntime_raises_while_running_is_typed(toy: MotionPipeline, part: str, kind: type[Exception]) -> None:
    def run(*_: object) -> None:
        raise kind("the reason")

    with pytest.raises(ModelError, match="memory" if kind is MemoryError else "the reason") as caught:
        CALLS["generate"](with_run(toy, part, run))
    assert isinstance(caught.value.__cause__, kind)


def test_word_pieces_that_the_text_encoder_does_not_know_are_an_error(pipe: MotionPipeline) -> None:
    def run(inner: Any, names: list[str], inputs: dict[str, Any]) -> Any:
        return inner.run(names, {**inputs, "input_ids": inputs["input_ids"] + 1_000_000})

    with pytest.raises(ModelError, match="the text encoder failed in onnxruntime"):
        with_run(pipe, "text_encoder", run).generate(GRAPH, **FEW)
