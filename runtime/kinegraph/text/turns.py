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
    r"(?:turn|rotation)\b|\ban? (?:[a-z]+ )?(?:90|180|270|360)\b(?! \w*(?:sec|step|time|frame))"
    r"|\bu-?turn\b|\babout[ -]?(?:face|turn)\b"
    r"|\b(?:along|around|round) a (?:bend|curve)\b|\b(?:walk|path|way|course|run)\b[^,.;]*? (?:bends|curves)\b",
    re.IGNORECASE,
)
_CIRCLE: Final = re.compile(
    r"\b(?:in|around|along|walk\w*|run\w*|jog\w*) (?:an? |the )?(?:\w+ ){0,2}(?:circle|ring)\b", re.IGNORECASE
)
"""One round, more or less."""
_MEASURE: Final = re.compile(
    r"(?:slight\w*|a little|a bit)\b"
    r"|(?:all )?(?:(?:an?|the|one|one's|his|her|their|its) )?(?:(?!an? |the |upper |lower )\w+[ -]){0,3}?"
    r"(?:degree|[°º]|turn|circle|ring\b|bend\b|curve|way\b|quarter|half|u\b|about\b|rotation|revolution|\d+$"
    r"|body\b|(?:him|her|it|one)self\b|themsel(?:f|ves)\b)",
    re.IGNORECASE,
)
"""Objects of "turns" that are no things, and the body itself."""
_ARTICLE: Final = re.compile(r"(?:an?|the|his|her|their|its) ", re.IGNORECASE)
_OTHER_SENSE: Final = re.compile(
    r"\w+ (?:off|over|up|down|into|upside|inside)\b"
    r"|\w+ on (?!the spot|one|place|(?:the|his|her|their|its|one)(?: left| right)? (?:heels?|foot|feet|legs?|toes?)\b)",
    re.IGNORECASE,
)
_WITHOUT_END: Final = re.compile(
    r"\b(?:ke(?:ep|eps|eping|pt) (?:on )?\w+ing|continu\w+|repeated\w*|again and again|always|several|many|times"
    r"|more than once|twice|thrice|both ways|to and fro|back and forth|(?:and|then) back(?! to)"
    r"|left and (?:to the )?right|right and (?:to the )?left|this way"
    r"|(?:a?round|turns) and (?:a?round|turns)|circles|rings|loops?|spirals?)\b",
    re.IGNORECASE,
)
"""Words of turns whose size they do not fix, and of paths."""
_KEEPS: Final = re.compile(
    r"\b(?:ke(?:ep|eps|eping|pt)|continu\w+|repeated\w*|again and again|always|times|twice|thrice|both ways)"
    r"(?:,? (?:on|to|he|she|it|they|an? \w+|the \w+))* $",
    re.IGNORECASE,
)
"""Words right before a turn that say it is not one."""
_SLIGHT: Final = re.compile(r"\b(?:slight\w*|a little|a bit|small)\b", re.IGNORECASE)
_ROUND: Final = r"(?:turn|circle|rotation|revolution|round|spin|way)\b"
_AROUND: Final = re.compile(
    r"\ba?round\b(?! (?:the|an?|his|her|their|its|this|that|one) )"
    r"|\bturn(?:s|ed|ing)? back\b|\bto (?:face|go) back\b",
    re.IGNORECASE,
)
_MORE_THAN_ONE: Final = re.compile(
    r"\b(?:[2-9]|1\d|\d+\.\d+|two|three|four|five|six|seven|eight|nine|ten|both|couple of)(?: and a half)? (?:\w+ )?"
    rf"{_ROUND[:-2]}s\b|-\d+ ?(?:degree|deg\b|°)",
    re.IGNORECASE,
)
"""Sizes beyond one round, or that turn nobody."""
_BARE: Final = re.compile(
    r"\b(?:turn\w*|rotat\w*|spin\w*|pivot\w*|by|an?) (?:(?:a?round|(?:to the )?(?:left|right)),? |[a-z]+ )?"
    r"(45|90|135|180|270|360)\b"
    r"(?! ?(?:deg|°|cm\b|m\b|met|%|percent|\w*(?:sec|step|time|frame)))",
    re.IGNORECASE,
)
"""Degrees without the word: "turns 180", "does a 360"."""
_SIZES: Final = (
    (re.compile(r"\bthree[ -]quarters?\b", re.IGNORECASE), THREE_QUARTERS),
    (re.compile(r"\bquarter\b", re.IGNORECASE), QUARTER),
    (re.compile(rf"\bhalf[ -]?(?:an? )?{_ROUND}|\bu-?turn\b|\babout[ -]?(?:face|turn)\b", re.IGNORECASE), HALF),
    (re.compile(r"\b(?:the other way|(?:the )?opposite)\b", re.IGNORECASE), HALF),
    (
        re.compile(
            rf"\b(?:full|complete|whole) {_ROUND}|\ba?round (?:completely|entirely|fully)\b"
            r"|\b(?:completely|entirely|fully|all the way) (?:a?round|to the|left|right)\b"
            r"|(?:turn|rotat|spin|pivot)\w* (?:completely|entirely|fully)\b",
            re.IGNORECASE,
        ),
        FULL,
    ),
    (_AROUND, HALF),
)
"""Words for sizes; the first that is there counts."""
_SIDES_OF_THE_BODY: Final = re.compile(r"\b(?:left|right) (?:foot|leg|heel|toes?|hand|arm|side)\b", re.IGNORECASE)
_AGAINST_THE_CLOCK: Final = re.compile(r"\b(?:(?:counter|anti|contra)[ -]?clockwise|ccw)\b", re.IGNORECASE)
_LEFT: Final = re.compile(r"\bleft\w*", re.IGNORECASE)
_RIGHT: Final = re.compile(
    r"\b(?:right\w*|clockwise|cw)\b(?! (?:away|after|now|there|here|angle|behind|beside|before|in front)\b)",
    re.IGNORECASE,
)


def read_turn(graph: SemanticGraph) -> Turn | None:
    """Read how far a graph turns the body; None if it does not say, or is not of one turn.

    Actions that must not happen, and nodes of weight 0, count for nothing.
    """
    caption = graph.caption
    for node in (node for action in graph.actions for node in action.arguments if node.weight == 0):
        caption = caption[: node.start] + " " * (node.end - node.start) + caption[node.end :]
    actions = sorted(graph.actions, key=lambda action: action.start)
    turns = [
        _turn_of(action, _clause(caption, actions, index), caption[: action.start])
        for index, action in enumerate(actions)
        if not action.negated and action.weight > 0
    ]
    read = [turn for turn in turns if turn is not None]
    return read[0] if len(read) == 1 and read[0] is not _ENDLESS else None


def _clause(caption: str, actions: Sequence[Action], index: int) -> str:
    """Take the words of an action: from what modifies it to the next action, with what it is done for ("to face left").

    The first action has its subject, too: "her walk bends to the left".
    """
    action = actions[index]
    starts = [node.start for node in action.arguments if index == 0 or node.role.startswith("ARGM")]
    ends = [node.end for node in action.arguments if node.text.startswith("to ")]
    after = [other.start for other in actions[index + 1 :] if other.start > action.start]
    return caption[min([action.start, *starts]) : max([min(after, default=len(caption)), *ends])]


_ENDLESS: Final = Turn(0.0, 0, False)
"""A turn of no size that words fix."""


def _turn_of(action: Action, clause: str, before: str) -> Turn | None:
    """Read the turn of one action, of its clause and of the words before it."""
    is_circle = _CIRCLE.search(clause) is not None
    is_noun = is_circle or _NOUN.search(clause) is not None
    is_turn, goes_on = (words.match(action.text) is not None for words in (_VERB, _TO_A_SIDE))
    if not (is_noun or is_turn or goes_on) or _moves_a_thing(action):
        return None
    if not is_noun and _OTHER_SENSE.match(clause[clause.find(action.text) :]):
        return None
    led = before.rsplit(",", 1)[-1] + clause  # "two full | turns"
    if _WITHOUT_END.search(clause) or _MORE_THAN_ONE.search(led) or _KEEPS.search(before):
        return _ENDLESS
    sides = _SIDES_OF_THE_BODY.sub("", _AGAINST_THE_CLOCK.sub("left", clause))
    left, right = _LEFT.search(sides) is not None, _RIGHT.search(sides) is not None
    degrees = _said_degrees(clause if (is_turn or is_noun) and not is_circle else _AROUND.sub("", clause))
    if (left and right) or len(degrees) > 1 or not all(0 < each <= 2 * FULL for each in degrees):
        return None
    if degrees:
        return Turn(degrees[0], int(left) - int(right), True)
    if goes_on and not is_circle:
        return None
    weights = [node.weight for node in action.arguments if node.weight > 0 and _names_side(node.text)]
    usual = FULL if is_circle else SLIGHT if _SLIGHT.search(clause) else UNSAID
    return Turn(usual * action.weight * math.prod(weights), int(left) - int(right), False)


def _names_side(text: str) -> bool:
    return any(words.search(text) for words in (_LEFT, _RIGHT, _AGAINST_THE_CLOCK))


def _moves_a_thing(action: Action) -> bool:
    """Tell whether an action has a thing or a limb as its object: "turns a wheel", "swings the arm in a circle"."""
    behind = [node for node in action.arguments if node.start > action.start and not _MEASURE.match(node.text)]
    return any(
        node.role in ("ARG1", "ARG2") or (node.role == "OTHERS" and _ARTICLE.match(node.text)) for node in behind
    )


def _said_degrees(clause: str) -> list[float]:
    """Read all sizes of a turn; none where it is not said how far."""
    degrees = find_degrees(clause) or [float(size) for size in _BARE.findall(clause)]
    return degrees or [size for words, size in _SIZES if words.search(clause)][:1]
