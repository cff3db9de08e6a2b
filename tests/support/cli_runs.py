"""Helpers of tests that run the command line."""

from __future__ import annotations

import pytest

from kinegraph import cli
from kinegraph.errors import InvalidInputError
from kinegraph.graph import Action, SemanticGraph


def fails(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run a command that must fail, and return its one line on stderr."""
    assert cli.main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert captured.err.startswith("kinegraph: error: ")
    return captured.err


def not_loaded(*_: object, **__: object) -> None:
    """Stand in for `MotionPipeline.load` where it must not be called."""
    raise AssertionError("a bundle was loaded although the input is bad")


def whole(caption: str) -> SemanticGraph:
    """Make a graph whose one action is the whole caption."""
    return SemanticGraph(caption, (Action(caption, 0, len(caption), 0),))


class Parser:
    """Stand-in for the pipeline where only parsing is needed."""

    def parse(self, text: str) -> SemanticGraph:
        if not text.strip():
            raise InvalidInputError("the text is blank")
        return whole(text)
