"""The comparison of training on composed motion: rows differ in the data alone, and the table says which is which."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("torch")

from kinegraph_benchmarks.ablations import compml
from kinegraph_benchmarks.ablations.training_runs import COLUMNS
from kinegraph_training.config import read_preset


def evaluation(value: float) -> dict[str, Any]:
    """The result of `quality.evaluate`, as far as it is read."""
    made = {column: {"mean": value} for column in COLUMNS}
    captured = {column: {"mean": 0.5} for column in COLUMNS}
    apart = {"joined_in_training": {"clips": 3, "both_hold": value}, "held_out": {"clips": 2, "both_hold": value / 2}}
    two = {
        "generated": {"both_hold": {"mean": value}},
        "captured": {"both_hold": {"mean": 0.75}},
        "generated_apart": apart,
        "captured_apart": {name: {"clips": 1, "both_hold": 0.875} for name in apart},
    }
    splits = {name: {"captured": captured, "generated": {"mean": made}} for name in ("dev_test", "dev_compositional")}
    return {"splits": splits, "two_actions": {"in_order": two, "together": two}}


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """The commands that were run; an evaluation of the k-th of them says 0.1 k."""
    commands: list[list[str]] = []

    def run(command: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        commands.append(command)
        if command[2] == "kinegraph_benchmarks.quality.evaluate":
            Path(command[command.index("--out") + 1]).write_text(json.dumps(evaluation(0.1 * len(commands))))
        return subprocess.CompletedProcess(command, 0)

    monkeypatch.setattr(subprocess, "run", run)
    return commands


def call(monkeypatch: pytest.MonkeyPatch, folder: Path, *more: str) -> None:
    words = ["--data", "D", "--held-out", "H", "--start", str(folder / "start"), "--work", str(folder / "work")]
    words += ["--steps", "40", "--count", "7", "--out", str(folder / "out.json"), *more]
    monkeypatch.setattr(sys, "argv", ["compml", *words])
    assert compml.main() == 0


def without(command: list[str], *names: str) -> list[str]:
    """A command without some flags and their values."""
    kept = list(command)
    for name in names:
        if name in kept:
            index = kept.index(name)
            del kept[index : index + 2]
    return kept


def test_rows_differ_in_the_data_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, ran: list[list[str]]) -> None:
    for name in (*compml.AUTOENCODERS, "denoisers"):
        (tmp_path / "start" / name).mkdir(parents=True)
    call(monkeypatch, tmp_path, "--seeds", "1", "2")
    assert all(command[1] == "-m" for command in ran)
    kinds = [command[2].rpartition(".")[2] for command in ran]
    assert kinds == ["compml", "evaluate"] + 4 * ["train_denoisers", "evaluate"]
    assert ran[0][ran[0].index("--count") + 1] == "7"
    training = [command for command, kind in zip(ran, kinds, strict=True) if kind == "train_denoisers"]
    for recorded, composed in (training[:2], training[2:]):
        assert "--more" not in recorded and composed[composed.index("--more") + 1] == str(
            tmp_path / "work" / "composed"
        )
        differing = ("--run", "--preset", "--more")
        assert without(recorded, *differing) == without(composed, *differing)
        presets = [Path(command[command.index("--preset") + 1]).read_text() for command in (recorded, composed)]
        assert presets[0] == presets[1]
        assert recorded[recorded.index("--start-from") + 1] == str(tmp_path / "start" / "denoisers" / "last.ckpt")
    ran.clear()
    call(monkeypatch, tmp_path, "--seeds", "1", "2")
    assert len(ran) == 1, "only what is composed is looked at again"


def test_the_table_names_every_row(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, ran: list[list[str]]) -> None:
    (tmp_path / "start").mkdir()
    call(monkeypatch, tmp_path)
    text = (tmp_path / "out.md").read_text()
    # evaluations were the 2nd, 4th and 6th command
    for name, value in (("captured", 0.5), ("before", 0.2), ("recorded", 0.4), ("recorded + composed", 0.6)):
        assert text.count(f"| {name} |" + f" {value:.3f} |" * len(COLUMNS)) == 2
    both = text[text.index("both actions happen") :]
    assert "| captured | 0.750 | 0.875 | 0.875 | 0.750 | 0.875 | 0.875 |" in both
    assert "| recorded + composed | 0.600 | 0.600 | 0.300 | 0.600 | 0.600 | 0.300 |" in both


def test_a_fine_tune_has_half_the_rate_of_its_preset(tmp_path: Path) -> None:
    (tmp_path / "preset.toml").write_text(compml.preset_toml("edge", 3, 400))
    preset, edge = read_preset(str(tmp_path / "preset.toml")), read_preset("edge")
    assert preset.denoiser_training.learning_rate == edge.denoiser_training.learning_rate / 2
    assert (preset.denoiser_training.steps, preset.denoiser_training.warmup, preset.seed) == (400, 40, 3)
    assert preset.data == edge.data and preset.denoiser == edge.denoiser
