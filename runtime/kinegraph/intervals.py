"""Timelines of intervals: texts that each hold from one moment to another, for the whole body or for parts of it.

The form is that of STMC (Petrovich et al., "Multi-Track Timeline Control for Text-Driven 3D Human Motion Generation",
2024), which EnergyMoGen is measured on (Table 6). A file has one interval a line, `text # start # end # part # part`:

    walks in a circle # 0.0 # 6.0 # legs
    raises the right hand # 2.0 # 5.0 # right arm
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from kinegraph.errors import InvalidInputError
from kinegraph.graph import SemanticGraph
from kinegraph.keeping import PARTS
from kinegraph.limits import MAX_CONCEPTS, MAX_PARTS
from kinegraph.text.parser import check_caption
from kinegraph.validation import finite_number, short_repr

ALIASES: Final = {"spine": "torso"}
"""Names of parts in files of MTT that differ from those of `keeping.PARTS`."""

MAX_FILE_BYTES: Final = 1 << 20


@dataclass(frozen=True)
class Interval:
    """A text that holds from `start` to `end`, seconds from the beginning of the clip.

    Raises:
        InvalidInputError: a text without words, moments that are none or out of order, or an unknown part of the body.
    """

    text: str | SemanticGraph
    """What happens: a sentence, or its graph."""
    start: float
    end: float
    parts: tuple[str, ...] = ()
    """Parts of the body that it is for, of `keeping.PARTS`; none is the whole body."""

    def __post_init__(self) -> None:
        if not isinstance(self.text, SemanticGraph):
            check_caption(self.text)
        start, end = finite_number(self.start), finite_number(self.end)
        if start is None or end is None or not 0 <= start < end:
            raise InvalidInputError(
                "an interval goes from a moment to a later one, in seconds from 0, not from "
                f"{short_repr(self.start)} to {short_repr(self.end)}"
            )
        parts: Any = (self.parts,) if isinstance(self.parts, str) else self.parts
        if not isinstance(parts, list | tuple):
            raise InvalidInputError(f"parts of an interval are a list of names, not {short_repr(parts)}")
        object.__setattr__(self, "parts", tuple(_part_name(name) for name in parts))
        object.__setattr__(self, "start", start)
        object.__setattr__(self, "end", end)

    @property
    def caption(self) -> str:
        """The sentence of the interval."""
        return self.text.caption if isinstance(self.text, SemanticGraph) else self.text


def _part_name(name: object) -> str:
    if not isinstance(name, str) or ALIASES.get(name, name) not in PARTS:
        raise InvalidInputError(f"no part of the body is called {short_repr(name)}; there are {', '.join(PARTS)}")
    return ALIASES.get(name, name)


def check_intervals(intervals: object) -> tuple[Interval, ...]:
    """Check a timeline and sort it by start.

    Raises:
        InvalidInputError: not a list of 1 to `limits.MAX_PARTS` intervals, a moment without one, or more than
             `limits.MAX_CONCEPTS` at a time.
    """
    if not isinstance(intervals, list | tuple) or not all(isinstance(each, Interval) for each in intervals):
        raise InvalidInputError("a timeline is a list of Interval(text, start, end)")
    if not 1 <= len(intervals) <= MAX_PARTS:
        raise InvalidInputError(f"a timeline has 1 to {MAX_PARTS} intervals, not {len(intervals)}")
    ordered = sorted(intervals, key=lambda each: each.start)
    covered = 0.0
    for each in ordered:
        if each.start > covered + 1e-6:
            raise InvalidInputError(f"nothing happens from {covered:g} to {each.start:g} s; say what, if only to stand")
        covered = max(covered, each.end)
        at_once = sum(other.start <= each.start < other.end for other in ordered)
        if at_once > MAX_CONCEPTS:
            raise InvalidInputError(f"{at_once} intervals hold at {each.start:g} s; at most {MAX_CONCEPTS} can")
    return tuple(ordered)


def groups_at_once(intervals: Sequence[Interval]) -> list[list[Interval]] | None:
    """Group intervals that begin and end together; None if some overlap otherwise, or are for parts of the body."""
    groups: list[list[Interval]] = []
    for each in intervals:
        if each.parts:
            return None
        if groups and (groups[-1][0].start, groups[-1][0].end) == (each.start, each.end):
            groups[-1].append(each)
        elif groups and each.start < groups[-1][0].end:
            return None
        else:
            groups.append([each])
    return groups


def read_intervals(path: str | Path) -> tuple[Interval, ...]:
    """Read a timeline from a text file, as MTT publishes them.

    Raises:
        InvalidInputError: no such file, no text, or a line that is no interval; the message names the line.
    """
    try:
        with Path(path).open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
        text = data.decode("utf-8-sig")
    except (OSError, ValueError) as error:  # ValueError: NUL in the name, or no UTF-8
        raise InvalidInputError(f"cannot read {str(path)!r}: {error}") from error
    if len(data) > MAX_FILE_BYTES:
        raise InvalidInputError(f"{str(path)!r} is larger than {MAX_FILE_BYTES} bytes")
    return parse_intervals(text, str(path))


def parse_intervals(text: str, where: str) -> tuple[Interval, ...]:
    """Read a timeline from the content of a file; blank lines count for nothing.

    Args:
        text: of the file.
        where: its name, for messages.

    Raises:
        InvalidInputError: see `read_intervals`.
    """
    intervals = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip():
            continue
        fields = [field.strip() for field in line.split("#")]
        try:
            if len(fields) < 3:
                raise InvalidInputError("a line is: text # start # end # parts of the body, if it is for some alone")
            caption, start, end, *parts = fields
            intervals.append(Interval(caption, _seconds(start), _seconds(end), tuple(part for part in parts if part)))
        except InvalidInputError as error:
            raise InvalidInputError(f"{where}, line {number}: {error}") from error
    try:
        return check_intervals(intervals)
    except InvalidInputError as error:
        raise InvalidInputError(f"{where}: {error}") from error


def _seconds(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InvalidInputError(f"{text[:40]!r} is no number of seconds") from None
