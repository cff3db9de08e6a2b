"""How far a sentence turns the body: "turns left", "by 90 degrees", "a half turn", "around".

Only one turn of the whole body is read, whose size words fix: not "turns a wheel", "turns in circles", "turns left and
then right", or "turns twice".
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from kinegraph.graph import Action, SemanticGraph
from kinegraph.text.quantities import find_degrees

QUARTER, HALF, THREE_QUARTERS, FULL = 90.0, 180.0, 270.0, 360.0
UNSAID: Final = 85.0
"""Degrees from which a turn is held back where the sentence does not say how far: captured turns of people who walk
have 83 to 105."""
SLIGHT: Final = 30.0
"""The same of a slight turn."""


@dataclass(frozen=True)
class Turn:
    """How far the body turns from the first frame to the last."""

    degrees: float
    """Above 0: exactly, if it is said; else from here on a turn is held back, the later the heavier its edges are."""
    side: int
    """1 to the left, -1 to the right, 0 either way."""
    is_said: bool
    """Whether the sentence says how far."""


_VERB: Final = re.compile(r"(?:turn|pivot|swivel|veer|swerve)(?:s|e?d|ing)?$", re.IGNORECASE)
_TO_A_SIDE: Final = re.compile(r"(?:rotat|spin|twirl|whirl)(?:e?s|ed|n?ing|e)?$", re.IGNORECASE)
"""Verbs of turns that go on, unless the sentence says how far."""
_NOUN: Final = re.compile(
    r"\b(?:an?|one|the|sharp|slight|small|left|right|quarters?|half|full|complete|whole|degrees?)[ -](?:u-?)?"
    r"(?:turn|rotation)\b|\bu-?turn\b|\babout[ -]?(?:face|turn)\b|\b(?:along|around|round) a (?:bend|curve)\b"
    r"|\b(?:walk|path|way|course|run)\b[^,.;]*? (?:bends|curves)\b",
    re.IGNORECASE,
)
_CIRCLE: Final = re.compile(
    r"\b(?:in|around|along|walk\w*|run\w*|jog\w*) (?:an? |the )?(?:\w+ ){0,2}(?:circle|ring)\b", re.IGNORECASE
)
"""One round, more or less."""
_MEASURE: Final = re.compile(r"degree|°|\b(?:turn|circle|way\b|quarter|half|u\b|rotation|revolution)", re.IGNORECASE)
"""Objects of "turns" that are no things."""
_OTHER_SENSE: Final = re.compile(
    r"\w+ (?:off|over|up|down|into|upside|inside)\b"
    r"|\w+ on (?!the spot|one|place|(?:the|his|her|their|its|one)(?: left| right)? (?:heels?|foot|feet|legs?|toes?)\b)",
    re.IGNORECASE,
)
_WITHOUT_END: Final = re.compile(
    r"\b(?:ke(?:ep|eps|eping|pt) (?:on )?\w+ing|continu\w+|repeated\w*|again and again|always|several|many|times"
    r"|more than once|twice|thrice|both ways|to and fro|back and forth|left and (?:to the )?right"
    r"|right and (?:to the )?left|this way|(?:a?round|turns) and (?:a?round|turns)|circles|rings|loops?|spirals?)\b",
    re.IGNORECASE,
)
"""Words of turns whose size they do not fix, and of paths."""
_SLIGHT: Final = re.compile(r"\b(?:slight\w*|a little|a bit|small)\b", re.IGNORECASE)
_ROUND: Final = r"(?:turn|circle|rotation|revolution|round|spin|way)\b"
_AROUND: Final = re.compile(
    r"\b(?:a?round|(?<!look )(?<!looks )(?<!looking )back)\b(?! (?:the|an?|his|her|their|its|this|that|one) )",
    re.IGNORECASE,
)
_SIZES: Final = (
    (re.compile(r"\bthree[ -]quarters?\b", re.IGNORECASE), THREE_QUARTERS),
    (re.compile(r"\bquarter\b", re.IGNORECASE), QUARTER),
    (re.compile(rf"\bhalf[ -]?(?:an? )?{_ROUND}|\bu-?turn\b|\babout[ -]?(?:face|turn)\b", re.IGNORECASE), HALF),
    (re.compile(r"\b(?:the other way|(?:the )?opposite)\b", re.IGNORECASE), HALF),
    (
        re.compile(rf"\b(?:full|complete|whole) {_ROUND}|\b(?:completely|entirely|fully|all the way)\b", re.IGNORECASE),
        FULL,
    ),
    (_AROUND, HALF),
)
"""Words for sizes; the first that is there counts."""
_SIDES_OF_THE_BODY: Final = re.compile(r"\b(?:left|right) (?:foot|leg|heel|toes?|hand|arm|side)\b", re.IGNORECASE)
_AGAINST_THE_CLOCK: Final = re.compile(r"\b(?:(?:counter|anti|contra)[ -]?clockwise|ccw)\b", re.IGNORECASE)
_LEFT: Final = re.compile(r"\bleft\w*", re.IGNORECASE)
_RIGHT: Final = re.compile(r"\b(?:right\w*|clockwise|cw)\b", re.IGNORECASE)


def read_turn(graph: SemanticGraph) -> Turn | None:
    """Read how far a graph turns the body; None if it does not say, or is not of one turn.

    Actions that must not happen, and nodes of weight 0, count for nothing.
    """
    if _WITHOUT_END.search(graph.caption):
        return None
    caption = graph.caption
    for node in (node for action in graph.actions for node in action.arguments if node.weight == 0):
        caption = caption[: node.start] + " " * (node.end - node.start) + caption[node.end :]
    actions = sorted(graph.actions, key=lambda action: action.start)
    turns = [
        _turn_of(action, _clause(caption, actions, index))
        for index, action in enumerate(actions)
        if not action.negated and action.weight > 0
    ]
    read = [turn for turn in turns if turn is not None]
    return read[0] if len(read) == 1 else None


def _clause(caption: str, actions: Sequence[Action], index: int) -> str:
    """Take the words of an action: from what modifies it to the next action, with what it is done for ("to face left").

    The first action has its subject, too: "her walk bends to the left".
    """
    action = actions[index]
    starts = [node.start for node in action.arguments if index == 0 or node.role.startswith("ARGM")]
    ends = [node.end for node in action.arguments if node.text.startswith("to ")]
    after = [other.start for other in actions[index + 1 :] if other.start > action.start]
    return caption[min([action.start, *starts]) : max([min(after, default=len(caption)), *ends])]


def _turn_of(action: Action, clause: str) -> Turn | None:
    """Read the turn of one action."""
    is_circle = _CIRCLE.search(clause) is not None
    is_noun = is_circle or _NOUN.search(clause) is not None
    is_turn, goes_on = (words.match(action.text) is not None for words in (_VERB, _TO_A_SIDE))
    if not is_noun and (not (is_turn or goes_on) or _is_of_something_else(action, clause)):
        return None
    sides = _SIDES_OF_THE_BODY.sub("", _AGAINST_THE_CLOCK.sub("left", clause))
    left, right = _LEFT.search(sides) is not None, _RIGHT.search(sides) is not None
    degrees = _said_degrees(clause if (is_turn or is_noun) and not is_circle else _AROUND.sub("", clause))
    if degrees is not None:
        return Turn(degrees, int(left) - int(right), True)
    if (goes_on and not is_circle) or (left and right):
        return None
    weights = [node.weight for node in action.arguments if node.weight > 0 and _names_side(node.text)]
    usual = FULL if is_circle else SLIGHT if _SLIGHT.search(clause) else UNSAID
    return Turn(usual * action.weight * math.prod(weights), int(left) - int(right), False)


def _names_side(text: str) -> bool:
    return any(words.search(text) for words in (_LEFT, _RIGHT, _AGAINST_THE_CLOCK))


def _is_of_something_else(action: Action, clause: str) -> bool:
    """Tell whether a verb of turning has a thing as its object, or means something else with its particle."""
    things = [
        node
        for node in action.arguments
        if node.role in ("ARG1", "ARG2") and node.start > action.start and not _MEASURE.search(node.text)
    ]
    return bool(things) or _OTHER_SENSE.match(clause[clause.find(action.text) :]) is not None


def _said_degrees(clause: str) -> float | None:
    """Read the size of a turn; None where it is not said, or said more than once."""
    degrees = find_degrees(clause)
    if degrees:
        return degrees[0] if len(degrees) == 1 and 0 < degrees[0] <= 2 * FULL else None
    return next((size for words, size in _SIZES if words.search(clause)), None)
