"""What the command line shows: the progress line, JSON, and the tables of `info` and `verify`."""

from __future__ import annotations

import json
import sys
from types import TracebackType
from typing import TYPE_CHECKING, Final, Self, TextIO

if TYPE_CHECKING:
    from kinegraph.diffusion.sampling import StepInfo

_BAR: Final = 24
_CLEAR_LINE: Final = "\r\x1b[K"


class Progress:
    """One line on stderr that is rewritten at every step and gone at the end."""

    def __init__(self, stream: TextIO | None) -> None:
        """Show on `stream`; None shows nothing."""
        self._stream = stream

    @classmethod
    def on_stderr(cls, *, quiet: bool, forced: bool) -> Self:
        """A line for people at a terminal; a log file gets none unless asked for."""
        wanted = forced or sys.stderr.isatty()
        return cls(sys.stderr if wanted and not quiet else None)

    def show(self, info: StepInfo) -> None:
        """Callback of `generate`; never asks to stop."""
        if self._stream is not None:
            bar = ("#" * (_BAR * info.done // info.total)).ljust(_BAR, ".")
            self._stream.write(f"{_CLEAR_LINE}[{bar}] {info.level} {info.step}/{info.steps}")
            self._stream.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._stream is not None:
            self._stream.write(_CLEAR_LINE)
            self._stream.flush()


def as_json(value: object, *, pretty: bool = False) -> str:
    """JSON for stdout; escapes what a terminal that is not UTF-8 could not take."""
    utf8 = (sys.stdout.encoding or "").lower().replace("-", "") == "utf8"
    return json.dumps(value, ensure_ascii=not utf8, indent=2 if pretty else None)


def one_line(error: BaseException) -> str:
    """The message of an error on one line, whatever it quotes."""
    return " ".join(str(error).split())
