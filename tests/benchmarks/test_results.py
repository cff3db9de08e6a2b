"""The stored results: each has its place, its line in the README, and its bundle."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

RESULTS = Path(__file__).resolve().parents[2] / "benchmarks" / "results"


def test_the_readme_names_every_file_and_no_other() -> None:
    named = set(re.findall(r"\]\(([^)]+)\)", (RESULTS / "README.md").read_text(encoding="utf-8")))
    stored = {path.relative_to(RESULTS).as_posix() for path in RESULTS.rglob("*") if path.is_file()}
    assert stored == named | {"README.md"}
    assert all(re.fullmatch(r"\d+\.\d+\.\d+(/[a-z0-9]+)?/[a-z_]+\.(md|json)", name) for name in named)


@pytest.mark.parametrize("path", sorted(RESULTS.glob("*/*/*.json")), ids=lambda path: path.name)
def test_a_result_lies_with_its_bundle(path: Path) -> None:
    result = json.loads(path.read_text(encoding="utf-8"))
    bundle = path.relative_to(RESULTS).parts[0]
    assert result.get("machine", {}).get("kinegraph", bundle) == bundle
    name = "studio" if bundle in ("0.7.0", "0.8.0", "0.9.0") else "edge"
    assert result.get("bundle", f"{name} {bundle}") == f"{name} {bundle}"
    assert not result.get("quick")


def test_the_speed_table_is_that_of_the_stored_results() -> None:
    pytest.importorskip("torch")
    pytest.importorskip("onnxscript")
    from kinegraph_benchmarks.speed.speed_table import markdown_table

    folders = [RESULTS / "0.6.0" / "zen3", RESULTS / "0.5.0" / "zen5"]
    assert markdown_table(folders) == (folders[0] / "speed.md").read_text(encoding="utf-8")
