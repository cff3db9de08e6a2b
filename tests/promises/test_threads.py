"""Promise 7, thread safety: threads, forks and processes may share one loaded pipeline, and nothing of it changes."""

from __future__ import annotations

import dataclasses
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kinegraph
from kinegraph import Clip, Concept, MotionPipeline
from kinegraph.edits import with_weight
from kinegraph.text import parser
from kinegraph.text.parser import LazyParser

pytest.importorskip("spacy")

RUNTIME = str(Path(kinegraph.__file__).resolve().parents[1])
FEW: dict[str, Any] = {"seconds": 1, "steps": (1, 1, 2)}
TEXTS = (
    "a person walks forward",
    "a person waves the right hand without walking",
    "someone turns left, then bows and sits down",
    "a person zigzags blargfully for two seconds",
    "jumping",
)
Request = Callable[[MotionPipeline], list[Clip]]


def mixed_requests(seed: int) -> list[Request]:
    """Five kinds of requests on five sentences, each with a seed of its own."""
    makers: list[Callable[[str, int], Request]] = [
        lambda text, n: lambda pipe: [pipe.generate(text, seed=n, **FEW)],
        lambda text, n: lambda pipe: [pipe.generate(with_weight(pipe.parse(text), 1, 0.5), seed=n, **FEW)],
        lambda text, n: lambda pipe: [pipe.compose([Concept(text), Concept(TEXTS[0], 0.5)], seed=n, **FEW)],
        lambda text, n: lambda pipe: pipe.batch([text, TEXTS[0]], seed=n, **FEW),
        lambda text, n: lambda pipe: [pipe.sequence([text, TEXTS[0]], seed=n, **FEW)],
    ]
    return [make(text, seed + 10 * i + j) for i, make in enumerate(makers) for j, text in enumerate(TEXTS)]


def content(clips: list[Clip]) -> list[tuple[object, ...]]:
    return [(clip.joints.tobytes(), clip.text, clip.seed, clip.graph, clip.unknown, clip.notes) for clip in clips]


@pytest.fixture
def hasty() -> Iterator[None]:
    """Let threads take turns as often as they can."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


@pytest.mark.slow
@pytest.mark.usefixtures("hasty")
def test_eight_threads_of_mixed_requests_equal_the_serial_results(
    toy: MotionPipeline, pipe: MotionPipeline, is_long: bool
) -> None:
    for pipeline in (toy, pipe) if is_long else (toy,):
        per_thread = [mixed_requests(1000 * n)[:: 1 if is_long else 3] for n in range(8)]
        serial = [[content(request(pipeline)) for request in requests] for requests in per_thread]
        barrier = threading.Barrier(8)

        def work(requests: list[Request], pipeline: MotionPipeline = pipeline, barrier: Any = barrier) -> list[Any]:
            barrier.wait()
            return [content(request(pipeline)) for request in requests]

        with ThreadPoolExecutor(8) as threads:
            assert [*threads.map(work, per_thread)] == serial


@pytest.mark.usefixtures("hasty")
def test_clips_made_at_once_carry_their_own_graphs(toy: MotionPipeline) -> None:
    """Two callers whose runs overlap: one waits in its first step until the other has begun."""
    begun, texts = threading.Barrier(2, timeout=30), TEXTS[:2]

    def make(text: str) -> Clip:
        met: list[bool] = []

        def on_step(_: object) -> None:
            if not met:
                met.append(True)
                begun.wait()

        return toy.generate(text, seed=1, on_step=on_step, **FEW)

    with ThreadPoolExecutor(2) as threads:
        clips = [*threads.map(make, texts)]
    for text, clip in zip(texts, clips, strict=True):
        assert clip.text == text and clip.graph == toy.parse(text)


def test_the_parser_is_made_once_whoever_asks_first(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[object] = []
    barrier = threading.Barrier(8)

    class Slow:
        def __init__(self, *_: object) -> None:
            made.append(self)
            threading.Event().wait(0.05)

    monkeypatch.setattr(parser, "GraphParser", Slow)
    lazy = LazyParser(b"weights")

    def ask(_: int) -> object:
        barrier.wait()
        return lazy()

    with ThreadPoolExecutor(8) as threads:
        assert len({*threads.map(ask, range(8))}) == 1
    assert len(made) == 1


def test_nothing_of_a_pipeline_can_be_set(toy: MotionPipeline) -> None:
    for name in ("manifest", "parser", "vocabulary", "encoder", "sampler", "decoder", "anything"):
        with pytest.raises(AttributeError):
            setattr(toy, name, None)
        with pytest.raises(AttributeError):
            delattr(toy, name)
    for part in (toy.encoder, toy.sampler, toy.decoder, toy.manifest, toy.sampler.sessions):
        assert dataclasses.is_dataclass(part)
        for field in dataclasses.fields(part):
            with pytest.raises(AttributeError):
                setattr(part, field.name, None)
    for mapping in (toy.sampler.sessions.denoiser, toy.manifest.files, toy.encoder.tables, toy.manifest.defaults.steps):
        with pytest.raises(TypeError):
            mapping["new"] = None  # type: ignore[index]
    for array in toy.encoder.tables.values():
        assert not array.flags.writeable


def test_a_call_leaves_no_trace_on_the_pipeline(toy: MotionPipeline) -> None:
    """No attribute appears on the pipeline or its stages, whatever is called."""
    parts = (toy, toy.encoder, toy.sampler, toy.decoder, toy.sampler.sessions, toy.encoder.tokenizer, toy.parser)
    toy.generate(TEXTS[0], seed=1, **FEW)
    before = [dict(vars(part)) for part in parts]
    for request in mixed_requests(5)[::3]:
        request(toy)
    assert all(
        now.keys() == then.keys() and all(now[name] is then[name] for name in now)
        for now, then in zip([vars(part) for part in parts], before, strict=True)
    )


SPAWNED = """
import sys
from multiprocessing import get_context
from kinegraph import MotionPipeline

def joints(folder):
    return MotionPipeline.load(folder, threads=1).generate(
        "a person walks forward", seed=3, seconds=1, steps=(1, 1, 2)).joints.tobytes()

if __name__ == "__main__":
    MotionPipeline.load(sys.argv[1], threads=1)
    with get_context("spawn").Pool(1) as pool:
        sys.stdout.buffer.write(pool.apply(joints, (sys.argv[1],)))
"""


@pytest.mark.slow
def test_a_spawned_process_makes_the_same_clip(toy: MotionPipeline, toy_bundle: Path, tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text(SPAWNED)
    done = subprocess.run(
        [sys.executable, str(tmp_path / "program.py"), str(toy_bundle)],
        env={**os.environ, "PYTHONPATH": RUNTIME},
        capture_output=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == toy.generate(TEXTS[0], seed=3, **FEW).joints.tobytes()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
@pytest.mark.parametrize("threads", [None, 1, 4])
def test_a_child_of_a_fork_makes_the_same_clip(toy_bundle: Path, threads: int | None) -> None:
    pipeline = MotionPipeline.load(toy_bundle, threads=threads)
    expected = pipeline.generate(TEXTS[0], seed=3, **FEW).joints
    child = os.fork()
    if child == 0:
        signal.alarm(60)
        same = np.array_equal(pipeline.generate(TEXTS[0], seed=3, **FEW).joints, expected)
        os._exit(0 if same else 1)
    assert os.waitpid(child, 0)[1] == 0
