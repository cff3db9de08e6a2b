"""Several sentences in one call, a sequence or a batch: their lengths, seeds and captions."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from kinegraph.errors import InvalidInputError
from kinegraph.limits import MAX_TAKES
from kinegraph.options import checked_seed, shown, whole_number


def batch_seeds(first: int, texts: int, takes: object) -> list[int]:
    """The seeds of a batch, one after another.

    Raises:
        InvalidInputError: takes that are no whole number, more than `limits.MAX_TAKES` clips, or seeds that end beyond
            the largest.
    """
    number = whole_number(takes)
    if number is None or not 1 <= number <= MAX_TAKES:
        raise InvalidInputError(f"takes must be a whole number from 1 to {MAX_TAKES}, not {shown(takes)}")
    if texts * number > MAX_TAKES:
        raise InvalidInputError(f"{texts} sentences of {number} takes; {MAX_TAKES} clips at most share a run")
    return [checked_seed(first + place) for place in range(texts * number)]


def part_captions(captions: Sequence[str]) -> str:
    """One caption of a sequence: "a person walks", "then bows" -> "a person walks, then bows"."""
    first, *others = captions
    return ", then ".join([first, *(re.sub(r"^\s*((and|then)\s+)+", "", other) for other in others)])


def part_lengths(texts: object, seconds: object, most: int, what: str) -> list[Any]:
    """The length of every sentence of several; None where the sentence decides.

    Args:
        texts: of a sequence or a batch.
        seconds: one length, one per sentence, or None.
        most: sentences allowed.
        what: "a sequence" or "a batch", for messages.

    Raises:
        InvalidInputError: no list of 1 to `most` sentences, or lengths that are not as many.
    """
    if isinstance(texts, str) or not isinstance(texts, Sequence):
        raise InvalidInputError(f"{what} takes a list of sentences")
    if not 1 <= len(texts) <= most:
        raise InvalidInputError(f"{what} has 1 to {most} sentences, not {len(texts)}")
    if not isinstance(seconds, list | tuple):
        return [seconds] * len(texts)
    if len(seconds) != len(texts):
        raise InvalidInputError(f"seconds has {len(seconds)} lengths for {len(texts)} sentences")
    return list(seconds)
