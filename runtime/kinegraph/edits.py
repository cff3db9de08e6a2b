"""Edits of a semantic graph (GraphMotion, Figures 5 and 6): each returns a new graph and leaves the old one unchanged.

    from kinegraph.edits import replaced, with_weight, without

    graph = pipe.parse("a person walks slowly to the left")
    graph = with_weight(graph, "to the left", 2.0)  # stronger; 0 is exactly a graph without the node
    graph = without(graph, "slowly")  # also removes the words from the caption
    graph = replaced(graph, "walks", "runs")  # also replaces the word in the caption
    clip = pipe.generate(graph)

The caption changes with the graph, because node features are the text encoder's hidden states of the caption. A node is
named by its text, or by its number in the order of the model: actions from 1, then all arguments. Every edit raises
`InvalidGraphError` if the node does not exist (the message lists those that do) or the new graph is invalid.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.errors import InvalidGraphError
from kinegraph.graph import Action, Argument, SemanticGraph
from kinegraph.validation import short_repr

MASK: Final = "[MASK]"
"""Word piece of the text encoder for an unknown word."""

Node = int | str
"""Number or text of a node."""
Change = Callable[[Action | Argument], Action | Argument | None]
"""Returns the changed node, or None to remove it."""
Span = tuple[int, int]
"""First character and one past the last."""


def listing(graph: SemanticGraph) -> str:
    """List all nodes that an edit may name on one line, with their numbers."""
    entries = [f"{number} {action.text!r} (action)" for number, action in enumerate(graph.actions, start=1)]
    for action in graph.actions:
        for argument in action.arguments:
            entries.append(f"{len(entries) + 1} {argument.text!r} ({argument.role} of {action.text!r})")
    return ", ".join(entries)


def number_of(graph: SemanticGraph, node: Node) -> int:
    """Find the number of a node that is named by its number or by its text, ignoring case and spacing."""
    nodes = graph.nodes
    if isinstance(node, str):
        wanted = _fold(node)
        numbers = [number for number, candidate in enumerate(nodes, start=1) if _fold(candidate.text) == wanted]
        if len(numbers) > 1:
            raise InvalidGraphError(
                f"{short_repr(node)} is the text of nodes {numbers}; say which by number: {listing(graph)}"
            )
        if numbers:
            return numbers[0]
    elif type(node) is int and 1 <= node <= len(nodes):
        return node
    raise InvalidGraphError(f"no node {short_repr(node)}; there are {listing(graph)}")


def with_weight(graph: SemanticGraph, node: Node, weight: float) -> SemanticGraph:
    """Set the weight of the edge that leads to a node from above: 1 is neutral, 0 removes the node."""
    return _change_node(graph, number_of(graph, node), lambda old: replace(old, weight=weight))


def without(graph: SemanticGraph, node: Node) -> SemanticGraph:
    """Remove a node, with its arguments if it is an action, and the words that no other node has.

    The words must be removed too, because the motion node encodes the whole caption. The order of other actions stays.
    """
    number = number_of(graph, node)
    if number == 1 == len(graph.actions):
        raise InvalidGraphError(f"{graph.actions[0].text!r} is the only action; a graph needs one")
    pruned = _change_node(graph, number, lambda _: None)
    target = graph.nodes[number - 1]
    removed, verb_start = [_span(target)], None
    if isinstance(target, Action):
        removed += map(_span, target.arguments)
        verb_start = target.start
        if target.negated:
            pruned, phrases = _without_phrases(pruned, target)
            verb_start = _negator_start(graph.caption, target.start)
            removed += [*phrases, (verb_start, target.end)]
    caption, positions = remove_words(graph.caption, removed, [*map(_span, pruned.nodes)], verb_start)
    return _move_nodes(pruned, caption, lambda node: (positions[node.start], positions[node.end - 1] + 1))


def _without_phrases(graph: SemanticGraph, removed: Action) -> tuple[SemanticGraph, list[Span]]:
    """Remove arguments that hold a removed action and no other ("without waving"); returns their spans too."""

    def holds(argument: Argument, action: Action) -> bool:
        return argument.start <= action.start and action.end <= argument.end

    phrases, actions = [], []
    for action in graph.actions:
        lost = [a for a in action.arguments if holds(a, removed) and not any(holds(a, b) for b in graph.actions)]
        phrases += [_span(argument) for argument in lost]
        actions.append(replace(action, arguments=tuple(a for a in action.arguments if a not in lost)))
    return SemanticGraph(graph.caption, tuple(actions)), phrases


def _negator_start(caption: str, verb_start: int) -> int:
    """Find the first character of the words that negate a verb."""
    match = _NEGATORS_BEFORE.search(caption, 0, verb_start)
    return match.start() + len(match.group()) - len(match.group().lstrip()) if match else verb_start


def replaced(graph: SemanticGraph, node: Node, text: str) -> SemanticGraph:
    """Replace the words of a node, in the caption too."""
    words = text.strip() if isinstance(text, str) else ""
    if not words:
        raise InvalidGraphError(f"a node needs words, not {short_repr(text)}; to take it away, drop it")
    target = graph.nodes[number_of(graph, node) - 1]
    return _rewrite_caption(graph, target.start, target.end, words)


def masked(graph: SemanticGraph, node: Node) -> SemanticGraph:
    """Hide the words of a node from the text encoder; the node and its edges stay (GraphMotion, Table 6)."""
    return replaced(graph, node, MASK)


def with_action(graph: SemanticGraph, text: str, weight: float = 1.0) -> SemanticGraph:
    """Add an action after the others, and " and {text}" at the end of the caption."""
    extended, start, end = _insert_text(graph, len(graph.caption), f" and {_check_words(text)}", len(" and "))
    order = 1 + max(action.order for action in graph.actions)
    action = Action(extended.caption[start:end], start, end, order, weight)
    return replace(extended, actions=(*extended.actions, action))


def with_argument(graph: SemanticGraph, action: Node, role: str, text: str, weight: float = 1.0) -> SemanticGraph:
    """Add an argument to an action, and its text to the caption behind the action and its other arguments."""
    number = number_of(graph, action)
    if number > len(graph.actions):
        raise InvalidGraphError(f"{short_repr(action)} is no action; specifics hang on actions: {listing(graph)}")
    target = graph.actions[number - 1]
    position = max([target.end, *(argument.end for argument in target.arguments)])
    extended, start, end = _insert_text(graph, position, f" {_check_words(text)}", 1)

    def add(node: Action | Argument) -> Action | Argument:
        assert isinstance(node, Action)
        argument = Argument(role, extended.caption[start:end], start, end, weight)
        return replace(node, arguments=(*node.arguments, argument))

    return _change_node(extended, number, add)


def _fold(text: str) -> str:
    """Ignore case and spacing."""
    return " ".join(text.casefold().split())


def _check_words(text: str) -> str:
    if not isinstance(text, str) or not text.strip():
        raise InvalidGraphError(f"a node needs words, not {short_repr(text)}")
    return text.strip()


def _span(node: Action | Argument) -> Span:
    return node.start, node.end


def _change_node(graph: SemanticGraph, number: int, change: Change) -> SemanticGraph:
    """Apply `change` to one node; an action is removed with its arguments."""
    argument_number = len(graph.actions)
    actions = []
    for action_number, action in enumerate(graph.actions, start=1):
        arguments = []
        for argument in action.arguments:
            argument_number += 1
            new_argument = change(argument) if argument_number == number else argument
            if isinstance(new_argument, Argument):
                arguments.append(new_argument)
        updated = replace(action, arguments=tuple(arguments))
        new_action = change(updated) if action_number == number else updated
        if isinstance(new_action, Action):
            actions.append(new_action)
    return SemanticGraph(graph.caption, tuple(actions))


def _rewrite_caption(graph: SemanticGraph, start: int, end: int, text: str) -> SemanticGraph:
    """Replace `caption[start:end]` by other text and shift the spans of all nodes."""
    caption = graph.caption[:start] + text + graph.caption[end:]
    shift = len(text) - (end - start)

    def shifted(node: Action | Argument) -> Span:
        if node.end <= start and node.start < start:  # before the text
            return node.start, node.end
        if node.start >= end:  # behind it
            return node.start + shift, node.end + shift
        if node.start <= start and node.end >= end:  # around it
            return node.start, node.end + shift
        raise InvalidGraphError(f"{node.text!r} lies in the words to be replaced; drop it first: {listing(graph)}")

    return _move_nodes(graph, caption, shifted)


def _insert_text(graph: SemanticGraph, position: int, text: str, skip: int) -> tuple[SemanticGraph, int, int]:
    """Insert text into the caption; also returns the span of that text without its first `skip` characters."""
    return _rewrite_caption(graph, position, position, text), position + skip, position + len(text)


def _move_nodes(graph: SemanticGraph, caption: str, new_span: Callable[[Action | Argument], Span]) -> SemanticGraph:
    """Put the nodes of a graph on another caption, at the spans that `new_span` returns."""

    def position(node: Action | Argument) -> dict[str, int | str]:
        start, end = new_span(node)
        return {"start": start, "end": end, "text": caption[start:end]}

    actions = []
    for action in graph.actions:
        arguments = tuple(replace(argument, **position(argument)) for argument in action.arguments)  # type: ignore[arg-type]
        actions.append(replace(action, arguments=arguments, **position(action)))  # type: ignore[arg-type]
    return SemanticGraph(caption, tuple(actions))


_NEGATORS_BEFORE: Final = re.compile(
    r"(?:(?:\b|\s|^)(?:(?:do|does|did|is|are|was|wo|ca)n[’']?t|without|not|never|no|do|does|did|is|are|instead|rather|of"
    r"|than)\b\s*)+\Z",
    re.IGNORECASE,
)

# Removing words from a sentence

_CONNECTIVE: Final = r"(?:[\s,;]|\b(?:and|but|then|while|before|after)\b)+"
_CONNECTIVE_BEFORE: Final = re.compile(_CONNECTIVE + r"\Z", re.IGNORECASE)
_CONNECTIVE_BEHIND: Final = re.compile(_CONNECTIVE, re.IGNORECASE)


def remove_words(
    caption: str, removed: Sequence[Span], kept: Sequence[Span], verb_start: int | None
) -> tuple[str, list[int]]:
    """Remove words from a sentence and tidy its connectives, spaces and commas.

    Args:
        caption: the sentence.
        removed: spans to remove, except for characters of `kept`.
        kept: spans to keep unchanged.
        verb_start: start of the verb among the removed words, None if there is none. The connective before it ("and",
            a comma) is removed too; if there is none, the connective behind its words.

    Returns:
        The shorter sentence, and for each character of the old one its index in the new one. Indices of removed
        characters have no meaning.
    """
    keep = np.ones(len(caption), dtype=bool)
    for start, end in removed:
        keep[start:end] = False
    if verb_start is not None:
        words_end = max(end for start, end in removed if start >= verb_start)
        keep[_connective_slice(caption, verb_start, words_end)] = False
    protected = np.zeros(len(caption), dtype=bool)
    for start, end in kept:
        protected[start:end] = True
    keep |= protected
    _tidy_punctuation(caption, keep, protected)
    text = "".join(character for character, is_kept in zip(caption, keep, strict=True) if is_kept)
    positions: list[int] = (np.cumsum(keep) - 1).tolist()
    return text.rstrip(), positions


def _connective_slice(caption: str, start: int, end: int) -> slice:
    """Find the connective before `start`, else the one behind `end`; an empty slice if both are only spaces."""
    before, behind = _CONNECTIVE_BEFORE.search(caption, 0, start), _CONNECTIVE_BEHIND.match(caption, end)
    if before and before.group().strip():
        return slice(*before.span())
    return slice(*behind.span()) if behind and behind.group().strip() else slice(0, 0)


def _tidy_punctuation(caption: str, keep: NDArray[np.bool_], protected: NDArray[np.bool_]) -> None:
    """Update `keep` so that one space is left at a gap, no comma follows a space, and no space precedes a full stop.

    Args:
        caption: the sentence, n characters.
        keep: (n,) True for characters that stay; changed in place.
        protected: (n,) True for characters that must stay.
    """
    last, last_index = " ", 0  # the last character that stays
    removed_space = None  # index of a removed space since then
    for index, character in enumerate(caption):
        if not keep[index]:
            removed_space = index if character == " " else removed_space
        elif last == " " and character in " ,;" and not protected[index]:
            keep[index] = False
        else:
            if removed_space is not None and last != " " and character not in " ,;.":
                keep[removed_space] = True  # two words would run together
            if last == " " and character == "." and not protected[last_index]:
                keep[last_index] = False
            last, last_index, removed_space = character, index, None
