"""What the linear model of arguments sees of an action and a span: names of features, as plain words.

Gildea and Jurafsky, *Automatic Labeling of Semantic Roles*, Computational Linguistics 2002, name most of them: head
word, phrase type, path in the parse, position, voice; the preposition and its object as in Xue and Palmer, EMNLP 2004.
Names of features that hold a word of content begin with an asterisk: training also shows every example without them.

A linear model that ranks and types the spans of an action, and the best set of spans that do not overlap."""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import FloatArray
from kinegraph.errors import BundleFormatError
from kinegraph.graph import ARGUMENT_ROLES
from kinegraph.text import lexicon
from kinegraph.text.candidates import ParsedTokens, Span, candidate_spans

_LONGEST_TEXT: Final = 4
_LONGEST_PATH: Final = 4


def span_features(words: ParsedTokens, first: int, last: int, anchor: int) -> list[str]:
    """Of a span by itself."""
    text, pos = words.text, words.pos
    lemma = words.lemma[anchor]
    inner = content_word(words, first, last, anchor)
    before = text[first - 1] if first else "^"
    behind = text[last + 1] if last + 1 < len(words) else "$"
    size = min(last - first + 1, 5)
    names = [
        "bias",
        f"*a:{lemma}",
        f"f:{text[first]}",
        f"*l:{text[last]}",
        f"*fi:{text[first]} {inner}",
        f"*i:{inner}",
        f"d:{words.dep[anchor]}",
        f"p:{pos[first]} {pos[anchor]} {pos[last]}",
        f"n:{size}",
        f"np:{pos[last + 1] if last + 1 < len(words) else '$'} {pos[last]}",
        f"pp:{pos[first - 1] if first else '^'} {pos[first]}",
        f"b:{before}",
        f"e:{behind}",
        f"k:{_completeness(words, first, last, anchor)} {pos[anchor]}",
    ]
    if size <= _LONGEST_TEXT:
        names.append("*t:" + " ".join(text[first : last + 1]))
    return names


def content_word(words: ParsedTokens, first: int, last: int, anchor: int) -> str:
    """The object of a preposition or the verb of a clause; else the head itself."""
    if words.pos[anchor] in ("ADP", "SCONJ"):
        for place in range(anchor + 1, last + 1):
            if words.head[place] == anchor or words.dep[place] in ("pobj", "pcomp"):
                return words.lemma[place]
    return words.lemma[anchor]


def _completeness(words: ParsedTokens, first: int, last: int, anchor: int) -> str:
    left = "<" if words.first[anchor] < first else ("=" if words.first[anchor] == first else ">")
    right = "<" if words.last[anchor] > last else ("=" if words.last[anchor] == last else ">")
    return left + right


def pair_features(
    words: ParsedTokens,
    verb: int,
    span: tuple[int, int, int],
    rules: Mapping[Span, str],
    others: Mapping[Span, str],
    heads: Sequence[int],
    voice: str,
) -> list[str]:
    """Of a span as an argument of the verb at a place.

    Args:
        words: the caption.
        verb: the action's word.
        span: first and last word, and its head.
        rules: what the rules take for arguments of the verb.
        others: what the rules take for arguments of other verbs.
        heads: words of all actions.
        voice: "act" or "pass".
    """
    first, last, anchor = span
    lemma, inner = words.lemma[verb], content_word(words, first, last, anchor)
    side = "L" if last < verb else "R"
    rule = rules.get((first, last)) or _overlap(first, last, rules)
    between = sum(1 for head in heads if min(last, verb) < head < max(first, verb))
    within = sum(1 for head in heads if first <= head <= last)
    way = _path(words, verb, anchor)
    distance = min(abs(first - verb) if side == "R" else abs(verb - last), 6)
    group = _verb_group(lemma)
    return [
        f"r:{rule}",
        f"r:{rule} {words.pos[anchor]}",
        f"r:{rule} {words.text[first]}",
        f"*r:{rule} {lemma}",
        f"q:{rule} {others.get((first, last), '')}",
        f"q:{side} {between} {others.get((first, last), '')}",
        f"s:{side} {way}",
        f"s:{side} {way} {words.pos[first]}",
        f"s:{side} {between} {within}",
        f"s:{side} {between} {words.text[first]}",
        f"x:{side} {last + 1 in heads} {words.text[first]}",
        f"s:{side} {distance} {words.pos[anchor]}",
        f"*v:{lemma} {side}",
        f"*v:{lemma} {way}",
        f"*v:{lemma} {words.text[first]}",
        f"*v:{lemma} {inner}",
        f"*v:{lemma} {words.text[first]} {inner}",
        f"g:{group} {voice} {side} {words.dep[anchor]}",
        f"g:{group} {words.text[first]}",
        f"o:{voice} {side} {way}",
        f"h:{words.tag[verb]} {words.dep[verb]} {side} {words.pos[anchor]}",
    ]


def _verb_group(lemma: str) -> str:
    for name, group in (
        ("happens", lexicon.UNACCUSATIVE),
        ("state", lexicon.STATIVE),
        ("travel", lexicon.TRAVEL),
        ("transfer", lexicon.TRANSFER),
    ):
        if lemma in group:
            return name
    return "other"


def _overlap(first: int, last: int, rules: Mapping[Span, str]) -> str:
    """How a span that is no argument by the rules lies to those that are."""
    found = "none"
    for (left, right), role in rules.items():
        if left <= last and first <= right:
            kind = "in" if left <= first and last <= right else ("over" if first <= left and right <= last else "x")
            end = ("<" if left == first else "") + (">" if right == last else "")
            found = f"{kind}{end} {role}"
            if kind == "in":
                break
    return found


def _path(words: ParsedTokens, verb: int, anchor: int) -> str:
    """Dependency labels up from the span's head to the verb, or to what both depend on and down again."""
    above = {verb: 0}
    place, steps = verb, 0
    while words.head[place] != place:
        place, steps = words.head[place], steps + 1
        above.setdefault(place, steps)
    labels: list[str] = []
    place = anchor
    while place not in above:
        labels.append(words.dep[place])
        if words.head[place] == place:
            return "apart"
        place = words.head[place]
    down: list[str] = []
    top, place = place, verb
    while place != top:
        down.append(words.dep[place])
        place = words.head[place]
    way = [*labels, "|", *reversed(down)]
    return ">".join(way) if len(way) <= _LONGEST_PATH + 1 else f"far{len(labels)}"


CLASSES: Final = len(ARGUMENT_ROLES) + 1
"""No argument, then `ARGUMENT_ROLES` in order."""


@dataclass(frozen=True)
class Candidates:
    """Spans of one action with the names of their features."""

    spans: list[tuple[int, int, int]]
    """First word, last word, head."""
    features: list[list[str]]


@dataclass(frozen=True)
class Choice:
    """What the model makes of one action's spans."""

    taken: list[tuple[str, Span]]
    ranked: list[tuple[str, Span]]
    """All of them with the role each would have, the likeliest first."""


def candidates(
    words: ParsedTokens, verbs: Sequence[int], rules: Sequence[Mapping[Span, str]], voices: Sequence[str]
) -> list[Candidates]:
    """What may be an argument of each action.

    Args:
        words: the caption.
        verbs: word of each action.
        rules: per action, what the rules take for its arguments.
        voices: per action "act" or "pass".
    """
    known = {(first, last): anchor for first, last, anchor in candidate_spans(words)}
    for found in rules:
        for first, last in found:
            known.setdefault((first, last), _top(words, first, last))
    spans = [(first, last, anchor) for (first, last), anchor in known.items()]
    alone = [span_features(words, *span) for span in spans]
    made = []
    for verb, found, voice in zip(verbs, rules, voices, strict=True):
        own = [
            (span, names)
            for span, names in zip(spans, alone, strict=True)
            if not span[0] <= verb <= span[1] and words.sentence[span[0]] == words.sentence[verb]
        ]
        others = {span: role for other in rules if other is not found for span, role in other.items()}
        features = [names + pair_features(words, verb, span, found, others, verbs, voice) for span, names in own]
        made.append(Candidates([span for span, _ in own], features))
    return made


def _top(words: ParsedTokens, first: int, last: int) -> int:
    """The word of a span that depends on a word outside."""
    for place in range(first, last + 1):
        if not first <= words.head[place] <= last or words.head[place] == place:
            return place
    return last


def _arrays(data: bytes) -> dict[str, NDArray[Any]]:
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in ("names", "weights", "provenance")}
    except (
        OSError,
        ValueError,
        KeyError,
        EOFError,
        TypeError,
        AttributeError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise BundleFormatError(f"arguments.npz does not hold the weights of arguments: {error}") from error
    if arrays["names"].dtype != np.uint8 or arrays["weights"].dtype != np.float16:
        raise BundleFormatError("arguments.npz must hold names as bytes and weights as float16")
    return arrays


class ArgumentClassifier:
    """Multinomial logistic regression over named features.

    Args:
        data: an `.npz` with `names`, n lines of UTF-8 as bytes, and `weights` (n, CLASSES) float16.

    Raises:
        BundleFormatError: the bytes are no such file.
    """

    def __init__(self, data: bytes) -> None:
        stored = _arrays(data)
        names = stored["names"].tobytes().decode("utf-8", errors="replace").split("\n")
        weights = stored["weights"].astype(np.float32)
        if weights.shape != (len(names), CLASSES):
            raise BundleFormatError(
                f"arguments.npz holds {len(names)} names and weights {weights.shape}, not ({len(names)}, {CLASSES})"
            )
        if not np.isfinite(weights).all():
            raise BundleFormatError("arguments.npz holds weights that are not finite")
        self._index: dict[str, int] = {name: place for place, name in enumerate(names)}
        self._weights: FloatArray = weights

    def scores(self, features: Sequence[Sequence[str]]) -> FloatArray:
        """(spans, CLASSES) sums of the weights of their features; unknown features count nothing."""
        rows = [[self._index[name] for name in names if name in self._index] for names in features]
        flat = np.array([place for row in rows for place in row], dtype=np.int64)
        owner = np.repeat(np.arange(len(rows)), [len(row) for row in rows])
        scores = np.zeros((len(rows), CLASSES), dtype=np.float32)
        np.add.at(scores, owner, self._weights[flat])
        return scores

    def choose(self, found: Candidates) -> Choice:
        """The arguments: the set of spans without overlap whose log-odds against being none add up to most."""
        if not found.spans:
            return Choice([], [])
        scores = self.scores(found.features)
        roles = scores[:, 1:].argmax(axis=1)
        # against all roles together: one that is torn between two of them is an argument all the same
        gains = np.logaddexp.reduce(scores[:, 1:], axis=1) - scores[:, 0]
        named = [(ARGUMENT_ROLES[role], span[:2]) for role, span in zip(roles, found.spans, strict=True)]
        chosen = weighted_interval_scheduling(found.spans, gains.tolist())
        order = np.argsort(-gains, kind="stable")
        return Choice([named[place] for place in chosen], [named[place] for place in order])


def weighted_interval_scheduling(spans: Sequence[tuple[int, ...]], gains: Sequence[float]) -> list[int]:
    """Weighted interval scheduling: which spans that do not overlap gain most together (Kleinberg and Tardos, 6.1).

    Args:
        spans: first and last word of each.
        gains: of each; those that are not positive are never taken.
    """
    order = sorted((place for place, gain in enumerate(gains) if gain > 0), key=lambda place: spans[place][1])
    ends = [spans[place][1] for place in order]
    totals = [0.0]
    taken: list[bool] = []
    earlier: list[int] = []
    for rank, place in enumerate(order):
        before = rank
        while before and ends[before - 1] >= spans[place][0]:
            before -= 1
        earlier.append(before)
        total = totals[before] + gains[place]
        taken.append(total > totals[rank])
        totals.append(max(total, totals[rank]))
    chosen = []
    rank = len(order)
    while rank:
        if taken[rank - 1]:
            chosen.append(order[rank - 1])
            rank = earlier[rank - 1]
        else:
            rank -= 1
    return sorted(chosen, key=lambda place: spans[place][0])


def packed(names: Sequence[str], weights: FloatArray, provenance: str) -> bytes:
    """The content of `arguments.npz`; the same input gives the same bytes. `provenance` says what it was trained on."""
    buffer = io.BytesIO()
    lines = np.frombuffer("\n".join(names).encode("utf-8"), dtype=np.uint8)
    source = np.frombuffer(provenance.encode("utf-8"), dtype=np.uint8)
    np.savez_compressed(buffer, names=lines, weights=weights.astype(np.float16), provenance=source)
    return buffer.getvalue()


def provenance_of(data: bytes) -> str:
    """What the weights in an `arguments.npz` were trained on.

    Raises:
        BundleFormatError: the bytes are no such file.
    """
    return _arrays(data)["provenance"].tobytes().decode("utf-8")
