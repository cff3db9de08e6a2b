"""Measure how fast a bundle is on this machine: `kinegraph bench`.

Stages are timed around the sessions of an ordinary pipeline; the rest of a level's time is numpy. Cold start and peak
memory are those of fresh processes.
"""

from __future__ import annotations

import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import onnxruntime

from kinegraph import __version__
from kinegraph.bundle.contract import LEVELS
from kinegraph.bundle.sessions import available_cpus
from kinegraph.diffusion.sampling import StepInfo
from kinegraph.errors import KinegraphError, MissingExtraError
from kinegraph.graph import Action, Argument, SemanticGraph
from kinegraph.pipeline import MotionPipeline

STAGES: Final = ("parse", "tokens", "text", "graph", *LEVELS, "decode", "joints", "write")
WARM_UP: Final = 3
IDLE_SECONDS: Final = 1.0
INT8_PRODUCTS: Final = {
    "amx_int8": "AMX",
    "avx512_vnni": "AVX-512 VNNI",
    "avx_vnni": "AVX VNNI",
    "avx2": "AVX2",
    "asimddp": "dot products",
}
"""Flags of /proc/cpuinfo that tell which instructions int8 steps use, the fastest first."""

GRAPH: Final = SemanticGraph(
    "a person walks forward and waves the right hand",
    (
        Action("walks", 9, 14, 0, arguments=(Argument("ARGM-DIR", "forward", 15, 22),)),
        Action("waves", 27, 32, 1, arguments=(Argument("ARG1", "the right hand", 33, 47),)),
    ),
)
"""The sentence that is timed: as long as people type."""

# Prints the peak of its resident memory; VmHWM, because ru_maxrss also counts the process that started this one.
_FIRST_CLIP: Final = """
import sys
from kinegraph.cli import main
code = main(sys.argv[1:])
try:
    lines = open("/proc/self/status").read().splitlines()
    print(next(line.split()[1] for line in lines if line.startswith("VmHWM")))
except OSError:
    print(0)
sys.exit(code)
"""


@dataclass(frozen=True)
class ColdStart:
    """A fresh process, from its start to a written file."""

    milliseconds: tuple[float, ...]
    """Of every repeat."""
    peak_bytes: int | None
    """Peak resident memory; None where the system does not tell."""


@dataclass(frozen=True)
class BenchReport:
    """All measurements of one `bench`; every repeat is kept."""

    machine: Mapping[str, Any]
    bundle: str
    precision: str
    threads: Mapping[str, int]
    """Of the denoisers and of the others."""
    seconds: float
    """Length of the clip."""
    stages: Mapping[str, tuple[float, ...]]
    """Milliseconds of every repeat by stage; "parse" is missing without spaCy, "total" is the whole clip."""
    idle_cpu: float
    """Share of one core that idle sessions use."""
    cold: Mapping[str, ColdStart]
    """"graph": from a graph in JSON; "sentence": with the parser."""


def bench(
    path: str | Path | None = None,
    *,
    seconds: float = 4.0,
    repeats: int = 30,
    threads: int | None = None,
    cold: int = 3,
) -> BenchReport:
    """Time the stages of clips, cold starts and idle sessions of a bundle.

    Args:
        path: folder of the bundle, or the name of an installed one; None is the default bundle.
        seconds: length of the clip.
        repeats: clips timed, after `WARM_UP` more.
        threads: as in `MotionPipeline.load`.
        cold: fresh processes of each kind.

    Raises:
        BundleError, InvalidInputError: as `MotionPipeline.load` and `generate`.
    """
    timer = _StageTimer()
    pipe = timer.wrap(MotionPipeline.load(path, threads=threads))
    parses = _can_parse(pipe)
    rows = [_time_clip(pipe, timer, seconds, parses) for _ in range(WARM_UP + repeats)][WARM_UP:]
    return BenchReport(
        machine=machine(),
        bundle=f"{pipe.manifest.name} {pipe.manifest.version}",
        precision=pipe.manifest.precision,
        threads=timer.threads,
        seconds=seconds,
        stages={name: tuple(row[name] for row in rows) for name in rows[0]},
        idle_cpu=_measure_idle(),
        cold={
            name: _measure_cold_start(path, seconds, name, cold)
            for name in (["graph", "sentence"] if parses else ["graph"])
        },
    )


def machine() -> dict[str, Any]:
    """Describe the machine and the versions that times depend on."""
    return {
        "cpu": _cpu_name(),
        "cpus": available_cpus(),
        "load": [round(value, 2) for value in os.getloadavg()] if hasattr(os, "getloadavg") else None,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "kinegraph": __version__,
        "numpy": np.__version__,
        "onnxruntime": onnxruntime.__version__,
    }


def text_table(report: BenchReport) -> str:
    """Lay out a report as text for people."""
    facts = report.machine
    lines = [
        f"{report.bundle} ({report.precision}), a clip of {report.seconds:g} s; threads: steps "
        f"{report.threads['steps']}, others {report.threads['others']}",
        f"{facts['cpu']}, {facts['cpus']} CPUs, load {facts['load']}; {facts['system']}, Python {facts['python']}, "
        f"numpy {facts['numpy']}, onnxruntime {facts['onnxruntime']}",
        "",
        f"{'ms':<10}{'p50':>8}{'p90':>8}{'p99':>8}{'min':>8}",
    ]
    for name, times in report.stages.items():
        marks = [*np.percentile(times, (50, 90, 99)), min(times)]
        lines.append(f"{name:<10}" + "".join(f"{value:8.2f}" for value in marks))
    total = float(np.median(report.stages["total"]))
    lines += [
        "",
        f"{1000 * report.seconds / total:.0f} times as fast as the clip plays; idle: {report.idle_cpu:.1%} CPU",
    ]
    for name, start in report.cold.items():
        memory = "" if start.peak_bytes is None else f", peak memory {start.peak_bytes / 1e6:.0f} MB"
        lines.append(f"first file of a fresh process, from a {name}: {min(start.milliseconds):.0f} ms{memory}")
    return "\n".join(lines)


class _StageTimer:
    """Records when the calls of a pipeline's resources begin and end."""

    def __init__(self) -> None:
        self.events: list[tuple[str, float, float]] = []
        self.threads: dict[str, int] = {}

    def wrap(self, inner: MotionPipeline) -> MotionPipeline:
        """Make a pipeline of the same bundle whose sessions and tokenizer are timed."""
        sessions = inner.sampler.sessions
        tokenizer = self._around(inner.encoder.tokenizer, "encode", "tokens")
        self.threads = {"steps": _threads(sessions.denoiser[LEVELS[-1]]), "others": _threads(sessions.decoder)}
        graph_encoder = sessions.graph_encoder
        watched = replace(
            sessions,
            text_encoder=self._around(sessions.text_encoder, "run", "text"),
            graph_encoder=None if graph_encoder is None else self._around(graph_encoder, "run", "graph"),
            decoder=self._around(sessions.decoder, "run", "decode"),
        )
        return MotionPipeline(inner.manifest, watched, tokenizer, inner.encoder.tables, inner.parser)

    def _around(self, inner: Any, method: str, name: str) -> Any:
        return _TimedMethod(inner, method, name, self.events)


class _TimedMethod:
    """Proxy of an object, one of whose methods is timed."""

    def __init__(self, inner: Any, method: str, name: str, events: list[tuple[str, float, float]]) -> None:
        self._inner, self._name, self._events = inner, name, events
        setattr(self, method, lambda *arguments: self._timed(getattr(inner, method), arguments))

    def _timed(self, call: Any, arguments: Sequence[Any]) -> Any:
        start = time.perf_counter()
        result = call(*arguments)
        self._events.append((self._name, start, time.perf_counter()))
        return result

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)


def _can_parse(pipe: MotionPipeline) -> bool:
    """Tell whether sentences can be parsed here; without spaCy or a parser all else can still be timed."""
    try:
        pipe.parse(GRAPH.caption)
    except MissingExtraError:
        return False
    except KinegraphError:
        if pipe.manifest.files.get("parser.bin") is not None:
            raise
        return False
    return True


def _time_clip(pipe: MotionPipeline, timer: _StageTimer, seconds: float, parses: bool) -> dict[str, float]:
    """Make one clip and return the milliseconds of every stage."""
    timer.events.clear()
    level_ends: dict[str, float] = {}
    begin = time.perf_counter()
    graph = pipe.parse(GRAPH.caption) if parses else GRAPH
    parsed = time.perf_counter()

    def note_level_end(info: StepInfo) -> None:
        level_ends[info.level] = time.perf_counter()

    clip = pipe.generate(graph, seconds=seconds, seed=1, on_step=note_level_end)
    made = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        writing = time.perf_counter()
        clip.save(Path(folder) / "clip.bvh")
        written = time.perf_counter() - writing
    durations = {name: end - start for name, start, end in timer.events}
    ends = {name: end for name, _, end in timer.events}
    # a released MLD has neither graph attention nor coarser levels
    marks = [ends.get("graph", ends["text"]), *level_ends.values()]
    durations |= {level: after - before for level, before, after in zip(level_ends, marks, marks[1:], strict=False)}
    durations |= {"joints": made - ends["decode"], "write": written, "parse": parsed - begin}
    stages = {name: 1000.0 * durations[name] for name in STAGES if name in durations and (parses or name != "parse")}
    return {**stages, "total": 1000.0 * (made - begin + written)}


def _measure_idle() -> float:
    """Measure the share of one core that idle sessions use."""
    start = time.process_time()
    time.sleep(IDLE_SECONDS)
    return (time.process_time() - start) / IDLE_SECONDS


def _measure_cold_start(path: str | Path | None, seconds: float, kind: str, repeats: int) -> ColdStart:
    times, peaks = [], []
    with tempfile.TemporaryDirectory() as folder:
        graph, target = Path(folder) / "graph.json", Path(folder) / "clip.bvh"
        graph.write_text(GRAPH.to_json(), encoding="utf-8")
        text = ["--graph", str(graph)] if kind == "graph" else [GRAPH.caption]
        # A `Path` is never the name of an installed bundle, the text of an absolute one neither.
        more = [] if path is None else ["--bundle", path if isinstance(path, str) else str(path.absolute())]
        words = ["generate", *text, *more, "-o", str(target), "--seconds", str(seconds), "--force", "--quiet"]
        for _ in range(repeats):
            start = time.perf_counter()
            done = subprocess.run([sys.executable, "-c", _FIRST_CLIP, *words], capture_output=True, check=False)
            times.append(1000.0 * (time.perf_counter() - start))
            if done.returncode != 0:
                raise KinegraphError(f"a fresh process failed: {done.stderr.decode(errors='replace').strip()}")
            peaks.append(1024 * int(done.stdout))
    return ColdStart(tuple(times), max(peaks) or None)


def _threads(session: onnxruntime.InferenceSession) -> int:
    return int(session.get_session_options().intra_op_num_threads)


def _cpu_name(cpuinfo: Path = Path("/proc/cpuinfo")) -> str:
    """Name the CPU model and the fastest of its `INT8_PRODUCTS`: model names in clouds do not tell these."""
    lines = cpuinfo.read_text().splitlines() if cpuinfo.is_file() else []
    fields = dict(re.split(r"\s*:\s*", line, maxsplit=1) for line in reversed(lines) if ":" in line)
    flags = fields.get("flags", fields.get("Features", "")).split()
    best = next((name for flag, name in INT8_PRODUCTS.items() if flag in flags), None)
    model = fields.get("model name", platform.machine())
    return f"{model} ({best})" if best else model
