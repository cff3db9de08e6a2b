"""Run the commands and programs of README.md and docs/, as a reader would.

Every `python` block runs, all blocks of a page as one program. A `sh` block runs if the line before it is
`<!-- run -->`; all of a page share a folder. Other `sh` blocks are not run here: they install, train, or take long.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from kinegraph import MotionPipeline

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "README.md", *(ROOT / "docs").glob("*.md")))
FENCE = re.compile(
    r"^(?:<!-- (?P<marker>[^>]*) -->\n)?```(?P<language>\w+)\n(?P<body>.*?)^```$", re.MULTILINE | re.DOTALL
)


@dataclass(frozen=True)
class Block:
    """One fenced block of a page."""

    line: int
    """Line of its first line in the page, from 1."""
    marker: str
    body: str


def blocks(page: str, language: str) -> list[Block]:
    text = (ROOT / page).read_text(encoding="utf-8")
    found = []
    for match in FENCE.finditer(text):
        if match["language"] == language:
            line = 1 + text.count("\n", 0, match.start("body"))
            found.append(Block(line, match["marker"] or "", match["body"]))
    return found


PROGRAMS = [page for page in PAGES if blocks(page, "python")]
COMMANDS = [page for page in PAGES if any(block.marker == "run" for block in blocks(page, "sh"))]


@pytest.fixture(scope="module")
def default_pipeline(pipe: MotionPipeline) -> Iterator[MotionPipeline]:
    """The default bundle, which all programs share: loading it is not what they are about."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MotionPipeline, "load", lambda *_, **__: pipe)
        yield pipe


@pytest.mark.parametrize("page", PROGRAMS)
def test_the_programs_of_a_page_run(
    page: str, default_pipeline: MotionPipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "__main__"}
    for block in blocks(page, "python"):
        # Blank lines in front: a traceback names the line of the page.
        exec(compile("\n" * (block.line - 1) + block.body, str(ROOT / page), "exec"), names)  # noqa: S102


@pytest.mark.skipif(os.name != "posix", reason="the commands are written for a POSIX shell")
@pytest.mark.parametrize("page", COMMANDS)
def test_the_commands_of_a_page_run(page: str, tmp_path: Path) -> None:
    pytest.importorskip("spacy")
    scripts = Path(sys.executable).parent
    if shutil.which("kinegraph", path=scripts) is None:
        pytest.skip(f"no command kinegraph in {scripts}: install the project into this environment")
    environment = {**os.environ, "PATH": f"{scripts}{os.pathsep}{os.environ['PATH']}"}
    for block in blocks(page, "sh"):
        if block.marker != "run":
            continue
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", block.body],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert done.returncode == 0, f"{page}, line {block.line}:\n{done.stdout[-2000:]}{done.stderr[-2000:]}"


def test_every_page_with_programs_and_commands_is_run() -> None:
    assert {"README.md", "docs/python.md", "docs/graph.md", "docs/composition.md"} <= {*PROGRAMS}
    assert {"docs/cli.md", "docs/engines.md", "docs/own-data.md"} <= {*COMMANDS}
