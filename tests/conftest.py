"""What tests of several folders share: a loaded bundle, its playground, and figures that stand at the end of the test
output, passed or failed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

import pytest
from playing import TEXT, Playing, playing

from kinegraph import MotionPipeline

_FIGURES: Final = pytest.StashKey[list[str]]()


@pytest.fixture(scope="module")
def pipe() -> MotionPipeline:
    """The default bundle, its parser loaded."""
    pytest.importorskip("spacy")
    found = MotionPipeline.load(threads=1)
    found.parse(TEXT)
    return found


@pytest.fixture(scope="module")
def server(pipe: MotionPipeline) -> Iterator[Playing]:
    """Its playground."""
    pytest.importorskip("uvicorn")
    with playing(pipe) as found:
        yield found


@pytest.fixture
def figure(request: pytest.FixtureRequest) -> Callable[[str], None]:
    """Note one line for the summary."""
    return request.config.stash.setdefault(_FIGURES, []).append


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Called by pytest when all tests have run."""
    lines = config.stash.get(_FIGURES, [])
    if lines:
        terminalreporter.section("measured figures")
        for line in sorted(lines):
            terminalreporter.write_line(line)
