"""Negated actions: which verbs of a caption say what must not happen.

"without waving", "does not turn", "never", "no jumping", "instead of running" negate; so do "stops running" (from
there on there is no running) and "keeps the hand down" (it is not raised). Standing still is an action like others,
however it is put: "does not move", "without moving". So are states: "do not look confident".
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from kinegraph.text import lexicon
from kinegraph.text.dependency import ParsedTokens
from kinegraph.text.rules import PredicateFrame

LIMBS: Final = frozenset("arm hand elbow fist leg knee foot heel".split())
_LOW: Final = frozenset("down lowered low".split())
_MOVING: Final = frozenset("move budge stir flinch".split())
_STATIVE: Final = lexicon.STATIVE | {"be", "have"}
_BETWEEN: Final = frozenset(
    "even ever really also just do does did to be being any a an the his her their its single much both either too"
    " again once longer".split()
)
"""Words that may stand between a negator and its verb, beside adverbs in -ly."""
_EVENTS: Final = lexicon.EVENT_NOUNS - frozenset("movement motion stop start balance point pace rotation stand".split())
"""Nouns of motion whose absence is a negated action."""


def negated_events(doc: Any) -> list[Any]:
    """Find nouns of motion behind "no" or "without": "no jumps", "no waving of the hand", "no raised hands"."""
    found = []
    for token in doc:
        if not (_names_motion(token) or _is_held(token)):
            continue
        before = token.i - 1
        while before > 0 and doc[before].head.i == token.i and doc[before].pos_ in ("DET", "ADJ", "NOUN", "PRON"):
            if doc[before].lower_ == "no":
                break
            before -= 1
        if before >= 0 and doc[before].lower_ in ("no", "without"):
            found.append(token)
    return found


def _names_motion(token: Any) -> bool:
    """Tell whether a noun is that of a motion: an event, or a verb in -ing."""
    is_event = token.lemma_.lower() in _EVENTS or token.lower_ in lexicon.PARTICIPLES
    return is_event and token.pos_ in ("NOUN", "PROPN") and token.dep_ not in ("compound", "amod")


def _is_held(token: Any) -> bool:
    """Tell whether a participle says how a part of the body is held ("raised hands")."""
    is_participle = token.lower_ in lexicon.PAST_PARTICIPLES or (token.lower_.endswith("ed") and token.dep_ == "amod")
    return is_participle and token.head.i > token.i and token.head.lower_ in lexicon.BODY_NOUNS


def mark_negations(tokens: ParsedTokens, frames: Sequence[PredicateFrame]) -> None:
    """Set `negated` of every frame whose action must not happen."""
    by_head = {frame.head.i: frame for frame in frames}
    for frame in frames:
        frame.negated = _is_kept_down(frame) or (_is_behind_negator(tokens, frame.head.i) and not _is_state(frame))
    for frame in frames:
        _inherit_negation(tokens, frame, by_head)
    for frame in frames:
        verb = _ending_verb(tokens, frame, by_head)
        if verb is not None:
            frame.negated = frame.negated or not verb.negated


def _is_behind_negator(tokens: ParsedTokens, verb: int) -> bool:
    """Tell whether a negator stands before a verb, with only words between that both belong to."""
    index = verb - 1
    while index >= 0:
        word = tokens.text[index]
        if word in lexicon.NEGATORS:
            return not (word == "not" and verb - 1 > index and tokens.text[index + 1] == "only")
        if word in ("of", "than"):
            return index > 0 and tokens.text[index - 1] in ("instead", "rather")
        is_own = (
            tokens.first[verb] <= index and tokens.pos[index] in ("ADJ", "NOUN", "NUM") and tokens.pos[verb] == "NOUN"
        )
        if not (word in _BETWEEN or word.endswith("ly") or is_own):
            return False
        if word == "only":
            return False
        index -= 1
    return False


def _is_state(frame: PredicateFrame) -> bool:
    """Tell whether a negated verb describes standing still or how somebody looks."""
    lemma = frame.head.lemma_.lower()
    children = {child.dep_ for child in frame.head.children}
    if lemma in _MOVING:
        goes = any(role == "ARGM-DIR" for role, _ in frame.arguments)
        return "dobj" not in children and not goes
    return lemma in _STATIVE and (lemma in ("be", "have") or bool(children & {"acomp", "oprd", "attr"}))


def _is_kept_down(frame: PredicateFrame) -> bool:
    """Tell whether an action is keeping arms or legs down."""
    if frame.head.lemma_.lower() not in lexicon.KEEPING:
        return False
    objects = [child for child in frame.head.children if child.dep_ in ("dobj", "nsubj", "oprd")]
    words = {below.lower_ for child in objects for below in child.subtree} | {
        token.lower_ for token in frame.head.doc[frame.head.i + 1 : frame.head.i + 6]
    }
    lemmas = {below.lemma_.lower() for child in objects for below in child.subtree}
    return bool(words & _LOW) and bool(lemmas & LIMBS)


def _inherit_negation(tokens: ParsedTokens, frame: PredicateFrame, by_head: dict[int, PredicateFrame]) -> None:
    """Negate a verb that is coordinated with a negated one and shares its negator ("without turning or waving")."""
    verb, above = frame.head.i, tokens.head[frame.head.i]
    other = by_head.get(above)
    if frame.negated or other is None or not other.negated or tokens.dep[verb] != "conj" or _is_kept_down(other):
        return
    if any(tokens.dep[index] in ("nsubj", "neg") and tokens.head[index] == verb for index in range(above, verb)):
        return
    between = {tokens.text[index] for index in range(above + 1, verb) if tokens.dep[index] in ("cc", "punct")}
    if "but" in between or not _is_behind_negator(tokens, _first_conjunct(tokens, above)):
        return
    shares_form = tokens.tag[verb] == tokens.tag[above] and tokens.tag[verb] in ("VB", "VBG", "VBP")
    frame.negated = "or" in between or "nor" in between or (shares_form and "and" in between)


def _first_conjunct(tokens: ParsedTokens, verb: int) -> int:
    while tokens.dep[verb] == "conj" and tokens.head[verb] != verb:
        verb = tokens.head[verb]
    return verb


def _ending_verb(
    tokens: ParsedTokens, frame: PredicateFrame, by_head: dict[int, PredicateFrame]
) -> PredicateFrame | None:
    """Find the verb that ends an action ("stops | running"), also for actions coordinated with it."""
    verb = _first_conjunct(tokens, frame.head.i)
    if tokens.tag[verb] != "VBG" or tokens.tag[frame.head.i] != "VBG":
        return None
    for back in (1, 2, 3):
        other = by_head.get(verb - back)
        if other is not None and other.head.lemma_.lower() in lexicon.ENDING:
            return other
        if verb - back < 0 or not (tokens.text[verb - back] == "from" or tokens.text[verb - back].endswith("ly")):
            return None
    return None
