"""Candidate spans: phrases of the dependency parse, whole and cut short, that may be arguments of an action."""

from __future__ import annotations

from typing import Final

from kinegraph.text import lexicon
from kinegraph.text.dependency import ParsedTokens, Span, has_word

_ANCHOR_POS: Final = frozenset("NOUN PROPN PRON ADP ADV VERB ADJ NUM SCONJ PART AUX X INTJ".split())
_NON_ANCHOR_DEPS: Final = frozenset("det punct cc aux auxpass case preconj".split())


def candidate_spans(tokens: ParsedTokens) -> list[tuple[int, int, int]]:
    """List every span that may be an argument of some action, each once, as (first, last, anchor)."""
    children: list[list[int]] = [[] for _ in tokens.text]
    for index, head in enumerate(tokens.head):
        if head != index:
            children[head].append(index)
    anchors: dict[Span, int] = {}
    for anchor, pos in enumerate(tokens.pos):
        if pos not in _ANCHOR_POS or tokens.dep[anchor] in _NON_ANCHOR_DEPS or not has_word(tokens.text[anchor]):
            continue
        for raw_span in _spans_at(tokens, children, anchor):
            span = tokens.trim(raw_span)
            if span is not None:
                anchors.setdefault(span, anchor)
    _join_neighbours(tokens, anchors)
    return [(first, last, anchor) for (first, last), anchor in anchors.items()]


def _spans_at(tokens: ParsedTokens, children: list[list[int]], anchor: int) -> list[Span]:
    """List the spans around one anchor: its subtree, its phrase, and the phrase with some of its modifiers."""
    first, last = tokens.first[anchor], tokens.last[anchor]
    if tokens.dep[anchor] == "mark":  # a clause: from the word that opens it to the end of its verb's subtree
        return [(anchor, tokens.last[tokens.head[anchor]])]
    spans = [(first, last), (anchor, anchor)]
    core = _core_end(tokens, children, anchor)
    separators = [child for child in children[anchor] if child < anchor and tokens.dep[child] in ("cc", "punct")]
    left = max([first, *(separator + 1 for separator in separators)])
    if tokens.pos[anchor] in ("VERB", "AUX"):
        coordinated = [child for child in children[anchor] if child > anchor and tokens.dep[child] in ("cc", "conj")]
        end = coordinated[0] - 1 if coordinated else last
        return [*spans, (anchor, last), (anchor, core), (first, end), (anchor, end)]
    spans += [(left, core), (left, anchor), (anchor, core)]
    # cut before and after each modifier that follows the noun or preposition
    for child in children[anchor]:
        if child > anchor and tokens.dep[child] not in ("punct", "cc"):
            spans.append((left, tokens.first[child] - 1))
            spans.append((left, tokens.last[child]))
    return spans


def _core_end(tokens: ParsedTokens, children: list[list[int]], anchor: int) -> int:
    """Find the last token of a phrase without the modifiers that follow its noun."""
    objects = [
        child
        for child in children[anchor]
        if child > anchor and tokens.dep[child] in ("pobj", "pcomp", "dobj", "prep", "amod")
    ]
    if tokens.pos[anchor] in ("ADP", "SCONJ", "VERB") and objects:
        return _core_end(tokens, children, objects[0])
    return anchor


def _join_neighbours(tokens: ParsedTokens, anchors: dict[Span, int]) -> None:
    """Add the spans that a wrong attachment tore apart.

    In "makes a step | to the left" the parse may attach the modifier to the verb instead of the noun; in
    "walks up | a slope" it may attach the preposition to the verb.
    """
    modifier_ends: dict[int, int] = {}
    prepositional: list[tuple[int, int, int]] = []
    for first, last in anchors:
        is_preposition = tokens.pos[first] == "ADP" and last > first
        if is_preposition or (tokens.pos[first] == "ADV" and last == first):
            modifier_ends[first] = min(last, modifier_ends.get(first, last))
        anchor = anchors[first, last]
        if tokens.pos[first] in ("DET", "NUM", "NOUN", "PRON") and tokens.pos[anchor] == "NOUN" and first:
            verb_travels = tokens.lemma[tokens.head[first - 1]] in lexicon.TRAVEL_ON
            if verb_travels and last == anchor and tokens.pos[first - 1] == "ADP":
                prepositional.append((first - 1, last, first - 1))
    for (first, last), anchor in list(anchors.items()):
        if tokens.pos[anchor] in ("NOUN", "PROPN") and last == anchor and last + 1 in modifier_ends:
            anchors.setdefault((first, modifier_ends[last + 1]), anchor)
    for first, last, anchor in prepositional:
        anchors.setdefault((first, last), anchor)
