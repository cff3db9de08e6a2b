"""`kinegraph bench`: every stage is there, and the stages make up the whole."""

from __future__ import annotations

import json
import platform
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from kinegraph import bench, cli
from kinegraph.bundle.contract import LEVELS
from support.cli_runs import fails

NUMPY_STAGES = {"joints", "write"}


@pytest.fixture(scope="module")
def report() -> bench.BenchReport:
    return bench.bench(seconds=1.0, repeats=3, threads=1, cold=1)


def test_the_stages_make_up_the_whole(report: bench.BenchReport) -> None:
    names = [name for name in bench.STAGES if name in report.stages]
    assert set(bench.STAGES) - set(names) <= {"parse"}
    assert all(len(report.stages[name]) == 3 for name in (*names, "total"))
    parts, total = sum(np.array(report.stages[name]) for name in names), np.array(report.stages["total"])
    # all but what lies between the stages: features of nodes, the rows of the graph encoder
    assert (parts <= total).all() and (parts >= 0.7 * total).all()


def test_where_and_with_what_is_told(report: bench.BenchReport) -> None:
    assert {"cpu", "cpus", "python", "numpy", "onnxruntime", "kinegraph"} <= set(report.machine)
    assert report.threads == {"steps": 1, "others": 1}
    assert 0.0 <= report.idle_cpu < 0.2
    text = bench.text_table(report)
    assert all(
        word in text for word in (*LEVELS, "p99", "times as fast", "first file of a fresh process, from a graph")
    )


@pytest.mark.parametrize(
    ("cpuinfo", "name"),
    [
        (
            "model name\t: AMD EPYC\nflags\t\t: sse2 avx2 avx512_vnni\n\nmodel name\t: AMD EPYC\n",
            "AMD EPYC (AVX-512 VNNI)",
        ),
        ("model name\t: AMD EPYC\nflags\t\t: sse2 avx2 sha_ni\n", "AMD EPYC (AVX2)"),
        ("processor\t: 0\nFeatures\t: fp asimd asimddp\n", f"{platform.machine()} (dot products)"),
        ("model name\t: an old CPU: 2 GHz\nflags\t\t: sse2\n", "an old CPU: 2 GHz"),
        ("", platform.machine()),
    ],
)
def test_the_cpu_is_named_with_what_int8_runs_on(tmp_path: Path, cpuinfo: str, name: str) -> None:
    (tmp_path / "cpuinfo").write_text(cpuinfo)
    assert bench._cpu_name(tmp_path / "cpuinfo") == name
    assert bench._cpu_name(tmp_path / "none") == platform.machine()


def test_a_fresh_process_is_timed_and_its_memory_told(report: bench.BenchReport) -> None:
    start = report.cold["graph"]
    assert start.milliseconds[0] > report.stages["motion"][0]
    if sys.platform == "linux":
        assert start.peak_bytes is not None and 60e6 < start.peak_bytes < 400e6


def test_without_spacy_all_but_parsing_is_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] == "spacy"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "spacy", None)
    report = bench.bench(seconds=1.0, repeats=1, threads=1, cold=0 + 1)
    assert "parse" not in report.stages and set(report.cold) == {"graph"}


def test_on_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench, "bench", partial(bench.bench, cold=1))
    out = tmp_path / "bench.json"
    assert cli.main(["bench", "--seconds", "1", "--repeats", "2", "--threads", "1", "--json", str(out)]) == 0
    assert "p50" in capsys.readouterr().out
    report = json.loads(out.read_text(encoding="utf-8"))
    assert len(report["stages"]["decode"]) == 2 and report["machine"]["onnxruntime"]
    assert "repeats must be" in fails(capsys, "bench", "--repeats", "0")
    assert "seconds must be" in fails(capsys, "bench", "--seconds", "99")
    assert "suffix" in fails(capsys, "bench", "--json", str(tmp_path / "bench.txt"))
