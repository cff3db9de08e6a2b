"""Third person: who moves in a caption, and its verbs in the form that training captions have."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from typing import Final

from kinegraph.errors import InvalidGraphError
from kinegraph.graph import Action, Argument, SemanticGraph
from kinegraph.limits import MAX_NODES
from kinegraph.text import lexicon
from kinegraph.text.pieces import NEGATING, SEQUENCE_WORDS, Item, Pieces

SUBJECT: Final = "a person"
"""Who moves where a caption does not say it."""


READERS: Final = frozenset("i me we us you your my our".split())
"""Words for who reads or writes a caption, not for who moves."""
OWNERS: Final = {"your": "the", "my": "the", "our": "the"}
"""What belongs to the reader, in a sentence about a person; training captions say "the hand", not "their hand"."""
_PLURALS: Final = frozenset("they them people men women children both all".split()) | frozenset(
    "two three four five six seven eight nine ten several many".split()
)
OBJECT_FORMS: Final = {"him": "he", "her": "she", "them": "they"}
"""Pronouns of objects, with those of subjects."""
BE: Final = frozenset("is are was were am be been being 's 're 'm gets get got".split())
"""Auxiliaries of the continuous form and the passive voice."""


def subject_of(graph: SemanticGraph, action: Action) -> Argument | None:
    """Find the argument that tells who moves: ARG0, or ARG1 before the verb or where it is who does something else."""
    candidates = [argument for argument in action.arguments if argument.role in ("ARG0", "ARG1")]
    candidates = [argument for argument in candidates if not _NO_SUBJECT.fullmatch(argument.text)]
    candidates = [argument for argument in candidates if argument.text.lower() not in _NO_ACTORS]
    for argument in sorted(candidates, key=lambda argument: argument.role):
        is_shared = any(
            other.start == argument.start and other.end == argument.end and argument.end <= action_of_other.start
            for action_of_other in graph.actions
            for other in action_of_other.arguments
            if other.role in ("ARG0", "ARG1")
        )
        if argument.role == "ARG0" or argument.end <= action.start or is_shared:
            return argument
    return None


_NO_ACTORS: Final = lexicon.DIRECTION_ADVERBS | lexicon.NOUN_ADJECTIVES | lexicon.ROTATIONS
_NO_SUBJECT: Final = re.compile(r"who|which|that|nobody|no one|by\b.*|to\b.*|.*clock-?wise", re.IGNORECASE | re.DOTALL)


def subject_items(pieces: Pieces, subject: Argument | None) -> list[Item]:
    """Return the items of who moves; "a person" if nobody is named, or the reader."""
    if subject is None:
        return [Item(SUBJECT)]
    own = list(pieces.of(subject))
    if is_reader(pieces, own):
        # the node stays on the words that stand for the reader
        return [Item(SUBJECT, own[0])] if own else [Item(SUBJECT)]
    if len(own) == 1:
        return [Item(OBJECT_FORMS.get(pieces.word(own[0]), pieces.pieces[own[0]].text), own[0])]
    return [Item(OWNERS.get(pieces.word(index), pieces.pieces[index].text), index) for index in own]


def is_reader(pieces: Pieces, own: Sequence[int]) -> bool:
    """Tell whether pieces name the reader, and not what belongs to them ("you", not "your left arm")."""
    return all(pieces.word(index) in READERS for index in own)


def repeat_verbs(graph: SemanticGraph) -> SemanticGraph:
    """Say a verb again where a caption says it once for what follows: "turn left, then right" turns twice.

    A caption that becomes longer than allowed stays as it is.
    """
    for index, action in enumerate(graph.actions):
        behind = sorted((node for node in action.arguments if node.start >= action.end), key=lambda node: node.start)
        for before, node in pairwise(behind):
            words = node.text.split(maxsplit=1)
            is_first = before is behind[0] and len(words) > 1 and words[0].lower() in THEN
            is_apart = before.text.lower() in THEN and before is not behind[0]
            if not (is_first or is_apart):
                continue
            place = node.start + (len(node.text) - len(words[1]) if is_first else 0)
            if any(action.end <= other.start < node.end for other in graph.actions):
                break
            with suppress(InvalidGraphError):
                return _say_again(graph, index, place)
    return graph


def _say_again(graph: SemanticGraph, index: int, place: int) -> SemanticGraph:
    """Insert the verb of an action at a character; what stands behind it belongs to the new action."""
    action = graph.actions[index]
    shift = len(action.text) + 1

    def moved(node: Argument) -> Argument:
        start = max(node.start, place)  # without "then"
        return replace(node, text=graph.caption[start : node.end], start=start + shift, end=node.end + shift)

    def kept(node: Action | Argument) -> tuple[int, int]:
        return (node.start + shift, node.end + shift) if node.start >= place else (node.start, node.end)

    first = tuple(node for node in action.arguments if node.end <= place and node.text.lower() not in THEN)
    second = tuple(moved(node) for node in action.arguments if node.end > place)
    actions = []
    for other in graph.actions:
        arguments = (
            first
            if other is action
            else tuple(replace(node, start=kept(node)[0], end=kept(node)[1]) for node in other.arguments)
        )
        actions.append(replace(other, start=kept(other)[0], end=kept(other)[1], arguments=arguments))
    again = replace(action, start=place, end=place + len(action.text), arguments=second)
    caption = f"{graph.caption[:place]}{action.text} {graph.caption[place:]}"
    return SemanticGraph(caption, (*actions[: index + 1], again, *actions[index + 1 :]))


THEN: Final = frozenset("then next afterwards finally".split())
"""Words behind which a verb may be meant that is said before ("turn left, then right")."""


def name_subject(graph: SemanticGraph) -> SemanticGraph:
    """Make "a person" at the start of a caption an argument of the actions that have no other subject.

    Participles keep none, as in "a person walks while waving"; nor do actions for which the graph has no room.
    """
    actions = []
    room = MAX_NODES - graph.node_count
    for action in graph.actions:
        word = action.text.lower()
        if room > 0 and form(word) != "participle" and subject_of(graph, action) is None:
            undergoes = lexicon.FINITE_VERBS.get(word, word) in lexicon.UNACCUSATIVE
            has_object = any(argument.role == "ARG1" for argument in action.arguments)
            role = "ARG1" if undergoes and not has_object else "ARG0"
            subject = Argument(role, graph.caption[: len(SUBJECT)], 0, len(SUBJECT))
            actions.append(replace(action, arguments=(subject, *action.arguments)))
            room -= 1
        else:
            actions.append(action)
    return SemanticGraph(graph.caption, tuple(actions))


def verb_items(pieces: Pieces, action: Action, text: str | None = None) -> list[Item]:
    """Return the items of a verb in the third person singular; in the passive voice, with "is" before it."""
    own = list(pieces.of(action))
    if not own:
        raise InvalidGraphError(f"the action {action.text!r} has no word")
    if text is None and is_passive(pieces, own[0]):
        return [Item("is"), *pieces.items(own)]
    return [Item(text or third_person(pieces.pieces[own[0]].text), own[0]), *pieces.items(own[1:])]


def is_passive(pieces: Pieces, verb: int) -> bool:
    """Tell whether a verb is a past participle behind a form of "be", with negators and adverbs between."""
    word = pieces.word(verb)
    if not (word.endswith("ed") or word in lexicon.PAST_PARTICIPLES):
        return False
    before = verb - 1
    while before >= 0 and (pieces.word(before) in NEGATING - BE or pieces.word(before).endswith("ly")):
        before -= 1
    return pieces.word(before) in BE | {"isn't", "aren't", "wasn't"}


_NO_VERBS: Final = (
    lexicon.DIRECTION_ADVERBS
    | lexicon.PLACE_PREPOSITIONS
    | lexicon.DIRECTION_PREPOSITIONS
    | lexicon.MANNER_PREPOSITIONS
)


def third_person(verb: str) -> str:
    """Put a verb in any form into the third person singular of the present; other words stay as they are."""
    word = verb.lower()
    if word in _NO_VERBS or len(word) < 2 or not (word.isalpha() and word.isascii()):
        return verb
    if word in lexicon.IRREGULAR_FORMS:
        return lexicon.third_person(lexicon.IRREGULAR_FORMS[word])
    if word in lexicon.FINITE_VERBS or word in ("is", "has", "does"):
        return word
    if word in lexicon.VERBS:
        return lexicon.third_person(word)
    base = lexicon.PARTICIPLES.get(word) or (None if word.endswith("eed") else _regular_base(word))
    return lexicon.third_person(base) if base else (word if word.endswith("s") else lexicon.third_person(word))


def _regular_base(word: str) -> str | None:
    """Guess the base form of a regular participle or past form; a verb of the lexicon if there is one."""
    for ending in ("ing", "ed"):
        stem = word.removesuffix(ending)
        if stem == word or len(stem) < 2:
            continue
        is_doubled = len(stem) > 2 and stem[-1] == stem[-2]
        guesses = [stem, stem + "e", stem[:-1] if is_doubled else stem, stem[:-1] + "y" if stem[-1] == "i" else stem]
        known = next((guess for guess in guesses if guess in lexicon.VERBS), None)
        if known is None:
            ends_like_handle = stem[-1] == "l" and stem[-2] not in "aeioul"
            needs_e = ends_like_handle or stem[-1] in "cvzu" or stem.endswith(("at", "dg"))
            known = stem + "e" if needs_e else (stem[:-1] if is_doubled and stem[-1] not in "ls" else stem)
        return known
    return None


def is_noun(pieces: Pieces, action: Action) -> bool:
    """Tell whether an action without a subject is a noun: an article, a number or an adjective stands before it."""
    own = pieces.of(action)
    before = pieces.word(own[0] - 1) if own else ""
    if before in _ARTICLES or before in lexicon.NOUN_ADJECTIVES:
        return True
    modifiers = [pieces.of(argument) for argument in action.arguments if argument.end <= action.start]
    if not own or not any(own[0] - 1 in modifier for modifier in modifiers):
        return False
    is_measure = any(own[0] - 1 in modifier and len(modifier) > 1 for modifier in modifiers)
    return is_measure or not (before.endswith("ly") or before in SEQUENCE_WORDS | NEGATING)


_ARTICLES: Final = frozenset("a an the another his her their".split())


def form(verb: str) -> str:
    """Tell the form of a verb: "base", "third", "participle" or "past"."""
    word = verb.lower()
    if word in lexicon.PARTICIPLES or word.endswith("ing"):
        return "participle"
    if word in lexicon.VERBS:
        return "base"
    is_regular = word.endswith("ed") and not word.endswith("eed")
    if is_regular or word in lexicon.IRREGULAR_FORMS or word in lexicon.PAST_PARTICIPLES:
        return "past"
    return "third" if word in lexicon.FINITE_VERBS or word.endswith("s") else "base"


_FOCUS: Final = frozenset("just only simply also really even ever again".split())


def word_before(pieces: Pieces, index: int) -> str:
    """Return the word before a verb, adverbs and "then" left out."""
    before = index - 1
    while pieces.word(before).endswith("ly") or pieces.word(before) in SEQUENCE_WORDS | _FOCUS:
        before -= 1
    return pieces.word(before)


def is_state(pieces: Pieces, action: Action) -> bool:
    """Tell whether an action is the word that would follow "is" ("left hand up", "mouth open")."""
    subject, word = subject_of(pieces.graph, action), action.text.lower()
    is_held = subject is not None and subject.role == "ARG1" and word in lexicon.POSTURES
    return is_held or (word in _NO_VERBS and word not in lexicon.VERBS)


def is_plural_noun(word: str) -> bool:
    """Tell by its ending whether a noun names several ("guards", not "boss")."""
    return word.endswith("s") and not word.endswith(("ss", "us", "'s", "’s"))


def is_singular(pieces: Pieces, subject: Argument) -> bool:
    """Tell whether who moves is one person or part of the body."""
    words = [pieces.word(index) for index in pieces.of(subject)]
    last = words[-1] if words else ""
    return not (last in lexicon.BODY_PLURALS or is_plural_noun(last) or _PLURALS & set(words) or "and" in words)
