"""Taking words out of a sentence so that what is left reads on."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

_CONNECTIVE: Final = r"(?:[\s,;]|\b(?:and|but|then|while|before|after)\b)+"
_BEFORE: Final = re.compile(_CONNECTIVE + r"\Z", re.IGNORECASE)
_BEHIND: Final = re.compile(_CONNECTIVE, re.IGNORECASE)

Span = tuple[int, int]
"""First character and one past the last."""


def without_words(
    caption: str, gone: Sequence[Span], kept: Sequence[Span], joined: int | None
) -> tuple[str, list[int]]:
    """The sentence without some of its words, and where the characters that are left have come to stand.

    Args:
        caption: the sentence.
        gone: what to take out, but for characters of `kept`.
        kept: what stays as it is.
        joined: where a verb stands that goes: the "and" before it goes, too, or for a first verb the one behind.
    """
    left = np.ones(len(caption), dtype=bool)
    for start, end in gone:
        left[start:end] = False
    if joined is not None:
        cut = _connective(caption, joined, max(end for start, end in gone if start >= joined))
        left[cut] = False
    whole = np.zeros(len(caption), dtype=bool)
    for start, end in kept:
        whole[start:end] = True
    left |= whole
    _close(caption, left, whole)
    words = "".join(character for character, stays in zip(caption, left, strict=True) if stays)
    places: list[int] = (np.cumsum(left) - 1).tolist()
    return words.rstrip(), places


def _close(caption: str, left: NDArray[np.bool_], whole: NDArray[np.bool_]) -> None:
    """Close gaps to one space, and leave no comma alone and no space before a full stop; `whole` stays as it is."""
    last, gap, before = " ", None, 0
    for place, character in enumerate(caption):
        if not left[place]:
            gap = place if character == " " else gap
        elif last == " " and character in " ,;" and not whole[place]:
            left[place] = False
        else:
            if gap is not None and last != " " and character not in " ,;.":
                left[gap] = True
            if last == " " and character == "." and not whole[before]:
                left[before] = False
            last, gap, before = character, None, place


def _connective(caption: str, start: int, end: int) -> slice:
    before, behind = _BEFORE.search(caption, 0, start), _BEHIND.match(caption, end)
    if before and before.group().strip():
        return slice(*before.span())
    return slice(*behind.span()) if behind and behind.group().strip() else slice(0, 0)
