"""Output of the command line: the progress line, JSON, and errors on one line."""

from __future__ import annotations

import json
import sys
from types import TracebackType
from typing import TYPE_CHECKING, Final, Self, TextIO

if TYPE_CHECKING:
    from kinegraph.diffusion.sampling import StepInfo

_BAR_WIDTH: Final = 24
_CLEAR_LINE: Final = "\r\x1b[K"


class Progress:
    """Progress line that is rewritten at every diffusion step and cleared at the end."""

    def __init__(self, stream: TextIO | None) -> None:
        """Write to `stream`; None writes nothing."""
        self._stream = stream

    @classmethod
    def on_stderr(cls, *, quiet: bool, forced: bool) -> Self:
        """Write to stderr if it is a terminal; a log file gets no progress unless `forced`."""
        visible = forced or sys.stderr.isatty()
        return cls(sys.stderr if visible and not quiet else None)

    def show(self, info: StepInfo) -> None:
        """Show one step: the `on_step` of `MotionPipeline.generate`. It never asks to stop."""
        if self._stream is not None:
            bar = ("#" * (_BAR_WIDTH * info.done // info.total)).ljust(_BAR_WIDTH, ".")
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
    """Write a value as JSON for stdout, with escapes where the terminal is not UTF-8."""
    utf8 = (sys.stdout.encoding or "").lower().replace("-", "") == "utf8"
    return json.dumps(value, ensure_ascii=not utf8, indent=2 if pretty else None)


def one_line(message: object) -> str:
    """Return a message or the text of an error on one line, whatever it quotes."""
    return " ".join(str(message).split())
