"""The examples, run as a user runs them: as scripts, in an empty folder."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import kinegraph

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
ONE_SCREEN = 36
"""Lines."""

RUNS = {
    "asynchronous": ("a person bows: 60 frames\na person runs: too late, stopped\n", []),
    "compose": ("walk_cycle.glb", ["scene.glb", "walk_cycle.glb", "walk_waving.glb"]),
    "edit_graph": ("True\n", ["graph.json"]),
    "embed": ("80 frames at 20 per second, seed 7", ["walk.glb"]),
    "follow_path": ("a person walks forward: path of ", ["walk_along.glb", "wave_after.glb"]),
    "many_clips_ray": ("000001.npz: 60 frames, a person bows", ["clips"]),
    "progress_and_cancel": ("out of time: stopped by on_step at step", []),
    "takes": ("seed 22, ", ["best.glb", *(f"turn_{seed}.bvh" for seed in (20, 21, 22, 23))]),
}
"""Example -> what it prints among other things, and the files it makes."""


def test_every_example_is_run_here_and_fits_a_screen() -> None:
    sources = {path.stem: path.read_text(encoding="utf-8") for path in EXAMPLES.glob("*.py")}
    assert sorted(sources) == sorted(RUNS)
    assert {name: len(text.splitlines()) for name, text in sources.items() if len(text.splitlines()) > ONE_SCREEN} == {}
    assert len(sources["embed"].splitlines()) == 10


@pytest.mark.parametrize("name", sorted(RUNS))
def test_an_example_runs(tmp_path: Path, name: str) -> None:
    pytest.importorskip("spacy")
    if name.endswith("_ray"):
        pytest.importorskip("ray.data", reason="needs Ray: pip install 'ray[data]'")
    says, files = RUNS[name]
    environment = {**os.environ, "PYTHONPATH": str(Path(kinegraph.__file__).resolve().parents[1])}
    for _ in range(2 if name == "embed" else 1):  # a file that is there from the last time is no hindrance
        done = subprocess.run(
            [sys.executable, str(EXAMPLES / f"{name}.py")],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert done.stderr == "" or name.endswith("_ray")  # Ray reports its progress there
        assert says in done.stdout
        assert sorted(path.name for path in tmp_path.iterdir()) == files
