"""The benchmark of the service: both arms make the same bytes, and every repeat is kept."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinegraph import MotionPipeline

pytest.importorskip("spacy")
pytest.importorskip("starlette")

from kinegraph_benchmarks.speed import service


def test_the_service_makes_what_is_made_here(toy: MotionPipeline, toy_bundle: Path) -> None:
    times = service.measure_service(toy, toy_bundle, repeats=2)
    assert {name: len(values) for name, values in times.items()} == {"in process": 2, "by the service": 2}
    assert all(value > 0 for values in times.values() for value in values)


def test_retargeting_is_timed_on_our_own_body(toy: MotionPipeline) -> None:
    clip = toy.generate("a person walks", seconds=1, seed=1)
    assert len(service.measure_retargeting(clip, None, repeats=3)) == 3
    assert service.summary([1.0, 2.0, 9.0]) == {"count": 3, "p50": 2.0, "p95": pytest.approx(8.3)}
