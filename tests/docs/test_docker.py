"""The Dockerfile, as far as it can be checked without docker: what it copies, installs, opens and starts is there."""

from __future__ import annotations

import json
import re
import tomllib
from fnmatch import fnmatch
from pathlib import Path

import pytest

from kinegraph.cli import main

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def instructions() -> dict[str, str]:
    """Instruction -> its words; each is there once."""
    lines = (ROOT / "Dockerfile").read_text(encoding="utf-8").splitlines()
    found = [line.partition(" ") for line in lines if line and not line.startswith("#")]
    assert len({name for name, _, _ in found}) == len(found)
    return {name: words for name, _, words in found}


def test_it_says_nothing_that_is_not_checked_here() -> None:
    assert set(instructions()) == {"FROM", "COPY", "RUN", "USER", "EXPOSE", "ENTRYPOINT"}


def test_its_python_is_one_that_the_project_claims() -> None:
    version = re.fullmatch(r"python:(3\.\d+)-slim", instructions()["FROM"])
    assert version and f"Programming Language :: Python :: {version[1]}" in PROJECT["project"]["classifiers"]


def test_it_copies_and_installs_what_is_there() -> None:
    source, target = instructions()["COPY"].split()
    assert (ROOT / source).is_dir()
    install, remove, user = instructions()["RUN"].split(" && ")
    wanted = re.search(rf'pip install --no-cache-dir "{target}\[([\w,]+)\]"$', install)
    assert wanted and set(wanted[1].split(",")) <= set(PROJECT["project"]["optional-dependencies"])
    assert remove == f"rm -rf {target}" and user.endswith(f" {instructions()['USER']}")


def test_what_an_install_needs_is_not_left_out() -> None:
    ignored = [
        line for line in (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines() if not line.startswith("#")
    ]
    project = PROJECT["project"]
    needed = ["pyproject.toml", project["readme"], "LICENSE"]
    needed += PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
    for path in needed:
        assert (ROOT / path).exists()
        parts = [path.split("/")[0], path]
        assert not any(fnmatch(part, pattern) for part in parts for pattern in ignored), path


def test_it_starts_a_command_that_takes_these_words(capsys: pytest.CaptureFixture[str]) -> None:
    program, *words = json.loads(instructions()["ENTRYPOINT"])
    assert program in PROJECT["project"]["scripts"] and words == ["serve", "--host", "0.0.0.0"]
    with pytest.raises(SystemExit) as stopped:
        main([*words, "--help"])
    assert stopped.value.code == 0
    port = re.search(r"default (\d+); 0 takes", capsys.readouterr().out)
    assert port and instructions()["EXPOSE"] == port[1]


def test_without_a_token_nothing_starts(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("starlette")
    monkeypatch.delenv("KINEGRAPH_TOKEN", raising=False)
    _, *words = json.loads(instructions()["ENTRYPOINT"])
    assert main(words) == 2
    assert "token" in capsys.readouterr().err


def test_the_documented_command_is_that_of_the_file() -> None:
    head = (ROOT / "Dockerfile").read_text(encoding="utf-8").splitlines()[0]
    command = head.partition(": ")[2]
    assert command in (ROOT / "docs" / "service.md").read_text(encoding="utf-8")
    assert f"-p {instructions()['EXPOSE']}:{instructions()['EXPOSE']}" in command and "-e KINEGRAPH_TOKEN" in command
