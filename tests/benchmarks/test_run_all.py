"""run_all: what has a result is not run again, and what failed is told."""

from __future__ import annotations

import contextlib
import importlib
import io
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from kinegraph_benchmarks import run_all

NAMES = ["reconstruction", "behaviour", "lengths", "waves", "turns", "sequences", "constraints", "take_equality",
         "negations", "wording", "everyday", "foot_fix", "evaluate", "masked_verbs", "edit_curves",
         "composition_settings", "composition", "temporal_composition", "mtt", "sampling", "compare",
         "latent_tokens"]  # fmt: skip
BROKEN = NAMES.index("masked_verbs") + 1


def result_of(command: list[str]) -> Path:
    return Path(command[command.index("--out") + 1])


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Commands in the order of running; each writes its table, but for masked_verbs, which breaks before."""
    commands: list[list[str]] = []

    def run(command: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        commands.append(command)
        name = result_of(command).stem
        result_of(command).write_text("{}")  # as long ones do after every row
        if name != "masked_verbs":
            result_of(command).with_suffix(".md").write_text(f"| table of {name} |\n")
        return subprocess.CompletedProcess(command, 1, f"| table of {name} |\n", "")

    monkeypatch.setattr(subprocess, "run", run)
    return commands


def call(monkeypatch: pytest.MonkeyPatch, folder: Path, *more: str) -> int:
    words = ["--data", "D", "--held-out", "H", "--run", "R", "--out", str(folder), *more]
    monkeypatch.setattr(sys, "argv", ["run_all", *words])
    return run_all.main()


def test_a_stopped_page_goes_on(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, ran: list[list[str]]) -> None:
    assert call(monkeypatch, tmp_path) == 1
    assert [result_of(command).stem for command in ran] == NAMES[:BROKEN]
    (tmp_path / "masked_verbs.md").write_text("by hand")
    assert call(monkeypatch, tmp_path) == 0
    assert [result_of(command).stem for command in ran[BROKEN:]] == NAMES[BROKEN:]
    assert call(monkeypatch, tmp_path) == 0 and len(ran) == len(NAMES)
    page = (tmp_path / "README.md").read_text()
    order = [page.index(f"table of {name} |") for name in NAMES if name != "masked_verbs"]
    assert order == sorted(order) and "by hand" in page


def test_every_module_is_there_and_knows_its_arguments(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, ran: list[list[str]]
) -> None:
    for requirement in ("torch", "onnx", "onnxscript", "spacy"):
        pytest.importorskip(requirement)
    (tmp_path / "masked_verbs.md").write_text("by hand")
    assert call(monkeypatch, tmp_path, "--compare-steps", "0") == 0
    assert {result_of(command).stem for command in ran} == {*NAMES[:-2]} - {"masked_verbs"}
    assert call(monkeypatch, tmp_path) == 0
    assert [result_of(command).stem for command in ran[-2:]] == NAMES[-2:]
    for command in ran:
        assert command[:2] == [sys.executable, "-m"]
        monkeypatch.setattr(sys, "argv", [command[2], "--help"])
        text = io.StringIO()
        with contextlib.redirect_stdout(text), pytest.raises(SystemExit):
            importlib.import_module(command[2]).main()
        assert all(word in text.getvalue() for word in command if word.startswith("--")), command
