"""What tests of several folders share: a loaded bundle, its playground, and figures that stand at the end of the test
output, passed or failed."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from typing import Final

import pytest

from kinegraph import MotionPipeline
from support.playground import TEXT, PlaygroundClient, running_playground

_FIGURE: Final = "figure"

if "PYTEST_XDIST_WORKER" in os.environ:
    # every worker has a CPU; torch reads this when it is imported
    os.environ.setdefault("OMP_NUM_THREADS", "1")


@pytest.fixture(scope="module")
def pipe() -> MotionPipeline:
    """The default bundle, its parser loaded."""
    pytest.importorskip("spacy")
    found = MotionPipeline.load(threads=1)
    found.parse(TEXT)
    return found


@pytest.fixture(scope="module")
def server(pipe: MotionPipeline) -> Iterator[PlaygroundClient]:
    """Its playground."""
    pytest.importorskip("uvicorn")
    with running_playground(pipe) as found:
        yield found


@pytest.fixture
def figure(request: pytest.FixtureRequest) -> Callable[[str], None]:
    """Note one line for the summary."""
    return lambda line: request.node.user_properties.append((_FIGURE, line))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Called by pytest when all tests have run; properties come with the reports of other processes too."""
    reports = [report for outcome in ("passed", "failed") for report in terminalreporter.stats.get(outcome, [])]
    lines = [line for report in reports for name, line in report.user_properties if name == _FIGURE]
    if lines:
        terminalreporter.section("measured figures")
        for line in sorted(lines):
            terminalreporter.write_line(line)
