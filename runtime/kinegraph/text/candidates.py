"""Which runs of words may be arguments of an action: the phrases of the dependency parse, whole and cut short."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from kinegraph.text import lexicon

Span = tuple[int, int]
"""First and last word, both included."""

_ANCHORS: Final = frozenset("NOUN PROPN PRON ADP ADV VERB ADJ NUM SCONJ PART AUX X INTJ".split())
_NEVER: Final = frozenset("det punct cc aux auxpass case preconj".split())


@dataclass(frozen=True)
class ParsedTokens:
    """N words with their dependency parse as plain lists: spaCy's own tokens are slow to ask."""

    text: tuple[str, ...]
    """Lower case, slips mended."""
    lemma: tuple[str, ...]
    pos: tuple[str, ...]
    tag: tuple[str, ...]
    dep: tuple[str, ...]
    head: tuple[int, ...]
    first: tuple[int, ...]
    """Left end of the subtree."""
    last: tuple[int, ...]
    """Right end of the subtree."""
    sentence: tuple[int, ...]
    """First word of the sentence."""

    @staticmethod
    def of(doc: Any, text: Sequence[str]) -> ParsedTokens:
        """From spaCy's analysis; `text` are the words it stands for."""
        rows = [
            (t.lemma_.lower(), t.pos_, t.tag_, t.dep_, t.head.i, t.left_edge.i, t.right_edge.i, sentence.start)
            for sentence in doc.sents
            for t in sentence
        ]
        columns = list(zip(*rows, strict=True)) or [()] * 8
        return ParsedTokens(tuple(word.lower() for word in text), *columns)

    def __len__(self) -> int:
        return len(self.text)


def has_word(text: str) -> bool:
    """Whether a letter or digit is in it."""
    return any(char.isalnum() for char in text)


def trim(words: ParsedTokens, first: int, last: int) -> Span | None:
    """Without punctuation and conjunctions at the ends; None if nothing is left."""
    while first <= last and (not has_word(words.text[first]) or words.dep[first] == "cc"):
        first += 1
    while first <= last and (not has_word(words.text[last]) or words.dep[last] == "cc"):
        last -= 1
    return (first, last) if first <= last else None


def candidate_spans(words: ParsedTokens) -> list[tuple[int, int, int]]:
    """(first, last, anchor) of everything that may be an argument of some action; no span twice."""
    children: list[list[int]] = [[] for _ in words.text]
    for place, head in enumerate(words.head):
        if head != place:
            children[head].append(place)
    found: dict[Span, int] = {}
    for anchor, pos in enumerate(words.pos):
        if pos not in _ANCHORS or words.dep[anchor] in _NEVER or not has_word(words.text[anchor]):
            continue
        for first, last in _spans_at(words, children, anchor):
            span = trim(words, first, last)
            if span is not None:
                found.setdefault(span, anchor)
    _join_neighbours(words, found)
    return [(first, last, anchor) for (first, last), anchor in found.items()]


def _join_neighbours(words: ParsedTokens, found: dict[Span, int]) -> None:
    """ "makes a step | to the left": the parse may have hung on the verb what belongs to the noun."""
    ends: dict[int, int] = {}
    nouns: list[tuple[int, int, int]] = []
    for first, last in found:
        behind = words.pos[first] == "ADP" and last > first
        if behind or (words.pos[first] == "ADV" and last == first):
            ends[first] = min(last, ends.get(first, last))
        if words.pos[first] in ("DET", "NUM", "NOUN", "PRON") and words.pos[found[first, last]] == "NOUN" and first:
            climbed = words.lemma[words.head[first - 1]] in lexicon.TRAVEL_ON
            if climbed and last == found[first, last] and words.pos[first - 1] == "ADP":  # "walks up | a slope"
                nouns.append((first - 1, last, first - 1))
    for (first, last), anchor in list(found.items()):
        if words.pos[anchor] in ("NOUN", "PROPN") and last == anchor and last + 1 in ends:
            found.setdefault((first, ends[last + 1]), anchor)
    for first, last, anchor in nouns:
        found.setdefault((first, last), anchor)


def _spans_at(words: ParsedTokens, children: list[list[int]], anchor: int) -> list[Span]:
    first, last = words.first[anchor], words.last[anchor]
    if words.dep[anchor] == "mark":  # a clause: from the word that opens it to the end of its verb's subtree
        return [(anchor, words.last[words.head[anchor]])]
    spans = [(first, last), (anchor, anchor)]
    core = _core_end(words, children, anchor)
    before = [c for c in children[anchor] if c < anchor and words.dep[c] in ("cc", "punct")]
    left = max([first, *(c + 1 for c in before)])
    if words.pos[anchor] in ("VERB", "AUX"):
        coordinated = [c for c in children[anchor] if c > anchor and words.dep[c] in ("cc", "conj")]
        end = coordinated[0] - 1 if coordinated else last
        return [*spans, (anchor, last), (anchor, core), (first, end), (anchor, end)]
    spans += [(left, core), (left, anchor), (anchor, core)]
    # one modifier behind the noun or preposition after another
    for child in children[anchor]:
        if child > anchor and words.dep[child] not in ("punct", "cc"):
            spans.append((left, words.first[child] - 1))
            spans.append((left, words.last[child]))
    return spans


def _core_end(words: ParsedTokens, children: list[list[int]], anchor: int) -> int:
    """Last word of the phrase without what is only attached behind its noun."""
    objects = [c for c in children[anchor] if c > anchor and words.dep[c] in ("pobj", "pcomp", "dobj", "prep", "amod")]
    if words.pos[anchor] in ("ADP", "SCONJ", "VERB") and objects:
        inner = objects[0]
        return _core_end(words, children, inner)
    return anchor
