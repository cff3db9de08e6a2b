"""Edits of a semantic graph (GraphMotion, Figures 5 and 6): each returns a new graph, the old one stays.

    from kinegraph.edits import replaced, with_weight, without

    graph = pipe.parse("a person walks slowly to the left")
    graph = with_weight(graph, "to the left", 2.0)  # stronger; 0 is exactly a graph without the node
    graph = without(graph, "slowly")  # the words go, too
    graph = replaced(graph, "walks", "runs")  # in the caption too, whose hidden states are the node features
    clip = pipe.generate(graph)

A node is named by its text, or by its number in the order of the model: actions from 1, then all specifics. Every edit
raises `InvalidGraphError` for a node that is not there (the message lists those that are) or a graph that cannot be.

Taking words out of a sentence so that what is left reads on."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.errors import InvalidGraphError
from kinegraph.graph import Action, Argument, SemanticGraph

MASK: Final = "[MASK]"
"""The word piece of the text encoder that stands for an unknown word (`manifest.text.mask_token`)."""


Node = int | str
Change = Callable[[Action | Argument], Action | Argument | None]


def listing(graph: SemanticGraph) -> str:
    """All nodes that an edit may name, on one line, with their numbers."""
    found = [f"{number} {action.text!r} (action)" for number, action in enumerate(graph.actions, start=1)]
    for action in graph.actions:
        for part in action.arguments:
            found.append(f"{len(found) + 1} {part.text!r} ({part.role} of {action.text!r})")
    return ", ".join(found)


def number_of(graph: SemanticGraph, node: Node) -> int:
    """The number of a node, given as that or as its text (case and spacing aside)."""
    nodes = graph.nodes
    if isinstance(node, str):
        wanted = _plain(node)
        found = [number for number, each in enumerate(nodes, start=1) if _plain(each.text) == wanted]
        if len(found) > 1:
            raise InvalidGraphError(f"{node!r} is the text of nodes {found}; say which by number: {listing(graph)}")
        if found:
            return found[0]
    elif type(node) is int and 1 <= node <= len(nodes):
        return node
    raise InvalidGraphError(f"no node {node!r}; there are {listing(graph)}")


def with_weight(graph: SemanticGraph, node: Node, weight: float) -> SemanticGraph:
    """Another weight on the edge that leads to a node from above: 1 is as parsed, 0 removes the node."""
    return _changed(graph, number_of(graph, node), lambda each: replace(each, weight=weight))


def without(graph: SemanticGraph, node: Node) -> SemanticGraph:
    """Without a node, an action's arguments with it, and without their words where no other node has them.

    The words must go too: the motion node is the whole caption. The order of other actions stays.
    """
    number = number_of(graph, node)
    if number == 1 == len(graph.actions):
        raise InvalidGraphError(f"{graph.actions[0].text!r} is the only action; a graph needs one")
    left = _changed(graph, number, lambda _: None)
    one = graph.nodes[number - 1]
    gone = [one, *(one.arguments if isinstance(one, Action) else ())]
    joined = one.start if isinstance(one, Action) else None
    caption, place = without_words(graph.caption, [_span(each) for each in gone], [*map(_span, left.nodes)], joined)
    return _moved(left, caption, lambda node: (place[node.start], place[node.end - 1] + 1))


def replaced(graph: SemanticGraph, node: Node, text: str) -> SemanticGraph:
    """Other words for a node, in the caption too."""
    words = text.strip() if isinstance(text, str) else ""
    if not words:
        raise InvalidGraphError(f"a node needs words, not {text!r}; to take it away, drop it")
    one = graph.nodes[number_of(graph, node) - 1]
    return _rewritten(graph, one.start, one.end, words)


def masked(graph: SemanticGraph, node: Node) -> SemanticGraph:
    """A node whose words the text encoder is not told; its edges stay (GraphMotion, Table 6)."""
    return replaced(graph, node, MASK)


def with_action(graph: SemanticGraph, text: str, weight: float = 1.0) -> SemanticGraph:
    """One more action, after the others and at the end of the caption: "... and {text}"."""
    joined, start, end = _appended(graph, len(graph.caption), f" and {_words(text)}", len(" and "))
    order = 1 + max(action.order for action in graph.actions)
    return replace(joined, actions=(*joined.actions, Action(joined.caption[start:end], start, end, order, weight)))


def with_argument(graph: SemanticGraph, action: Node, role: str, text: str, weight: float = 1.0) -> SemanticGraph:
    """One more specific of an action, in the caption behind what the action has already."""
    number = number_of(graph, action)
    if number > len(graph.actions):
        raise InvalidGraphError(f"{action!r} is no action; specifics hang on actions: {listing(graph)}")
    own = graph.actions[number - 1]
    place = max([own.end, *(part.end for part in own.arguments)])
    joined, start, end = _appended(graph, place, f" {_words(text)}", 1)

    def add(each: Action | Argument) -> Action | Argument:
        assert isinstance(each, Action)
        part = Argument(role, joined.caption[start:end], start, end, weight)
        return replace(each, arguments=(*each.arguments, part))

    return _changed(joined, number, add)


def _plain(text: str) -> str:
    return " ".join(text.casefold().split())


def _words(text: str) -> str:
    if not isinstance(text, str) or not text.strip():
        raise InvalidGraphError(f"a node needs words, not {text!r}")
    return text.strip()


def _changed(graph: SemanticGraph, number: int, change: Change) -> SemanticGraph:
    """The graph with one node changed, or removed where `change` returns None."""
    at = len(graph.actions)
    actions = []
    for place, action in enumerate(graph.actions, start=1):
        parts = []
        for part in action.arguments:
            at += 1
            found = change(part) if at == number else part
            if isinstance(found, Argument):
                parts.append(found)
        own = replace(action, arguments=tuple(parts))
        kept = change(own) if place == number else own
        if isinstance(kept, Action):
            actions.append(kept)
    return SemanticGraph(graph.caption, tuple(actions))


def _rewritten(graph: SemanticGraph, start: int, end: int, text: str) -> SemanticGraph:
    """The graph with other text in place of `caption[start:end]`; all spans follow."""
    caption = graph.caption[:start] + text + graph.caption[end:]
    grown = len(text) - (end - start)

    def moved(node: Action | Argument) -> tuple[int, int]:
        if node.end <= start and node.start < start:
            return node.start, node.end
        if node.start >= end:
            return node.start + grown, node.end + grown
        if node.start <= start and node.end >= end:
            return node.start, node.end + grown
        raise InvalidGraphError(f"{node.text!r} lies in the words to be replaced; drop it first: {listing(graph)}")

    return _moved(graph, caption, moved)


def _moved(graph: SemanticGraph, caption: str, moved: Callable[[Action | Argument], tuple[int, int]]) -> SemanticGraph:
    """The same nodes on another caption, `moved` telling where each of them is."""

    def respanned(node: Action | Argument) -> dict[str, int | str]:
        start, end = moved(node)
        return {"start": start, "end": end, "text": caption[start:end]}

    actions = []
    for action in graph.actions:
        parts = tuple(replace(part, **respanned(part)) for part in action.arguments)  # type: ignore[arg-type]
        actions.append(replace(action, arguments=parts, **respanned(action)))  # type: ignore[arg-type]
    return SemanticGraph(caption, tuple(actions))


def _span(node: Action | Argument) -> tuple[int, int]:
    return node.start, node.end


def _appended(graph: SemanticGraph, place: int, text: str, skip: int) -> tuple[SemanticGraph, int, int]:
    """The graph with text inserted, and where that text, without its first `skip` characters, lies."""
    return _rewritten(graph, place, place, text), place + skip, place + len(text)


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
