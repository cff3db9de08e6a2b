"""Check the public CI: it runs what pyproject.toml claims, by the README's commands."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CLASSIFIER = "Programming Language :: Python :: "


def workflow(path: Path) -> dict[Any, Any]:
    yaml = pytest.importorskip("yaml", reason="needs PyYAML, which comes with tokenizers")
    loaded: dict[Any, Any] = yaml.safe_load(path.read_text(encoding="utf-8"))
    return loaded


@pytest.fixture
def matrix() -> dict[str, Any]:
    found: dict[str, Any] = workflow(ROOT / ".github" / "workflows" / "ci.yml")["jobs"]["test"]["strategy"]["matrix"]
    return found


def lower_bounds() -> dict[str, str]:
    """Package -> lowest version of what every install needs."""
    return dict(re.fullmatch(r"([\w-]+)>=([\d.]+)", need).groups() for need in PROJECT["dependencies"])  # type: ignore[union-attr, misc]


def test_every_python_that_the_project_claims_is_run(matrix: dict[str, Any]) -> None:
    claimed = [line.removeprefix(CLASSIFIER) for line in PROJECT["classifiers"] if re.match(rf"{CLASSIFIER}3\.", line)]
    assert matrix["python"] == claimed
    assert PROJECT["requires-python"] == f">={claimed[0]}"


def test_every_platform_is_run(matrix: dict[str, Any]) -> None:
    assert [name.partition("-")[0] for name in matrix["os"]] == ["ubuntu", "ubuntu", "macos", "windows"]
    assert any(name.endswith("-arm") for name in matrix["os"])


def test_the_lowest_and_the_newest_dependencies_are_run(matrix: dict[str, Any]) -> None:
    assert {*matrix["dependencies"], *(row["dependencies"] for row in matrix["include"])} == {"newest", "lowest"}
    lines = (ROOT / ".ci" / "lowest.txt").read_text(encoding="utf-8").splitlines()
    pins = dict(line.split("==") for line in lines if not line.startswith("#"))
    assert {"numpy", "onnxruntime"} <= {*pins}
    for package, bound in lower_bounds().items():
        assert f"{pins[package]}.".startswith(f"{bound}."), package


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_jobs_may_do_little_and_run_what_was_reviewed(path: Path) -> None:
    loaded = workflow(path)
    assert loaded["permissions"] == {}
    for job in loaded["jobs"].values():
        assert job["permissions"] == {"contents": "read"}
        assert job["timeout-minutes"] > 0
        for step in job["steps"]:
            assert re.search(r"@[0-9a-f]{40}$", step.get("uses", f"@{40 * '0'}"))


def test_commands_of_the_readme_are_named_as_they_are_marked() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    text = "".join(path.read_text(encoding="utf-8") for path in (*WORKFLOWS, ROOT / ".ci" / "run"))
    names = re.findall(r"readme_command '([^']+)'|run_readme \"([^$\"]+)\"", text)
    assert len(names) >= 5
    for name in map("".join, names):
        assert f"<!-- {name} -->\n```sh\n" in readme
