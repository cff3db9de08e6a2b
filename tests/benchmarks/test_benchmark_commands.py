"""Every command of the benchmarks starts, says what it does, and takes the shared arguments alike."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

import kinegraph_benchmarks

ROOT = Path(kinegraph_benchmarks.__file__).parent
COMMANDS = sorted(
    ".".join(path.relative_to(ROOT.parent).with_suffix("").parts)
    for path in ROOT.rglob("*.py")
    if 'if __name__ == "__main__"' in path.read_text(encoding="utf-8")
)


def test_there_are_commands_in_every_room() -> None:
    assert len(COMMANDS) >= 23
    assert {name.split(".")[1] for name in COMMANDS} == {"ablations", "quality", "run_all", "speed", "update_card"}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_says_what_it_does(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        module = importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith("kinegraph"):
            raise
        pytest.skip(f"{error.name} is not installed")
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    with pytest.raises(SystemExit) as stopped:
        module.main()
    text = capsys.readouterr().out
    assert stopped.value.code == 0
    assert f"python -m {name} " in text and text.index("python -m") > text.index(module.__doc__.splitlines()[0])
    options = " ".join(text.partition("\noptions:\n")[2].split())
    assert "--bundle" not in options or "the default bundle without it" in options
    assert "--data" not in options or "folder of the captured motion (bandai)" in options
