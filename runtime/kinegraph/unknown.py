"""Words of a sentence that a bundle was never shown: the record that clips carry, its JSON, and how it is told.

A leaf: clips, formats and interfaces share it. `kinegraph.text.vocabulary` finds such words.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

from kinegraph.errors import InvalidInputError
from kinegraph.validation import short_repr

Reason = Literal["word", "combination", "people"]
"""Why a span is unknown.

- word: no training caption has the word.
- combination: training captions have the words, but never so ("raises the head", "stands" beside "stands out").
- people: a second person; a bundle moves one.
"""

MAX_NEAREST: Final = 8
"""Phrases that one span may carry."""
_MAX_TEXT: Final = 512

_EXPLANATIONS: Final[Mapping[str, str]] = {
    "word": "",
    "combination": "known words, but not in this use",
    "people": "more than one person",
}


@dataclass(frozen=True)
class Unknown:
    """Span of a caption that the bundle was never shown.

    Raises:
        InvalidInputError: a field has the wrong type, or the span does not fit its text.
    """

    text: str
    """Words as they were written: `caption[start:end]`."""
    start: int
    end: int
    """Characters of the sentence it stands in, end exclusive; in a sequence or a composition, of that part."""
    nearest: tuple[str, ...] = ()
    """Known phrases that are most like it, the nearest first; empty where nothing is near."""
    reason: Reason = "word"
    """Why it is unknown."""

    def __post_init__(self) -> None:
        if not _is_text(self.text) or not self.text:
            raise InvalidInputError(f"the text of unknown words must be a text of at most {_MAX_TEXT} characters")
        if type(self.start) is not int or type(self.end) is not int or self.end - self.start != len(self.text):
            span = f"{short_repr(self.start)} to {short_repr(self.end)}"
            raise InvalidInputError(f"unknown words {self.text!r} cannot span {span}")
        if self.start < 0:
            raise InvalidInputError(f"unknown words {self.text!r} cannot begin at {short_repr(self.start)}")
        fits = isinstance(self.nearest, tuple) and len(self.nearest) <= MAX_NEAREST and all(map(_is_text, self.nearest))
        if not fits:
            raise InvalidInputError(f"nearest of {self.text!r} must be at most {MAX_NEAREST} phrases")
        if not isinstance(self.reason, str) or self.reason not in get_args(Reason):
            raise InvalidInputError(f"the reason of {self.text!r} must be one of {', '.join(get_args(Reason))}")

    def to_dict(self) -> dict[str, Any]:
        """Convert to plain values for JSON."""
        return {
            "text": self.text,
            "start": self.start,
            "end": self.end,
            "nearest": list(self.nearest),
            "reason": self.reason,
        }

    @staticmethod
    def from_dict(value: object) -> Unknown:
        """Read what `to_dict` wrote.

        Raises:
            InvalidInputError: it is something else.
        """
        keys = {"text", "start", "end", "nearest", "reason"}
        if not isinstance(value, dict) or set(value) != keys or not isinstance(value["nearest"], list):
            raise InvalidInputError(f"unknown words must be objects with the keys {', '.join(sorted(keys))}")
        return Unknown(**{**value, "nearest": tuple(value["nearest"])})


def read_list(value: object, name: str) -> list[Any]:
    """Return a list of parsed JSON.

    Raises:
        InvalidInputError: it is something else.
    """
    if not isinstance(value, list):
        raise InvalidInputError(f"{name} must be a list, not {type(value).__name__}")
    return value


def describe_unknown(unknown: Sequence[Unknown]) -> str:
    """Describe unknown words on one line: "'juggles'; nearest: 'bows', 'runs'"."""
    return " | ".join(map(_describe, unknown))


def _describe(unknown: Unknown) -> str:
    explanation = _EXPLANATIONS[unknown.reason]
    nearest = ", ".join(map(repr, unknown.nearest))
    return (
        repr(unknown.text) + (f" ({explanation})" if explanation else "") + (f"; nearest: {nearest}" if nearest else "")
    )


def _is_text(value: object) -> bool:
    return (
        isinstance(value, str) and len(value) <= _MAX_TEXT and not any("\ud800" <= char <= "\udfff" for char in value)
    )
