"""Verbs of a caption by its wording alone: where its clauses begin, and which word there is their verb.

The small spaCy model takes many verbs of motion for nouns ("walk, wave, bow"; "a zombie walks"). It is easy to tell
what a clause begins with: an order with a verb, a title with a participle, a sentence with who moves. `normalise` uses
the verbs to choose what spaCy reads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import Enum
from itertools import pairwise
from typing import Final

from kinegraph.text import lexicon


class Form(Enum):
    """Form of a verb."""

    NONE = 0
    """No verb, or one that spaCy finds by itself."""
    BASE = 1
    """An order: "walk"."""
    THIRD = 2
    """Third person: "walks"; also the base form of who is told to move ("make him walk")."""
    PARTICIPLE = 3
    """A title: "walking"."""
    STATE = 4
    """The word that would follow "is" in a phrase without a verb ("left hand up")."""


SEPARATORS: Final = frozenset(", ; : / - – — | ... …".split())
"""Signs that part clauses; behind a full stop a sentence begins."""
_ENDS: Final = frozenset(". ! ?".split())
_CONNECTIVES: Final = frozenset("and or but then nor plus".split())
_SKIPPED: Final = frozenset(
    "then next now also just again always never not n't nt do don't first firstly second secondly third thirdly fourth"
    " fifth finally lastly afterwards afterward subsequently immediately suddenly quickly please simply maybe only"
    " once everyone always soon later 1st 2nd 3rd".split()
)
"""Words that may stand between the beginning of a clause and its verb."""
ORDINALS: Final = frozenset("second secondly third thirdly fourth fifth sixth lastly 1st 2nd 3rd 4th 5th".split())
"""Words that count clauses, which spaCy takes for nouns: it reads "then"."""

_DETERMINERS: Final = frozenset("a an the this that my your his her our their its one".split())
_PHRASE_WORDS: Final = frozenset("both all two three each every no some left right other of the his her their".split())
_RELATIVE: Final = frozenset("who which that".split())
_OPENERS: Final = frozenset("and or but then nor neither who which that he she it they also".split())
_OBJECT_PRONOUNS: Final = frozenset("it them him her me us both".split())
_PREPOSITIONS: Final = (
    lexicon.DIRECTION_PREPOSITIONS
    | lexicon.PLACE_PREPOSITIONS
    | lexicon.TIME_PREPOSITIONS
    | lexicon.MANNER_PREPOSITIONS
)
_NO_VERBS: Final = (
    lexicon.SUBJECT_NOUNS
    | lexicon.BODY_NOUNS
    | lexicon.DIRECTION_ADVERBS
    | lexicon.CIRCLE_NOUNS
    | lexicon.TIME_ADVERBS
    | lexicon.MANNER_ADVERBS
    | lexicon.PLACE_ADVERBS
    | lexicon.OTHER_ADVERBS
    | lexicon.DISCOURSE_ADVERBS
    | lexicon.TIME_NOUNS
    | _PREPOSITIONS
    | _DETERMINERS
    | _PHRASE_WORDS
    | frozenset("make people dog cat baby girl boy robot soldier monkey bird horse very be is are have has".split())
)
"""Words of a general dictionary of verbs that open no order."""
_NO_ACTORS: Final = _NO_VERBS | lexicon.VERBS | lexicon.NOUN_ADJECTIVES
_OBJECT_FOLLOWERS: Final = _DETERMINERS | _OBJECT_PRONOUNS | lexicon.DIRECTION_ADVERBS - {"left", "right"}
"""Words behind which a word of a general dictionary of verbs is a verb."""
_ADJECTIVE_VERBS: Final = frozenset("slow open close clean lower calm free cool".split())
_NOUN_FOLLOWERS: Final = lexicon.EVENT_NOUNS | frozenset("body motion movement".split())
STATE_WORDS: Final = lexicon.POSTURES | frozenset(
    "forwards backward backwards on in at above over under behind below beside between against to near inside"
    " around".split()
)
"""Words that may follow "is" in a phrase of a body part or a person without a verb."""
_PLACE_OPENERS: Final = frozenset("on in at under behind near beside between against inside above over".split())
"""Prepositions that may begin a phrase without a verb ("on one leg")."""


def find_clause_verbs(
    lower: Sequence[str], is_told: bool, is_step: bool, is_dictionary_verb: Callable[[str], bool]
) -> list[Form]:
    """Find the verb of each clause that its wording tells.

    Args:
        lower: words of one or more sentences, lower case.
        is_told: whether they begin with who is told to move ("make | him jump").
        is_step: whether they are one of several steps, so that a verb in the third person may stand alone.
        is_dictionary_verb: tells whether a word is the base form of any English verb.
    """
    forms = _finite_verbs(lower)
    bounds = sorted({0, len(lower), *(index + 1 for index, word in enumerate(lower) if word in _ENDS)})
    for start, end in pairwise(bounds):
        sentence = lower[start:end]
        found = forms[start:end]
        mood = _find_in_sentence(sentence, found, is_told, is_step, is_dictionary_verb)
        _find_run_on_verbs(sentence, found, mood)
        if all(form is Form.NONE for form in found):
            _find_states(sentence, found)
        forms[start:end] = found
    return forms


def _find_in_sentence(
    lower: Sequence[str], forms: list[Form], is_told: bool, is_step: bool, is_dictionary_verb: Callable[[str], bool]
) -> Form:
    """Set the forms of one sentence's clause verbs: orders, titles and subjects with a verb; returns its mood."""
    mood = Form.NONE
    for number, index in enumerate(_openings(lower)):
        if forms[index] is not Form.NONE:
            mood = Form.THIRD if mood is Form.NONE else mood
            continue
        is_first = number == 0
        if (is_first or mood is Form.BASE) and _is_order(lower[index], _word(lower, index + 1), is_dictionary_verb):
            forms[index] = mood = Form.BASE
        elif (is_first or mood is Form.PARTICIPLE) and lower[index] in lexicon.PARTICIPLES:
            mood = Form.PARTICIPLE
            if _word(lower, index - 1) in ("and", "then"):  # spaCy finds the others by itself
                forms[index] = mood
        elif (
            is_first
            and lower[index] in lexicon.FINITE_VERBS
            and (is_step or _begins_predicate(_word(lower, index + 1)))
        ):
            forms[index] = mood = Form.THIRD
        elif mood is not Form.BASE:
            verb = _verb_behind_subject(lower, index, is_first, is_told)
            if verb is not None:
                forms[verb], mood = Form.THIRD, Form.THIRD
            elif is_told and mood is Form.THIRD and lower[index] in lexicon.VERBS:
                forms[index] = Form.THIRD
    return mood


def _find_run_on_verbs(lower: Sequence[str], forms: list[Form], mood: Form) -> None:
    """Find verbs of clauses that nothing parts: "go left | go right", "walk two steps | turn", "walk | walk"."""
    verbs = {Form.BASE: lexicon.VERBS, Form.THIRD: lexicon.FINITE_VERBS}.get(mood)
    if verbs is None:
        return
    for index in range(1, len(lower)):
        word, before = lower[index], lower[index - 1]
        if forms[index] is Form.NONE and word in verbs:
            is_repeated = word == before and forms[index - 1] is mood
            is_ended = before in _CLAUSE_ENDS and _word(lower, index - 2) not in _NOUN_OPENERS
            if index > 1 and forms[index - 2] is mood and _base(lower[index - 2]) in _PARTICLE_VERBS:
                is_ended = False  # "pick up | box"
            if is_repeated or is_ended or (before in _MEASURE_ENDS and index > 1):
                forms[index] = mood


_CLAUSE_ENDS: Final = lexicon.DIRECTION_ADVERBS - {"in", "over", "out", "off", "through", "across", "along", "straight"}
_NOUN_OPENERS: Final = _DETERMINERS | lexicon.NOUN_ADJECTIVES
_PARTICLE_VERBS: Final = lexicon.TRANSFER | lexicon.TRANSITIVE
_MEASURE_ENDS: Final = frozenset("steps times meters metres seconds twice thrice".split())


def _base(word: str) -> str:
    return lexicon.FINITE_VERBS.get(word, word)


def _word(lower: Sequence[str], index: int) -> str:
    return lower[index] if 0 <= index < len(lower) else ""


def _openings(lower: Sequence[str]) -> list[int]:
    """List the words of a sentence that begin a clause, adverbs before a verb left out."""
    openings = []
    opens = True
    for index, word in enumerate(lower):
        if word in SEPARATORS or word in _CONNECTIVES:
            opens = True
        elif opens and not (word in _SKIPPED or word.endswith("ly") or not word[:1].isalnum()):
            if word in ("after", "before") and _word(lower, index + 1) in ("that", "this"):
                continue
            if word in ("that", "this") and _word(lower, index - 1) in ("after", "before"):
                continue
            openings.append(index)
            opens = False
    return openings


# Orders


def _is_order(word: str, following: str, is_dictionary_verb: Callable[[str], bool]) -> bool:
    """Tell whether a word at the beginning of a clause is a verb in base form."""
    if word in lexicon.VERBS:
        return not (word in _ADJECTIVE_VERBS and (following in _NOUN_FOLLOWERS or following in lexicon.PARTICIPLES))
    if word in _NO_VERBS or not is_dictionary_verb(word):
        return False
    ends = not following.isalpha() or following in _CONNECTIVES or following.endswith("ly")
    return ends or following in _OBJECT_FOLLOWERS


# Sentences


def _begins_predicate(following: str) -> bool:
    """Tell by the word behind a verb that begins a sentence whether it is one ("kneels down", not "two jumps")."""
    return following in _PREDICATE_FOLLOWERS or following.endswith("ly")


_PREDICATE_FOLLOWERS: Final = _OBJECT_FOLLOWERS | (_PREPOSITIONS - {"of", "with"})


def _finite_verbs(lower: Sequence[str]) -> list[Form]:
    """Find the verbs of motion in the third person that are no plural nouns, by the word before them."""
    forms: list[Form] = []
    for index, word in enumerate(lower):
        is_verb = word in lexicon.FINITE_VERBS and _opens_predicate(lower, forms, index)
        forms.append(Form.THIRD if is_verb else Form.NONE)
    return forms


def _opens_predicate(lower: Sequence[str], forms: Sequence[Form], index: int) -> bool:
    """Tell by the words before an index whether a verb may stand there; `forms` holds the decisions before it."""
    before = lower[index - 1] if index else ""
    if before in (",", "and", "or"):
        # A list of nouns continues as one: "with jumps and kicks"
        listed = lower[index - 2] if index > 1 else ""
        return listed == "steps" or not (listed in lexicon.FINITE_VERBS and forms[index - 2] is Form.NONE)
    if before in lexicon.SUBJECT_NOUNS or before in _OPENERS:
        return True
    if index > 1 and forms[index - 1] is Form.THIRD and lower[index - 2] in _RELATIVE:  # "who bows | walks"
        return True
    if before == "than" and index > 1 and lower[index - 2] == "rather":
        return True
    return before.endswith("ly") or before in ("again", "never")


def _verb_behind_subject(lower: Sequence[str], start: int, is_first: bool, is_told: bool) -> int | None:
    """Find the verb behind a subject that begins at an index: "a zombie walks", "him jump" of who is told to.

    Args:
        lower: the words of a sentence.
        start: where the subject begins.
        is_first: whether the sentence begins there; elsewhere, a noun without an article is no subject.
        is_told: whether the sentence tells who shall move.
    """
    has_article = lower[start] in _DETERMINERS
    is_pronoun = is_told and lower[start] in ("him", "her", "it", "them", "me", "us", "someone", "somebody", "everyone")
    for index in range(start, min(start + 6, len(lower))):
        word, is_subject = lower[index], index > start
        if lexicon.FINITE_VERBS.get(word) in lexicon.STATIVE:
            return None
        if word in lexicon.FINITE_VERBS and is_subject:
            is_actor = has_article and index > start + 1 and lower[index - 1] not in lexicon.NOUN_ADJECTIVES
            return index if is_actor or _may_be_actor(lower, start, index, is_first) else None
        if word in lexicon.VERBS and lower[index - 1] in lexicon.BODY_PLURALS and is_subject:  # "the arms swing"
            return index
        is_whole = lower[index - 1] not in _DETERMINERS or (is_pronoun and index == start + 1)
        if word in lexicon.VERBS and is_subject and is_told and is_whole:
            return index
        if word in _RELATIVE and index == start:
            return None
        is_part = word.isalpha() or word in ("'s", "-", "’s", "'")
        if (
            not is_part
            or (word in _PREPOSITIONS and word != "of")
            or word in lexicon.PARTICIPLES
            or word in _CONNECTIVES
        ):
            return None
    return None


def _may_be_actor(lower: Sequence[str], start: int, verb: int, is_first: bool) -> bool:
    """Tell whether a noun without an article may be who moves ("grandma walks", not "high kicks")."""
    before = lower[verb - 1]
    if before in lexicon.BODY_NOUNS:
        return True
    return is_first and verb == start + 1 and before not in _NO_ACTORS and len(before) > 2


# Phrases without a verb


def _find_states(lower: Sequence[str], forms: list[Form]) -> None:
    """Find what body parts and persons are said to be in, where no clause of a sentence has a verb."""
    if any(
        word in lexicon.EVENT_NOUNS or word in lexicon.PARTICIPLES or word in lexicon.FINITE_VERBS for word in lower
    ):
        return
    states = [_state_of(lower, start, end) for start, end in _segments(lower)]
    for index in states:
        if index is not None and None not in states:
            forms[index] = Form.STATE


def _segments(lower: Sequence[str]) -> list[tuple[int, int]]:
    """Cut a sentence at its separators, and at "and" where a phrase of its own follows."""
    segments = []
    first, end = 0, len(lower)
    for index in range(end + 1):
        is_sign = index == end or not lower[index][:1].isalnum()
        if is_sign or (lower[index] == "and" and first < index and _state_of(lower, index + 1, end) is not None):
            if any(word[:1].isalnum() for word in lower[first:index]):
                segments.append((first, index))
            first = index + 1
    return segments


def _state_of(lower: Sequence[str], start: int, end: int) -> int | None:
    """Find the word that would follow "is" in a phrase of a body part or a person; None if there is none."""
    if start < end - 1 and lower[start] in _PLACE_OPENERS:
        return start
    has_owner = False
    for index in range(start, end):
        word = lower[index]
        if has_owner and word in STATE_WORDS:
            return index
        if has_owner and word not in ("and", "of", "'s", "’s"):
            return None
        has_owner = word in lexicon.BODY_NOUNS or word in lexicon.SUBJECT_NOUNS
        if not has_owner and not (word in _PHRASE_PARTS or word in lexicon.STATE_ADJECTIVES):
            return None
    return None


_PHRASE_PARTS: Final = _DETERMINERS | _PHRASE_WORDS | {"and", "'s", "’s"}
