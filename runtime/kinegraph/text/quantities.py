"""Lengths and counts in words: "for four seconds", "twice", "three times", "two steps".

Numbers are digits, decimals, or words up to a hundred, also with a half ("one and a half seconds"). What is nonsense is
not read: zero, negative numbers, more than `MAX_NUMBER`. Neither is what is vague ("a few steps", "a while"), a moment
instead of a length ("after two seconds"), or a range of counts ("two or three times").
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from kinegraph.graph import Action, SemanticGraph
from kinegraph.text import lexicon

Unit = Literal["seconds", "times", "steps"]
"""Seconds of a length, times that an action happens, or steps."""

MAX_NUMBER: Final = 100_000.0
"""Largest number that is read."""


@dataclass(frozen=True)
class Quantity:
    """A length or a count that a caption asks for."""

    number: float
    """Greater than 0, at most `MAX_NUMBER`."""
    unit: Unit
    text: str
    """`caption[start:end]`, with "for" and "about"."""
    start: int
    end: int
    """Characters of the caption, end exclusive."""
    action: int
    """Index of the action in `graph.actions` that it belongs to."""


def read_quantities(graph: SemanticGraph) -> tuple[Quantity, ...]:
    """Read the lengths and counts of a graph's caption, from left to right."""
    return tuple(
        Quantity(found.number, found.unit, graph.caption[found.start : found.end], found.start, found.end, action)
        for found in find_quantities(graph.caption)
        for action in [_action_of(graph, found.start, found.end)]
    )


def _action_of(graph: SemanticGraph, start: int, end: int) -> int:
    """Find the action that a quantity belongs to: one of whose words it is, else the last one that begins before it."""
    touching = [index for index, action in enumerate(graph.actions) if _touches(action, start, end)]
    if touching:
        return min(touching, key=lambda index: abs(graph.actions[index].start - start))
    before = [index for index, action in enumerate(graph.actions) if action.start < start]
    return max(before, key=lambda index: graph.actions[index].start, default=0)


def _touches(action: Action, start: int, end: int) -> bool:
    inner = [node for node in action.arguments if node.start < end and start < node.end]
    return bool(inner) or (action.start < end and start < action.end)


# Finding quantities in a text


@dataclass(frozen=True)
class FoundQuantity:
    """A quantity in a text."""

    number: float
    unit: Unit
    start: int
    end: int
    """Characters of the text, end exclusive."""
    is_adverbial: bool
    """True for what says how long or how often ("twice"), False within a noun phrase ("two steps")."""


@dataclass(frozen=True)
class _Word:
    text: str
    start: int
    end: int


@dataclass(frozen=True)
class _Number:
    value: float
    last: int
    """Index of its last word."""


_WORD: Final = re.compile(r"\d+/\d+|\d+(?:\.\d+|,\d(?![\d,]))?|(?<![\w.])\.\d+|[^\W\d_]+(?:['’][^\W\d_]+)?|[^\w\s]")
_UNITS: Final = {
    "second": 1.0, "seconds": 1.0, "sec": 1.0, "secs": 1.0, "s": 1.0, "minute": 60.0, "minutes": 60.0, "min": 60.0,
    "mins": 60.0, "hour": 3600.0, "hours": 3600.0, "h": 3600.0, "ms": 0.001, "milliseconds": 0.001,
}  # fmt: skip
_ONES: Final = {
    word: value
    for value, word in enumerate(
        "one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen seventeen"
        " eighteen nineteen".split(),
        start=1,
    )
}
_TENS: Final = {
    word: 10 * value
    for value, word in enumerate("twenty thirty forty fifty sixty seventy eighty ninety".split(), start=2)
}
_MAY_HOLD_QUANTITY: Final = re.compile(
    rf"\d|\b(?:half|quarter|twice|thrice|once|hundred|dozen|couple|minute|min|second|sec|hour)\b"
    rf"|\b(?:{'|'.join([*_ONES, *_TENS])})\b",
    re.IGNORECASE,
)
"""A quick look before words are read."""
_DEGREES: Final = re.compile(r"degrees?|degs?|[°º]")
_PACES: Final = frozenset("step steps pace paces stride strides".split())
_FIXED_COUNTS: Final = {"twice": 2.0, "thrice": 3.0}
_ABOUT: Final = frozenset(
    "about around approximately roughly exactly almost nearly only just least most another the first last next up to at"
    " over".split()
)
"""Words between "for" and the number."""
_OPENERS: Final = frozenset("for during in within over lasting between".split())
"""Words before a length."""
_MOMENTS: Final = frozenset("after every before at until since each per".split())
"""Words that make a length a moment or a pace ("after two seconds")."""
_EVENTS: Final = (lexicon.EVENT_NOUNS - frozenset("step movement motion".split())) | frozenset(
    ("jack", "pushup", "situp")
)
_PLURAL_EVENTS: Final = frozenset(
    plural
    for noun in _EVENTS
    for plural in (noun + "s", noun + "es", noun[:-1] + "ies" if noun.endswith("y") else noun + "s")
)


def is_counted(noun: str) -> bool:
    """Tell whether a noun is one that numbers count: a unit, steps, or several of a motion ("kicks")."""
    return noun in _UNITS or noun in _PACES or noun in _PLURAL_EVENTS


def find_quantities(text: str) -> list[FoundQuantity]:
    """Find the lengths and counts of a text, from left to right."""
    if _MAY_HOLD_QUANTITY.search(text) is None:
        return []
    words = [_Word(match.group().lower(), match.start(), match.end()) for match in _WORD.finditer(text)]
    found = []
    index = 0
    while index < len(words):
        result = _fixed_count(words, index) or _counted(words, index)
        if result is None:
            index += 1
            continue
        quantity, last = result
        index = last + 1
        if quantity is not None and 0 < quantity.number <= MAX_NUMBER:
            found.append(quantity)
    return found


def find_degrees(text: str) -> list[float]:
    """Find the angles of a text, from left to right: "90 degrees", "a forty-five-degree turn", "180°"."""
    words = [_Word(match.group().lower(), match.start(), match.end()) for match in _WORD.finditer(text)]
    angles = []
    for index in (index for index, word in enumerate(words) if _DEGREES.fullmatch(word.text)):
        first = index - 2 if _text(words, index - 1) == "-" else index - 1
        # from the longest number that ends there: "one hundred and eighty" begins before "eighty" does
        for begin in range(max(first - 4, 0), first + 1):
            value = _hundreds(words, begin, first)
            if value is not None and not _is_negative(words, begin):
                angles.append(value)
                break
    return angles


def _hundreds(words: Sequence[_Word], begin: int, last: int) -> float | None:
    """Read a number of exactly these words, hundreds in words among them."""
    number = _read_number(words, begin)
    if number is None or _text(words, begin) in ("half", "quarter"):
        return None
    if number.last == last:
        return number.value
    is_hundred = _text(words, number.last + 1) == "hundred"
    value, at = (100 * number.value, number.last + 1) if is_hundred else (number.value, number.last)
    if at == last:
        return value
    rest = _read_number(words, at + 1 + (_text(words, at + 1) == "and"))
    is_whole = rest is not None and rest.last == last and rest.value < 100 and value % 100 == 0
    return value + rest.value if rest is not None and is_whole else None


def _text(words: Sequence[_Word], index: int) -> str:
    return words[index].text if 0 <= index < len(words) else ""


def _fixed_count(words: Sequence[_Word], index: int) -> tuple[FoundQuantity | None, int] | None:
    """Read "twice", "thrice", "once more" and "x2"; "once" alone only where nothing can follow it as a conjunction."""
    word, following = words[index].text, _text(words, index + 1)
    if word in _FIXED_COUNTS:
        return _found(words, index, index, _FIXED_COUNTS[word], "times"), index
    if word == "once":
        last = index + 1 if following in ("more", "again") else index
        is_adverb = last > index or following in ("", ".", ",", ";", "!", "?", "and", "then", "in", "to", "around")
        return (_found(words, index, last, 1.0, "times"), last) if is_adverb and (index or last) else None
    if word == "x" and following.isdecimal() and words[index].end == words[index + 1].start:
        number = _read_number(words, index + 1)
        return None if number is None else (_found(words, index, number.last, number.value, "times"), number.last)
    return None


def _counted(words: Sequence[_Word], index: int) -> tuple[FoundQuantity | None, int] | None:
    """Read a number with its unit; the quantity is None where number and unit together mean something else."""
    number = _read_number(words, index)
    if number is None:
        return None
    is_glued = index and words[index - 1].end == words[index].start
    if is_glued and (words[index - 1].text[-1].isalnum() or words[index - 1].text in ".,"):
        return None, number.last  # a part of another number or word
    number, is_range = _read_range(words, index, number)
    unit_at = number.last + (2 if _text(words, number.last + 1) in ("-", "‐", "‑", "more") else 1)
    if _text(words, unit_at) in ("more", "full", "whole", "long"):
        unit_at += 1
    unit = _text(words, unit_at)
    if _is_negative(words, index):
        return None, number.last
    if _DEGREES.fullmatch(unit):
        return None, unit_at  # "90 degree turns" are not 90 turns
    if unit in _UNITS and not (unit == "s" and _text(words, unit_at + 1) == "-"):  # "2 s-curves"
        return _length(words, index, unit_at, number)
    is_article = words[index].text in ("a", "an") and number.last == index
    if is_range or is_article:
        return None, number.last
    if _text(words, unit_at + 1) in ("faster", "slower", "higher", "bigger", "as"):
        return None, unit_at
    glued = unit == "x" and words[unit_at].start == words[number.last].end
    if unit in ("times", "time") or (unit == "x" and (glued or not _text(words, unit_at + 1).isdecimal())):
        return _found(words, _with_about(words, index), unit_at, number.value, "times"), unit_at
    if unit in _PACES:
        return _found(words, index, unit_at, number.value, "steps", False), unit_at
    # a plural between is what the number counts: "two crutches | steps"
    is_plural = unit.endswith("s") and not unit.endswith("ss") and unit not in lexicon.NOUN_ADJECTIVES
    for noun_at in (unit_at,) if is_plural else (unit_at, unit_at + 1):
        if _text(words, noun_at) in _PLURAL_EVENTS and number.value >= 2:
            return _found(words, index, noun_at, number.value, "times", False), noun_at
        if _text(words, noun_at) in ("steps", "paces", "strides"):
            return _found(words, index, noun_at, number.value, "steps", False), noun_at
    return None


def _length(
    words: Sequence[_Word], index: int, unit_at: int, number: _Number
) -> tuple[FoundQuantity | None, int] | None:
    """Read a length whose number and unit are known; None for "a second time", and for moments."""
    first = _with_about(words, index)
    before = _text(words, first - 1)
    value = number.value * _UNITS[words[unit_at].text]
    is_ordinal = words[unit_at].text == "second" and words[index].text in ("a", "an", "one") and number.last == index
    if before in _OPENERS or (before == "up" and _text(words, first) == "to"):
        first -= 1
    elif is_ordinal or before in _MOMENTS:
        return None
    if [_text(words, unit_at + step) for step in (1, 2, 3)] == ["and", "a", "half"]:  # "a minute and a half"
        value, unit_at = value + 0.5 * _UNITS[words[unit_at].text], unit_at + 3
    following = _text(words, unit_at + 1)
    if following in ("later", "after", "before", "ago", "apart") or (is_ordinal and following in ("time", "step")):
        return None, unit_at
    last = unit_at + 1 if following == "long" else unit_at
    is_noun = before in ("a", "an", "the") or (last == unit_at and words[unit_at - 1].text == "-")
    return _found(words, first, last, value, "seconds", not is_noun), last


def _found(
    words: Sequence[_Word], first: int, last: int, number: float, unit: Unit, is_adverbial: bool = True
) -> FoundQuantity:
    return FoundQuantity(number, unit, words[first].start, words[last].end, is_adverbial)


def _with_about(words: Sequence[_Word], index: int) -> int:
    """Step back over "about" and the like; returns the first of them, "around" behind a verb left out."""
    while index and _text(words, index - 1) in _ABOUT:
        if _text(words, index - 1) in ("around", "over", "up", "to", "at", "the"):
            is_least = _text(words, index - 1) == "at" and _text(words, index) == "least"
            is_led = is_least or _text(words, index - 2) in _ABOUT | {"for", "in", "within", "during"}
            if not is_led:
                break
        index -= 1
    return index


def _is_negative(words: Sequence[_Word], index: int) -> bool:
    """Tell whether a minus stands right before the digits, with a blank before it."""
    if not index or words[index - 1].text not in ("-", "−") or words[index - 1].end != words[index].start:
        return False
    return index == 1 or words[index - 2].end < words[index - 1].start


def _read_range(words: Sequence[_Word], first: int, number: _Number) -> tuple[_Number, bool]:
    """Read "two to three", "2-3" and "between two and three" as their mean; tells whether it was a range."""
    is_between = _text(words, first - 1) == "between" and _text(words, number.last + 1) == "and"
    if _text(words, number.last + 1) in ("to", "or", "-", "–") or is_between:
        other = _read_number(words, number.last + 2)
        if other is not None and other.value > number.value and _text(words, number.last + 2) not in ("a", "an"):
            return _Number((number.value + other.value) / 2, other.last), True
    return number, False


def _read_number(words: Sequence[_Word], index: int) -> _Number | None:
    """Read the number that begins at an index: digits, words up to a hundred, "a", halves and quarters."""
    word = _text(words, index)
    if word in ("half", "quarter") or (word == "a" and _text(words, index + 1) in ("half", "quarter")):
        return _read_fraction(words, index)
    value, last = 0.0, index
    if word[:1].isdecimal() or (word[:1] == "." and word[1:]):
        if len(word) > 12 or not word.isascii():
            return None
        value = _in_digits(word)
        following = _text(words, index + 1)
        fraction = _in_digits(following) if "/" in following and following[0].isdecimal() else 0.0
        if 0 < fraction < 1 and value.is_integer():  # "3 1/2"
            value, last = value + fraction, index + 1
    elif word in _TENS:
        value = float(_TENS[word])
        one_at = index + (2 if _text(words, index + 1) == "-" else 1)
        if 0 < _ONES.get(_text(words, one_at), 0) < 10:
            value, last = value + _ONES[words[one_at].text], one_at
    elif word in _ONES or word in ("a", "an"):
        value = float(_ONES.get(word, 1))
        multiples = {"hundred": 100.0, "dozen": 12.0, "couple": 2.0}
        if _text(words, index + 1) in multiples and value == 1:
            value, last = multiples[words[index + 1].text], index + 1
            last += _text(words, last + 1) == "of"
    else:
        return None
    for half in (["and", "a", "half"], ["-", "and", "-", "a", "-", "half"]):
        if [_text(words, last + step) for step in range(1, len(half) + 1)] == half:
            value, last = value + 0.5, last + len(half)
    return _Number(value, last)


def _in_digits(word: str) -> float:
    """Read "3", "3.5", "3,5", ".5" and "1/2"; 0 for a fraction that is none."""
    if "/" not in word:
        return float(word.replace(",", "."))
    above, below = map(float, word.split("/"))
    return above / below if below else 0.0


def _read_fraction(words: Sequence[_Word], index: int) -> _Number | None:
    """Read "half a minute", "a half minute" and "a quarter of a minute"."""
    at = index + (words[index].text == "a")
    value = 0.5 if words[at].text == "half" else 0.25
    at += _text(words, at + 1) == "of"
    at += _text(words, at + 1) in ("a", "an")
    return _Number(value, at) if _text(words, at + 1) in _UNITS else None


def iterate_adverbial(text: str) -> Iterator[tuple[int, int]]:
    """Yield the characters of every phrase that says how long or how often, end exclusive."""
    for found in find_quantities(text):
        if found.is_adverbial:
            yield found.start, found.end
