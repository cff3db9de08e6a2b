"""The sweep over samplers: every setting differs, a stopped run goes on, and the table has what was measured."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from kinegraph import MotionPipeline
from kinegraph_benchmarks.common.report_io import write_json
from kinegraph_benchmarks.common.sample_cache import BundleModel
from kinegraph_benchmarks.quality import sampler_sweep as sweep
from kinegraph_benchmarks.quality.everyday import Prompt


def test_every_setting_asks_for_something_else() -> None:
    asked = {(tuple(changes.items()), tuple(options.items())) for changes, options in sweep.settings().values()}
    assert len(asked) == len(sweep.settings()) == 1 + 10 * 2 + 7 * 2


def test_bundles_share_what_is_loaded(toy: MotionPipeline) -> None:
    model = BundleModel(toy, spacing="trailing")
    assert model.pipe.encoder.sessions is toy.encoder.sessions
    assert model.pipe.manifest.schedule.spacing == "trailing"


def test_a_setting_is_measured_and_timed(toy: MotionPipeline, monkeypatch: Any) -> None:
    monkeypatch.setattr(sweep, "PAIRS", (("walk", "raise-up-both-hands"),))
    monkeypatch.setattr(sweep, "ROUNDS", 1)
    prompts = {"p.jsonl": [Prompt("a person walks", 1.0, ("no_wave",)), Prompt("a person jumps", 1.0, ("jumps",))]}
    row = {"text": sweep.measure_text(toy, prompts, 1, {"steps": 1})}
    assert row["text"]["everyday"]["p.jsonl"]["prompts"] == 2
    assert list(row["text"]["composed"]) == list(sweep.COMPOSED)
    times = sweep.time_settings(toy, {"short": ({}, {"steps": 1}), "long": ({"spacing": "trailing"}, {"steps": 2})})
    assert list(times) == ["short", "long"] and min(times.values()) > 0
    table = sweep.markdown_table({"short": {**row, "ms": 1.25}, "long": row})
    assert table.splitlines()[0] == (
        "| | p.jsonl | both, latent | both, semantic | both, default | both, one sentence | ms a clip |"
    )
    assert "| 1.2 |" in table and table.splitlines()[3].endswith("| - |")


def test_a_stopped_run_goes_on_with_its_own_settings_only(tmp_path: Path) -> None:
    model: Any = type("Model", (), {"name": "toy 1", "stamp": "s"})
    path = tmp_path / "sweep.json"
    new = sweep.read_results(path, model, 5)
    assert new == {"bundle": "toy 1", "stamp": "s", "seeds": 5, "settings": {}}
    new["settings"]["as shipped"] = {"ms": 1.0}
    write_json(path, new)
    assert sweep.read_results(path, model, 5) == new
    assert sweep.read_results(path, model, 6)["settings"] == {}
