"""What the dependency parser reads in place of a caption's words: slips mended, mistaken words replaced.

The small spaCy model takes "waves" after "and", and "human" before a verb, for other parts of speech. It reads a word
of the same form that it knows ("goes", "person") instead; the tokens, and so all offsets, stay those of the caption.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass

from kinegraph.text import lexicon

_LETTERS = "abcdefghijklmnopqrstuvwxyz"
_SHORTEST = 4
"""Shorter words are one letter away from too many others to be mended."""

_DETERMINERS = frozenset(
    "a an the this that these those his her its their my your our some any no each every both another one two three"
    " four five six seven eight nine ten several few many more most of with without for by in on to from".split()
)
_OPENERS = frozenset("and or but then who which that he she it they also".split())
_RELATIVE = frozenset("who which that".split())
_NOUN_MARKERS = frozenset("a an degree degrees °".split())
_NOUN_ADJECTIVES = frozenset(
    "quarter half full left right sharp slight small little big quick slow deep single".split()
)
_SIDE_FOLLOWERS = frozenset(
    "and or but then while when before after by for at with in around again until over along through on during"
    " from".split()
)


@dataclass(frozen=True)
class NormalisedTokens:
    """N words of a caption as they are read."""

    words: tuple[str, ...]
    """Spelling slips mended; what the rules and the features see."""
    surrogates: tuple[str, ...]
    """What the dependency parser sees."""
    lemmas: tuple[str | None, ...]
    """Base forms of verbs that a stand-in replaced."""


def normalise_tokens(
    words: Sequence[str], known: Callable[[str], bool], verbs_at: Collection[int] = ()
) -> NormalisedTokens:
    """Mend slips and choose stand-ins.

    Args:
        words: the caption's tokens.
        known: whether a word in lower case is an English word.
        verbs_at: places of forms of verbs that are known to be verbs, all others being judged by their neighbours.
    """
    mended = tuple(correct_spelling(word, known) for word in words)
    lower = [word.lower() for word in mended]
    verbs = [place in verbs_at or verb for place, verb in enumerate(finite_verbs(lower))]
    surrogates = list(mended)
    lemmas: list[str | None] = [None] * len(lower)
    for place, word in enumerate(lower):
        following = lower[place + 1] if place + 1 < len(lower) else ""
        if verbs[place]:
            surrogates[place] = "goes" if _is_intransitive(following) else "takes"
            lemmas[place] = lexicon.FINITE_VERBS[word]
        elif word in ("counter", "anti") and following == "clockwise" and _ends_phrase(lower, place + 2):
            surrogates[place] = "very"
        elif word == "that" and place and lower[place - 1] == "after" and _verb_at(verbs, place + 1):
            surrogates[place - 1 : place + 1] = ["very", "soon"]
        elif word == "°":
            surrogates[place] = "degree"
        elif word in lexicon.EVENT_NOUNS and _is_noun(lower, place):
            surrogates[place], lemmas[place] = "movement", word
        elif word in lexicon.ROTATIONS and _ends_phrase(lower, place + 1):
            surrogates[place] = "slowly"
        elif word in lexicon.PERSON_NOUNS and following not in lexicon.BODY_NOUNS:
            surrogates[place] = "person"
        elif word in ("left", "right") and _is_direction(lower, place):
            surrogates[place] = "away"
        elif word == "," and (_verb_at(verbs, place + 1) or (following == "then" and _verb_at(verbs, place + 2))):
            surrogates[place] = "and"
    return NormalisedTokens(mended, tuple(surrogates), tuple(lemmas))


_FOLLOWS_INTRANSITIVE = (
    _SIDE_FOLLOWERS
    | lexicon.DIRECTION_ADVERBS
    | lexicon.DIRECTION_PREPOSITIONS
    | lexicon.PLACE_PREPOSITIONS
    | lexicon.TIME_PREPOSITIONS
    | lexicon.MANNER_PREPOSITIONS
    | lexicon.TIME_ADVERBS
    | lexicon.MANNER_ADVERBS
    | frozenset("of not that who which as very really almost about".split())
)


def _is_intransitive(following: str) -> bool:
    """Whether a verb before this word has no object, as far as one word can tell."""
    ends = not following.isalpha() or following in _FOLLOWS_INTRANSITIVE or following in lexicon.FINITE_VERBS
    return ends or following.endswith("ly")


def _verb_at(verbs: Sequence[bool], place: int) -> bool:
    return place < len(verbs) and verbs[place]


def finite_verbs(lower: Sequence[str]) -> list[bool]:
    """Which words are verbs of motion in the third person, and not plurals of the noun that is spelt alike."""
    found: list[bool] = []
    for place, word in enumerate(lower):
        found.append(word in lexicon.FINITE_VERBS and _opens_predicate(lower, found, place))
    return found


def _opens_predicate(lower: Sequence[str], found: Sequence[bool], place: int) -> bool:
    before = lower[place - 1] if place else ""
    if before in (",", "and", "or"):
        # a list of nouns goes on as one: "with jumps and kicks"
        listed = lower[place - 2] if place > 1 else ""
        return not (listed in lexicon.FINITE_VERBS and not found[place - 2])
    if before in lexicon.SUBJECT_NOUNS or before in _OPENERS:
        return True
    if place > 1 and found[place - 1] and lower[place - 2] in _RELATIVE:  # "who bows | walks"
        return True
    return before.endswith("ly") or before in ("again", "never")


def _is_noun(lower: Sequence[str], place: int) -> bool:
    """Behind an article or a measure, an adjective of captions between them allowed ("a quarter turn")."""
    before = lower[max(place - 2, 0) : place]
    return bool(before) and (
        before[-1] in _NOUN_MARKERS or (before[0] in ("a", "an", "one", "two") and before[-1] in _NOUN_ADJECTIVES)
    )


def _is_direction(lower: Sequence[str], place: int) -> bool:
    before = lower[place - 1] if place else ""
    return before.isalpha() and before not in _DETERMINERS and _ends_phrase(lower, place + 1)


def _ends_phrase(lower: Sequence[str], place: int) -> bool:
    """Whether the word at a place is no noun that an adjective before it could belong to."""
    following = lower[place] if place < len(lower) else ""
    return not following.isalpha() or following in _SIDE_FOLLOWERS or following.endswith("ly")


def correct_spelling(word: str, known: Callable[[str], bool]) -> str:
    """A word of the lexicon one slip away (letters swapped, left out, put in or changed), or the word itself."""
    lower = word.lower()
    if len(word) < _SHORTEST or not lower.isascii() or not lower.isalpha() or lower in lexicon.VOCABULARY:
        return word
    if lower in lexicon.CONFUSED:
        return lexicon.CONFUSED[lower]
    if known(lower):
        return word
    for slips in (_swapped, _missing, _extra, _changed):
        found = sorted(lexicon.VOCABULARY.intersection(slips(lower)))
        if found:
            return found[0].capitalize() if word[0].isupper() else found[0]
    return word


def _swapped(word: str) -> Iterator[str]:
    return (word[:i] + word[i + 1] + word[i] + word[i + 2 :] for i in range(len(word) - 1))


def _missing(word: str) -> Iterator[str]:
    return (word[:i] + letter + word[i:] for i in range(len(word) + 1) for letter in _LETTERS)


def _extra(word: str) -> Iterator[str]:
    return (word[:i] + word[i + 1 :] for i in range(len(word)))


def _changed(word: str) -> Iterator[str]:
    return (word[:i] + letter + word[i + 1 :] for i in range(len(word)) for letter in _LETTERS)
