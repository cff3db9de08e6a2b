"""Promise 9, all or nothing, and stoppable: no NaN becomes motion, no file is written half, any call can be stopped."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

import kinegraph
from kinegraph import (
    Cancelled,
    Clip,
    Concept,
    InvalidInputError,
    ModelError,
    MotionPipeline,
    NonFiniteError,
    OutputError,
    StepInfo,
    TimedOut,
    Waypoint,
)
from kinegraph.bench import GRAPH
from kinegraph.bundle.contract import FRAME_GRAPHS
from kinegraph.bundle.sessions import ORT_ERRORS, Sessions
from kinegraph.energy import energy_maps
from kinegraph.files import write_atomically
from kinegraph.formats import read
from kinegraph.intervals import Interval
from kinegraph.timeline import generate_timeline
from support.motions import t_pose

FEW: dict[str, Any] = {"seconds": 1, "seed": 1, "steps": 2}
PARTS = ("text_encoder", "graph_encoder", "context", "modulation", "denoiser", "decoder")
STAGES = {
    "text_encoder": "the text encoder",
    "graph_encoder": "the graph encoder",
    "context": "the context encoder",
    "modulation": "the adaLN modulation",
    "denoiser": "the denoiser",
    "decoder": "the decoder",
}
"""What the error must name: in float32 a NaN that one stage lets pass is found by a later one, in int8 it is not."""
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
    changed: Any
    if part in FRAME_GRAPHS:
        graph = sessions.frames[part]()
        frames = MappingProxyType({**sessions.frames, part: lambda: Altered(graph, run)})
        return pipe.with_sessions(replace(sessions, frames=frames))
    if part in ("forward", "backward"):  # of the finest decoder with its gradient
        decoder = sessions.decoder_gradients["specific"]()
        halved = replace(decoder, **{part: Altered(getattr(decoder, part), run)})
        gradients = MappingProxyType({**sessions.decoder_gradients, "specific": lambda: halved})
        return pipe.with_sessions(replace(sessions, decoder_gradients=gradients))
    assert part in {field.name for field in fields(sessions)}
    inner = getattr(sessions, part)
    if part == "encoder":
        whole = inner()
        return pipe.with_sessions(replace(sessions, encoder=lambda: Altered(whole, run)))
    if part == "coarse_decoders":
        coarse = inner["action"]()
        changed = MappingProxyType({**inner, "action": lambda: Altered(coarse, run)})
        return pipe.with_sessions(replace(sessions, coarse_decoders=changed))
    if part.endswith("_agd"):
        opened = inner["action"]()
        changed = MappingProxyType({**inner, "action": lambda: Altered(opened, run)})
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
        with pytest.raises(NonFiniteError, match=STAGES[part]):
            CALLS[call](with_run(toy, part, injecting(value, output)))


@pytest.mark.parametrize("part", AGD_PARTS)
def test_one_number_that_is_none_is_an_error_in_adaptive_gradient_descent(toy: MotionPipeline, part: str) -> None:
    with pytest.raises(NonFiniteError):
        with_run(toy, part, injecting(np.nan, 0)).compose([GRAPH, GRAPH], text=GRAPH, agd=(0.1, 0.1), **FEW)


STOOD = Clip(np.repeat(t_pose(1), 40, axis=0), 20.0, 1, "a person stands", "toy 1")
LATER: dict[str, Callable[[MotionPipeline], object]] = {
    "frames_context": lambda pipe: pipe.generate(GRAPH, space="frames", **FEW),
    "frames_modulation": lambda pipe: pipe.generate(GRAPH, space="frames", **FEW),
    "frames_denoiser": lambda pipe: pipe.generate(GRAPH, space="frames", **FEW),
    "frames_context_agd": lambda pipe: pipe.compose([GRAPH, GRAPH], agd=(0.1, 0.1), space="frames", **FEW),
    "frames_denoiser_agd": lambda pipe: pipe.compose([GRAPH, GRAPH], agd=(0.1, 0.1), space="frames", **FEW),
    "coarse_decoders": lambda pipe: pipe.generate(GRAPH, on_level=lambda *_: None, **FEW),
    "forward": lambda pipe: pipe.generate(GRAPH, constraints=[Waypoint(0.5, (0, 1))], **FEW),
    "backward": lambda pipe: pipe.generate(GRAPH, constraints=[Waypoint(0.5, (0, 1))], **FEW),
    "encoder": lambda pipe: pipe.edit(STOOD, GRAPH, keep="legs", strength=0.5, steps=2),
}
"""Graphs that are read at their first use -> a call that uses them."""


@pytest.mark.parametrize("part", LATER)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_one_number_that_is_none_is_an_error_at_every_model_that_is_read_later(
    toy: MotionPipeline, part: str, value: float
) -> None:
    assert not set(FRAME_GRAPHS) - set(LATER)
    for output in (0, -1) if part != "forward" else (0,):  # what a gradient reads besides is seen in the gradient
        with pytest.raises(NonFiniteError):
            LATER[part](with_run(toy, part, injecting(value, output)))


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


def test_a_motion_that_explodes_is_an_error(toy: MotionPipeline) -> None:
    """Infinity that no single model produced: finite noise predictions that outgrow float32 in a step."""
    with pytest.raises(NonFiniteError, match=r"step \d of level action"), np.errstate(over="ignore", invalid="ignore"):
        CALLS["generate"](with_run(toy, "denoiser", injecting(3e38, 0)))


# Stopping

WAYS: dict[str, Callable[..., object]] = {
    "generate": lambda pipe, **options: pipe.generate(GRAPH, **FEW, **options),
    "compose": lambda pipe, **options: pipe.compose([GRAPH, GRAPH], text=GRAPH, **FEW, **options),
    "takes": lambda pipe, **options: pipe.takes(GRAPH, 2, **FEW, **options),
    "batch": lambda pipe, **options: pipe.batch([GRAPH, GRAPH], **FEW, **options),
    "shared batch": lambda pipe, **options: pipe.batch([GRAPH, GRAPH], shared_run=True, **FEW, **options),
    "sequence": lambda pipe, **options: pipe.sequence([GRAPH, GRAPH], **FEW, **options),
    "continued": lambda pipe, **options: pipe.sequence([GRAPH, GRAPH], method="continue", **FEW, **options),
    "by energy": lambda pipe, **options: pipe.sequence(
        [GRAPH, GRAPH], method="energy", **{**FEW, "steps": 4}, **options
    ),
    "skeleton space": lambda pipe, **options: pipe.generate(GRAPH, space="frames", **{**FEW, "steps": 4}, **options),
    "by parts": lambda pipe, **options: pipe.compose([GRAPH, GRAPH], method="parts", **FEW, **options),
    "constrained": lambda pipe, **options: pipe.generate(GRAPH, constraints=[Waypoint(0.5, (0, 1))], **FEW, **options),
    "edit": lambda pipe, **options: pipe.edit(STOOD, GRAPH, keep="legs", seed=1, steps=2, **options),
    "in-between": lambda pipe, **options: pipe.inbetween(STOOD, STOOD, text=GRAPH, **FEW, **options),
    "intervals": lambda pipe, **options: pipe.timeline(
        [Interval(GRAPH, 0, 1), Interval(GRAPH, 1, 2)], seed=1, steps=2, **options
    ),
    "timeline": lambda pipe, **options: generate_timeline(pipe, [GRAPH, GRAPH], **FEW, **options),
}


DESCENDING = ("continued", "constrained", "edit", "in-between", "timeline")


def step_runs(pipe: MotionPipeline, counter: list[int]) -> MotionPipeline:
    """Count the runs of the action level's denoiser."""

    def run(inner: Any, names: list[str], inputs: dict[str, Any]) -> Any:
        counter[0] += 1
        return inner.run(names, inputs)

    return with_run(pipe, "denoiser", run)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("answer", [False, np.False_])
def test_a_call_stops_at_any_step(toy: MotionPipeline, way: str, answer: object) -> None:
    seen: list[StepInfo] = []
    WAYS[way](toy, on_step=seen.append)
    if way in DESCENDING:  # a part under constraints has more steps than one without, and a descent may end early
        shares = [info.done / info.total for info in seen]
        assert shares[-1] == 1 and all(after > before for before, after in pairwise(shares))
    else:
        assert [info.done for info in seen] == list(range(1, len(seen) + 1))
        assert {info.total for info in seen} == {len(seen)}
    for stop in range(1, len(seen) + 1):
        calls: list[StepInfo] = []

        def on_step(info: StepInfo, calls: list[StepInfo] = calls, stop: int = stop) -> object:
            calls.append(info)
            return answer if len(calls) == stop else None

        with pytest.raises(Cancelled):
            WAYS[way](toy, on_step=on_step)
        assert calls == seen[:stop]


@pytest.mark.parametrize("way", WAYS)
def test_a_call_stops_within_a_step_of_its_timeout(
    toy: MotionPipeline, way: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clock jumps past the end during the third step; that step is the last."""
    now, steps = [100.0], []
    monkeypatch.setattr("kinegraph.options.time.monotonic", lambda: now[0])

    def on_step(info: StepInfo) -> None:
        steps.append(info)
        now[0] += 10 if len(steps) == 3 else 0

    with pytest.raises(TimedOut, match="timeout of 5 s") as caught:
        WAYS[way](toy, on_step=on_step, timeout=5)
    assert len(steps) == 3
    assert isinstance(caught.value, Cancelled | TimeoutError)


def test_energy_maps_have_a_timeout_too(toy: MotionPipeline) -> None:
    with pytest.raises(TimedOut):
        energy_maps(toy, [GRAPH, GRAPH], **FEW, timeout=1e-6)


def test_a_timeout_holds_for_real(toy: MotionPipeline) -> None:
    def slow(inner: Any, names: list[str], inputs: dict[str, Any]) -> Any:
        time.sleep(0.05)
        return inner.run(names, inputs)

    start = time.monotonic()
    with pytest.raises(TimedOut):
        with_run(toy, "denoiser", slow).generate(GRAPH, seconds=1, seed=1, steps=100, timeout=0.2)
    assert time.monotonic() - start < 4


def test_many_sentences_stop_before_the_next_is_read(toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    read_texts: list[Any] = []
    now = [100.0]
    monkeypatch.setattr("kinegraph.options.time.monotonic", lambda: now[0])

    def as_graph(_: MotionPipeline, text: Any) -> Any:
        read_texts.append(text)
        now[0] += 1
        return text

    monkeypatch.setattr(MotionPipeline, "as_graph", as_graph)
    with pytest.raises(TimedOut):
        toy.sequence([GRAPH] * 50, **FEW, timeout=3)
    assert len(read_texts) == 3


def test_a_timeout_that_is_not_reached_changes_nothing(toy: MotionPipeline) -> None:
    plain = toy.generate(GRAPH, **FEW)
    np.testing.assert_array_equal(toy.generate(GRAPH, **FEW, timeout=600).joints, plain.joints)


@pytest.mark.parametrize("timeout", [0, -1, float("nan"), float("inf"), "5", True])
def test_a_timeout_is_a_number_of_seconds(toy: MotionPipeline, timeout: Any) -> None:
    with pytest.raises(InvalidInputError, match="timeout must be"):
        toy.generate(GRAPH, **FEW, timeout=timeout)


def test_memory_that_ends_between_models_is_typed(toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr("kinegraph.denoising.ddim_step", full)
    for call in CALLS.values():
        with pytest.raises(ModelError, match="memory ran out"):
            call(toy)


class Panic(BaseException):
    """What Rust code raises through pyo3: no `Exception`."""


@pytest.mark.parametrize("kind", [Panic, RuntimeError, MemoryError])
def test_what_tokenizer_and_parser_raise_is_typed(
    toy: MotionPipeline, kind: type, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise kind("the reason")

    class Tokenizer:
        encode = fail

    monkeypatch.setattr(toy.encoder.tokenizer, "_tokenizer", Tokenizer())
    with pytest.raises(ModelError, match=r"the tokenizer failed|memory"):
        toy.generate(GRAPH, **FEW)
    if kind is not Panic:
        pytest.importorskip("spacy")
        monkeypatch.setattr("kinegraph.text.parser.predicate_frames", fail)
        with pytest.raises(ModelError, match=r"the parser failed|memory"):
            toy.parse("a person walks")


# Files

CLIP = Clip(np.zeros((40, 22, 3), dtype=np.float32), 20.0, 1, "a person stands", "toy 1")
RUNTIME = str(Path(kinegraph.__file__).resolve().parents[1])
SAVE_FOR_EVER = """
import sys
import numpy as np
from kinegraph import Clip
clip = Clip(np.random.default_rng(1).normal(size=(200, 22, 3)).astype(np.float32), 20.0, 1, "x", "y")
clip.save("clip.npz", force=True)
print("saves", flush=True)
while True:
    clip.save("clip.npz", force=True)
"""


def temporaries(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir() if path.name.startswith(".kinegraph-")]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_killed_process_leaves_a_whole_file_and_the_next_save_cleans_up(
    tmp_path: Path, is_long: bool, figure: Callable[[str], None]
) -> None:
    generator, left, kills = random.Random(1), 0, 100 if is_long else 6
    for _ in range(kills):
        writer = subprocess.Popen(
            [sys.executable, "-c", SAVE_FOR_EVER],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": RUNTIME},
            stdout=subprocess.PIPE,
        )
        assert writer.stdout is not None and writer.stdout.readline() == b"saves\n"
        time.sleep(generator.uniform(0, 0.05))
        writer.kill()
        writer.wait()
        writer.stdout.close()
        assert read(tmp_path / "clip.npz").frames == 200
        left += len(temporaries(tmp_path))
        CLIP.save(tmp_path / "other.npz", force=True)
        assert sorted(path.name for path in tmp_path.iterdir()) == ["clip.npz", "other.npz"]
    figure(f"{kills} kills during a save: no partial file, {left} temporary files left and removed")


@pytest.mark.skipif(os.name != "posix", reason="locks of POSIX")
def test_only_abandoned_temporary_files_are_removed(tmp_path: Path) -> None:
    import fcntl

    abandoned, living = (tmp_path / f".kinegraph-{digit * 16}.tmp" for digit in "ab")
    foreign = [
        tmp_path / name for name in (".kinegraph-notes.tmp", "kinegraph-aaaaaaaaaaaaaaaa.tmp", ".kinegraph-a.tmp")
    ]
    for path in (abandoned, living, *foreign):
        path.write_bytes(b"half")
    (tmp_path / f".kinegraph-{'c' * 16}.tmp").mkdir()
    (tmp_path / "precious").write_bytes(b"whole")
    (tmp_path / f".kinegraph-{'d' * 16}.tmp").symlink_to(tmp_path / "precious")
    os.mkfifo(tmp_path / f".kinegraph-{'e' * 16}.tmp")
    with living.open("r+b") as writer:
        fcntl.flock(writer, fcntl.LOCK_EX)
        CLIP.save(tmp_path / "clip.npz")
    assert not abandoned.exists() and living.read_bytes() == b"half"
    assert all(path.exists() for path in foreign) and (tmp_path / "precious").read_bytes() == b"whole"
    assert sorted(name[11] for name in temporaries(tmp_path) if len(name) == 31) == ["b", "c", "d", "e"]


@pytest.mark.skipif(os.name != "posix", reason="locks of POSIX")
def test_writers_of_one_folder_leave_each_other_alone(tmp_path: Path) -> None:
    code = (
        "import sys; from kinegraph.files import write_atomically\n"
        "for n in range(150): write_atomically(f'{sys.argv[1]}-{n}', b'x' * 1000)\n"
    )
    writers = [
        subprocess.Popen([sys.executable, "-c", code, name], cwd=tmp_path, env={**os.environ, "PYTHONPATH": RUNTIME})
        for name in "abc"
    ]
    assert [writer.wait(120) for writer in writers] == [0, 0, 0]
    assert len([*tmp_path.iterdir()]) == 450 and temporaries(tmp_path) == []


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A real disk of 64 KiB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if os.name != "posix" or os.geteuid() != 0:
        pytest.skip("only root can mount a disk that is full")
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)], capture_output=True).returncode:
        pytest.skip("this system lets nobody mount a disk")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def test_a_real_full_disk_leaves_the_old_file_and_no_rest(small_disk: Path) -> None:
    CLIP.save(small_disk / "clip.npz")
    old = (small_disk / "clip.npz").read_bytes()
    long = replace(CLIP, joints=np.zeros((400, 22, 3), dtype=np.float32))
    for name, force in (("clip.npz", True), ("new.npz", False)):
        with pytest.raises(OutputError, match="No space left"):
            long.save(small_disk / name, force=force)
    assert [path.name for path in small_disk.iterdir()] == ["clip.npz"]
    assert (small_disk / "clip.npz").read_bytes() == old
    CLIP.save(small_disk / "clip.npz", force=True)


def test_the_content_is_on_the_disk_before_the_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    fsync, replace_file = os.fsync, Path.replace
    monkeypatch.setattr(os, "fsync", lambda handle: (done.append("fsync"), fsync(handle))[1])
    monkeypatch.setattr(Path, "replace", lambda path, to: (done.append("rename"), replace_file(path, to))[1])
    write_atomically(tmp_path / "clip", b"content")
    assert done == ["fsync", "rename"]
