"""Fixtures of several folders, figures printed after the tests, and the options `--only-skipped` and `--promises`."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final

import onnxruntime
import pytest

from kinegraph import MotionPipeline
from kinegraph.bundle import reader
from support.playground import TEXT, PlaygroundClient, running_playground
from support.synthetic_bundle import write_bundle
from support.toy import with_parser
from support.workers import shared_folder

if TYPE_CHECKING:
    from support.tracing import Traces

_FIGURE: Final = "figure"
_SKIPPED: Final = "kinegraph/skipped"
"""Key of pytest's cache: node ids of the tests and files that the last whole run skipped."""

if "PYTEST_XDIST_WORKER" in os.environ:
    # every worker has a CPU; torch reads this when it is imported
    os.environ.setdefault("OMP_NUM_THREADS", "1")


@pytest.fixture(scope="session")
def pipe() -> MotionPipeline:
    """The default bundle, its parser loaded."""
    pytest.importorskip("spacy")
    pipeline = MotionPipeline.load(threads=1)
    pipeline.parse(TEXT)
    return pipeline


@pytest.fixture(scope="session")
def toy_bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the toy bundle, the default bundle's parser in it; only read it."""
    return with_parser(tmp_path_factory.mktemp("toy_bundle") / "bundle")


@pytest.fixture(scope="session")
def toy(toy_bundle: Path) -> MotionPipeline:
    """The toy bundle, its parser loaded where spaCy is installed: in float32 identities hold to rounding."""
    pipeline = MotionPipeline.load(toy_bundle, threads=1)
    if find_spec("spacy"):
        pipeline.parse(TEXT)
    return pipeline


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    return write_bundle(tmp_path / "bundle")


@pytest.fixture
def no_sessions(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a session was made from a bundle that was not checked")

    monkeypatch.setattr(onnxruntime, "InferenceSession", refuse)


@pytest.fixture
def toy_by_default(toy_bundle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let commands of this process that name no bundle load the toy."""
    monkeypatch.setattr(reader, "DEFAULT_BUNDLE", toy_bundle)


@pytest.fixture(scope="module")
def server(pipe: MotionPipeline) -> Iterator[PlaygroundClient]:
    """A playground of the default bundle."""
    pytest.importorskip("uvicorn")
    with running_playground(pipe) as playground:
        yield playground


@pytest.fixture(scope="module")
def traces(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Traces]:
    """Graphs that are exported in this module are traced once in the whole run of the tests."""
    pytest.importorskip("torch")
    pytest.importorskip("onnxscript")
    from support.tracing import traced_once

    with traced_once(shared_folder(tmp_path_factory, "traces")) as found:
        yield found


@pytest.fixture
def figure(request: pytest.FixtureRequest) -> Callable[[str], None]:
    """Note one measured figure, to be printed after the tests."""
    return lambda line: request.node.user_properties.append((_FIGURE, line))


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--only-skipped",
        action="store_true",
        help="run what the last whole run skipped, and tests marked with_extras: for a second run with more installed",
    )
    parser.addoption(
        "--promises",
        choices=("short", "long"),
        default="short",
        help="how much tests/promises tries: short is for every day, long has the counts that SECURITY.md promises",
    )


@pytest.fixture(scope="session")
def is_long(request: pytest.FixtureRequest) -> bool:
    """Whether `--promises=long` asks for the counts of SECURITY.md."""
    return bool(request.config.getoption("--promises") == "long")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep what `--only-skipped` asks for, files with slow tests first, so that no worker ends with one alone."""
    cache = getattr(config, "cache", None)  # missing with -p no:cacheprovider
    skipped = cache and cache.get(_SKIPPED, None)
    if config.getoption("--only-skipped") and skipped is not None:  # without a run before, everything runs
        chosen, others = [], []
        for item in items:
            again = item.get_closest_marker("with_extras") or {item.nodeid, item.nodeid.split("::")[0]} & set(skipped)
            (chosen if again else others).append(item)
        config.hook.pytest_deselected(items=others)
        items[:] = chosen
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Remember what was skipped and print the figures; reports of other processes (xdist) come here too."""
    whole = config.args_source is pytest.Config.ArgsSource.TESTPATHS and not config.getoption("--only-skipped")
    cache = getattr(config, "cache", None)
    if whole and cache:
        cache.set(_SKIPPED, sorted({report.nodeid for report in terminalreporter.stats.get("skipped", [])}))
    reports = [report for outcome in ("passed", "failed") for report in terminalreporter.stats.get(outcome, [])]
    lines = [line for report in reports for name, line in report.user_properties if name == _FIGURE]
    if lines:
        terminalreporter.section("measured figures")
        for line in sorted(lines):
            terminalreporter.write_line(line)
