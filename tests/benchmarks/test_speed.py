"""The benchmarks of speed: arms take turns, nothing is dropped, gates and tables say what the numbers say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from kinegraph_benchmarks.common import timing

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")

from kinegraph_benchmarks.quality import precision
from kinegraph_benchmarks.speed import scaling, speed_table

MACHINE = {"cpu": "a CPU", "cpus": 2, "kinegraph": "1", "onnxruntime": "1", "python": "3"}


def test_arms_take_turns_and_every_repeat_is_kept() -> None:
    calls: list[str] = []
    times = timing.time_interleaved({name: lambda name=name: calls.append(name) for name in "ab"}, 3, warm_up=1)
    assert calls == list("abababab")
    assert {name: len(values) for name, values in times.items()} == {"a": 3, "b": 3}
    assert all(value >= 0 for values in times.values() for value in values)


def test_the_summary_compares_minima() -> None:
    text = timing.timing_table({"slow": [40.0, 20.0], "fast": [5.0, 50.0]}, against="slow")
    assert "| slow | 30.0 | 20.0 |" in text and text.endswith("4.00 |")


def test_a_line_knows_a_curve() -> None:
    straight = scaling.fit_line({f"{n} frames": [3.0 + 0.5 * n, 999.0] for n in (20, 100, 196)})
    assert straight["start_ms"] == pytest.approx(3.0) and straight["per_unit_ms"] == pytest.approx(0.5)
    assert straight["deviation"] == pytest.approx(0.0, abs=1e-9)
    assert scaling.fit_line({f"{n} frames": [float(n * n)] for n in (20, 100, 196)})["deviation"] > 0.1


def test_throughput_counts_clips() -> None:
    assert scaling.throughput({"batch of 1": [50.0, 20.0], "batch of 16": [160.0]}) == {
        "batch of 1": 50.0,
        "batch of 16": 100.0,
    }


def gate(behaviour: float, r_precision: float, milliseconds: float) -> dict[str, bool]:
    def of(first: float, second: float) -> dict[str, Any]:
        values = dict(zip(precision.GATED, (first, second), strict=True))
        return {name: {"mean": value, "plus_minus": 0.02} for name, value in values.items()}

    scores = {"reference": of(0.9, 0.99), "candidate": of(behaviour, r_precision)}
    return precision.check_gate({"scores": scores, "times_ms": {"reference": [9.0, 10.0], "candidate": [milliseconds]}})


def test_int8_passes_only_within_the_interval_and_only_faster() -> None:
    assert all(gate(0.89, 0.98, 8.0).values())
    assert gate(0.87, 0.98, 8.0) == {"behaviour": False, "r_precision_1": True, "faster": True}
    assert gate(0.95, 0.96, 8.0) == {"behaviour": True, "r_precision_1": False, "faster": True}
    assert not gate(0.9, 0.99, 9.5)["faster"]


def test_the_report_takes_what_is_there_and_refuses_quick_runs(tmp_path: Path) -> None:
    found = {
        "machine": MACHINE,
        "seconds": 4.0,
        "idle_cpu": 0.001,
        "stages": {"total": [50.0, 40.0], "write": [10.0, 10.0]},
        "cold": {"graph": {"milliseconds": [400.0, 380.0], "peak_bytes": 160_000_000}},
    }
    (tmp_path / "bench.json").write_text(json.dumps(found))
    text = speed_table.markdown_table([tmp_path])
    assert "35 ms (least 30)" in text and "380 ms, peak memory 160 MB" in text and "0.1%" in text
    (tmp_path / "low_power.json").write_text(json.dumps({"machine": MACHINE, "quick": True, "reports": {}}))
    with pytest.raises(ValueError, match="quick run"):
        speed_table.markdown_table([tmp_path])


def test_each_machine_has_its_column(tmp_path: Path) -> None:
    times = {"reference": [20.0, 16.0], "candidate": [10.0, 12.0]}
    for name, cpu, scale in (("here", "this CPU", 1.0), ("there", "that CPU", 4.0)):
        (tmp_path / name).mkdir()
        found = {
            "machine": {**MACHINE, "cpu": cpu},
            "distance_mm": {"world_mean": scale, "local_mean": 1.0},
            "scores": {
                part: {"behaviour": {"mean": 1}, "r_precision_1": {"mean": 1}} for part in ("candidate", "reference")
            },
            "times_ms": times,
        }
        (tmp_path / name / "precision.json").write_text(json.dumps(found))
    reports = {"reports": {"one core": {"stages": {"total": [30.0]}}}, "machine": {**MACHINE, "cpu": "that CPU"}}
    (tmp_path / "there" / "low_power.json").write_text(json.dumps(reports))
    lines = speed_table.markdown_table([tmp_path / "here", tmp_path / "there"]).splitlines()
    assert lines[0].split(" | ")[1].startswith("this CPU") and lines[0].split(" | ")[2].startswith("that CPU")
    assert "| int8 is faster | 1.60 x | 1.60 x |" in lines
    assert (
        "| joints of int8 and fp32 apart | 1 mm, around the pelvis 1.0 mm | 4 mm, around the pelvis 1.0 mm |" in lines
    )
    assert "| sentence to file on one core |  | 30 ms |" in lines
    (tmp_path / "here" / "low_power.json").write_text(json.dumps(reports))
    with pytest.raises(ValueError, match="was measured on this CPU, others on that CPU"):
        speed_table.markdown_table([tmp_path / "here"])


def test_a_folder_without_results_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"has none of bench\.json"):
        speed_table.markdown_table([tmp_path])
