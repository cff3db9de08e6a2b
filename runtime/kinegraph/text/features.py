"""What the linear model of arguments sees of an action and a span: names of features, as plain words.

Gildea and Jurafsky, *Automatic Labeling of Semantic Roles*, Computational Linguistics 2002, name most of them: head
word, phrase type, path in the parse, position, voice; the preposition and its object as in Xue and Palmer, EMNLP 2004.
Names of features that hold a word of content begin with an asterisk: training also shows every example without them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from kinegraph.text import lexicon
from kinegraph.text.spans import Span, Words

_LONGEST_TEXT: Final = 4
_LONGEST_PATH: Final = 4


def span_features(words: Words, first: int, last: int, anchor: int) -> list[str]:
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


def content_word(words: Words, first: int, last: int, anchor: int) -> str:
    """The object of a preposition or the verb of a clause; else the head itself."""
    if words.pos[anchor] in ("ADP", "SCONJ"):
        for place in range(anchor + 1, last + 1):
            if words.head[place] == anchor or words.dep[place] in ("pobj", "pcomp"):
                return words.lemma[place]
    return words.lemma[anchor]


def _completeness(words: Words, first: int, last: int, anchor: int) -> str:
    left = "<" if words.first[anchor] < first else ("=" if words.first[anchor] == first else ">")
    right = "<" if words.last[anchor] > last else ("=" if words.last[anchor] == last else ">")
    return left + right


def pair_features(
    words: Words,
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


def _path(words: Words, verb: int, anchor: int) -> str:
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
