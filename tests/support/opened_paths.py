"""Record which paths Python opens, by an audit hook, which sees every way to open one."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_opened: list[str] | None = None
_thread = 0
"""The one whose paths are recorded: others, of servers that earlier tests left, open what they please."""


def _watch(event: str, arguments: tuple[Any, ...]) -> None:
    # An open file that is wrapped a second time shows up as its number.
    if event != "open" or _opened is None or threading.get_ident() != _thread:
        return
    if not isinstance(arguments[0], int):
        _opened.append(os.fsdecode(arguments[0]))


sys.addaudithook(_watch)


@contextmanager
def opened_paths() -> Iterator[list[str]]:
    """Record every path that this thread opens inside the block."""
    global _opened, _thread
    _thread = threading.get_ident()
    _opened = paths = []
    try:
        yield paths
    finally:
        _opened = None
