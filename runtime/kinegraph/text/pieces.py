"""Pieces of a caption: take a graph's caption apart, write another one, and put the nodes on it.

Pieces are words and signs, cut where nodes begin and end. A new caption is a list of items: pieces of the old one in
any order, some with other words, some inserted. Nodes follow their pieces; one that has lost all its words is left out.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

from kinegraph.graph import Action, Argument, SemanticGraph

Node = Action | Argument

NEGATING: Final = frozenset(
    "without not n't nt never no neither nor instead of rather than do does did is are was were am be 's 're ca can"
    " wo will would could should don't doesn't didn't isn't aren't wasn't won't can't cannot couldn't shouldn't"
    " wouldn't dont doesnt didnt cant wont even ever any just really also simply while by being at all longer hardly"
    " 'm".split()
)
"""Words that are left out with a negated verb that they stand before."""
CONNECTIVES: Final = frozenset("and but or then while nor yet , ; – — / & +".split())
"""Words and signs that join clauses."""
SEQUENCE_WORDS: Final = frozenset(
    "then next afterwards afterward finally lastly first firstly second secondly third thirdly fourth fifth later"
    " subsequently thereafter eventually".split()
)
"""Words that tell the place of an action in a sequence."""
AFTER_THAT: Final = (frozenset(("after", "that")), frozenset(("after", "this")))
RELATIVE: Final = frozenset("who which that whose".split())
"""Words that open a relative clause."""
STOPS: Final = frozenset(". ; ! ? | → ➡ ➜ ⇒ >".split())
"""Signs between sentences or steps."""
SIGNS: Final = STOPS | frozenset(", : ( ) [ ] - – — • * · / &".split())


@dataclass(frozen=True)
class Piece:
    """A word, a sign, or a part of a word that a node of its own covers ("n't")."""

    text: str
    start: int
    end: int
    """Characters of the caption, end exclusive."""
    glued: bool
    """True if no blank stands before it."""

    @property
    def word(self) -> str:
        """The text in lower case, with straight apostrophes."""
        return self.text.lower().replace("’", "'")

    @property
    def is_word(self) -> bool:
        """Whether it holds a letter or a digit."""
        return any(char.isalnum() for char in self.text)


@dataclass(frozen=True)
class Item:
    """A piece of a new caption: one of the old caption's, perhaps with other words, or an inserted one."""

    text: str
    piece: int | None = None
    """Index of the old piece; None for an inserted one."""


class Pieces:
    """The pieces of a graph's caption, and which of them each node covers."""

    def __init__(self, graph: SemanticGraph) -> None:
        self.graph = graph
        cuts = {0, len(graph.caption), *(edge for node in graph.nodes for edge in (node.start, node.end))}
        for match in _WORD.finditer(graph.caption):
            cuts |= {match.start(), match.end()}
        bounds = sorted(cuts)
        self.pieces: list[Piece] = []
        for start, end in pairwise(bounds):
            text = graph.caption[start:end]
            if text.strip():
                first = start + len(text) - len(text.lstrip())
                glued = first == start > 0 and not graph.caption[start - 1].isspace()
                self.pieces.append(Piece(text.strip(), first, first + len(text.strip()), glued))

    def __len__(self) -> int:
        return len(self.pieces)

    def word(self, index: int) -> str:
        """Return a piece in lower case; empty outside of the caption."""
        return self.pieces[index].word if 0 <= index < len(self.pieces) else ""

    def of(self, node: Node) -> range:
        """Return the indices of a node's pieces."""
        return self.within(node.start, node.end)

    def of_action(self, action: Action) -> set[int]:
        """Return the indices of the pieces of an action and its arguments."""
        return set(self.of(action)).union(*map(self.of, action.arguments))

    def within(self, start: int, end: int) -> range:
        """Return the indices of the pieces in some characters."""
        inside = [index for index, piece in enumerate(self.pieces) if start <= piece.start and piece.end <= end]
        return range(inside[0], inside[-1] + 1) if inside else range(0)

    def items(self, kept: Iterable[int]) -> list[Item]:
        """Return the items of a caption of unchanged pieces."""
        return [Item(self.pieces[index].text, index) for index in kept]


_WORD: Final = re.compile(r"\w+(?:['’‑-]\w+)*|[^\w\s]")
_CLOSING: Final = frozenset(", . ; : ! ? )".split())


def write(pieces: Pieces, actions: Sequence[Action], items: Sequence[Item]) -> SemanticGraph:
    """Write a caption from items and put actions and their arguments on it; nodes without a word are left out."""
    caption = ""
    spans: list[tuple[int, int]] = []
    for position, item in enumerate(items):
        before = items[position - 1].piece if position else None
        is_glued = item.piece is not None and before == item.piece - 1 and pieces.pieces[item.piece].glued
        caption += "" if not caption or is_glued or item.text in _CLOSING else " "
        spans.append((len(caption), len(caption) + len(item.text)))
        caption += item.text
    placed = []
    for action in actions:
        span = _span_of(pieces, action, items, spans)
        if span is not None:
            arguments = [
                replace(argument, start=place[0], end=place[1], text=caption[slice(*place)])
                for argument in action.arguments
                for place in [_span_of(pieces, argument, items, spans)]
                if place is not None
            ]
            placed.append(
                replace(action, start=span[0], end=span[1], text=caption[slice(*span)], arguments=tuple(arguments))
            )
    return SemanticGraph(caption, tuple(placed))


def _span_of(
    pieces: Pieces, node: Node, items: Sequence[Item], spans: Sequence[tuple[int, int]]
) -> tuple[int, int] | None:
    """Find the longest run of a node's pieces in a new caption, without signs at its ends; None if there is none."""
    own = set(pieces.of(node))
    runs: list[list[int]] = [[]]
    for position, item in enumerate(items):
        if item.piece in own:
            runs[-1].append(position)
        elif runs[-1]:
            runs.append([])
    run = max(runs, key=len)
    solid = [position for position in run if any(char.isalnum() for char in items[position].text)]
    return (spans[solid[0]][0], spans[solid[-1]][1]) if solid else None


def unique(items: Iterable[Item]) -> list[Item]:
    """Leave out items of pieces that came before: nodes may overlap."""
    seen: set[int | None] = set()
    kept = []
    for item in items:
        if item.piece is None or item.piece not in seen:
            kept.append(item)
        seen.add(item.piece)
    return kept
