"""Token normalisation: correct spelling slips and choose the surrogates that the dependency parser reads.

The small spaCy model mistags common words of motion captions, such as "waves" after "and" or "human" before a verb.
It gets a surrogate instead, a word of the same form that it knows ("goes", "person"). Tokens stay those of the caption,
and so do all offsets.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass

from kinegraph.text import lexicon

_LETTERS = "abcdefghijklmnopqrstuvwxyz"
_MIN_CORRECTED_LENGTH = 4
"""Shorter words are one edit away from too many others to be corrected."""

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
_INTRANSITIVE_FOLLOWERS = (
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
"""Words that do not begin the object of the verb before them."""


@dataclass(frozen=True)
class NormalisedTokens:
    """N tokens of a caption after normalisation."""

    words: tuple[str, ...]
    """Words with corrected spelling: what the rules and the features see."""
    surrogates: tuple[str, ...]
    """Words that the dependency parser reads in their place."""
    lemmas: tuple[str | None, ...]
    """Base forms of the words that a surrogate of another verb or noun replaces, else None."""


def normalise_tokens(
    words: Sequence[str], is_known: Callable[[str], bool], verbs_at: Collection[int] = ()
) -> NormalisedTokens:
    """Correct spelling slips and choose a surrogate for each token.

    Args:
        words: the caption's N tokens.
        is_known: tells whether a lower-case word is an English word.
        verbs_at: indices of tokens that are known to be finite verbs; the others are judged by their neighbours.
    """
    corrected = tuple(correct_spelling(word, is_known) for word in words)
    lower = [word.lower() for word in corrected]
    verbs = [index in verbs_at or is_verb for index, is_verb in enumerate(finite_verbs(lower))]
    surrogates = list(corrected)
    lemmas: list[str | None] = [None] * len(lower)
    for index, word in enumerate(lower):
        following = lower[index + 1] if index + 1 < len(lower) else ""
        if verbs[index]:
            surrogates[index] = "goes" if _lacks_object(following) else "takes"
            lemmas[index] = lexicon.FINITE_VERBS[word]
        elif word in ("counter", "anti") and following == "clockwise" and _ends_phrase(lower, index + 2):
            surrogates[index] = "very"
        elif word == "that" and index and lower[index - 1] == "after" and _is_verb_at(verbs, index + 1):
            surrogates[index - 1 : index + 1] = ["very", "soon"]
        elif word == "°":
            surrogates[index] = "degree"
        elif word in lexicon.EVENT_NOUNS and _is_noun(lower, index):
            surrogates[index], lemmas[index] = "movement", word
        elif word in lexicon.ROTATIONS and _ends_phrase(lower, index + 1):
            surrogates[index] = "slowly"
        elif word in lexicon.PERSON_NOUNS and following not in lexicon.BODY_NOUNS:
            surrogates[index] = "person"
        elif word in ("left", "right") and _is_direction(lower, index):
            surrogates[index] = "away"
        elif word == "," and (_is_verb_at(verbs, index + 1) or (following == "then" and _is_verb_at(verbs, index + 2))):
            surrogates[index] = "and"
    return NormalisedTokens(corrected, tuple(surrogates), tuple(lemmas))


def finite_verbs(lower: Sequence[str]) -> list[bool]:
    """Tell for each lower-case word whether it is a verb of motion in the third person, not a plural noun."""
    verbs: list[bool] = []
    for index, word in enumerate(lower):
        verbs.append(word in lexicon.FINITE_VERBS and _opens_predicate(lower, verbs, index))
    return verbs


def _opens_predicate(lower: Sequence[str], verbs: Sequence[bool], index: int) -> bool:
    """Tell by the words before an index whether a verb may stand there; `verbs` holds the decisions before it."""
    before = lower[index - 1] if index else ""
    if before in (",", "and", "or"):
        # A list of nouns continues as one: "with jumps and kicks"
        listed = lower[index - 2] if index > 1 else ""
        return not (listed in lexicon.FINITE_VERBS and not verbs[index - 2])
    if before in lexicon.SUBJECT_NOUNS or before in _OPENERS:
        return True
    if index > 1 and verbs[index - 1] and lower[index - 2] in _RELATIVE:  # "who bows | walks"
        return True
    return before.endswith("ly") or before in ("again", "never")


def _is_verb_at(verbs: Sequence[bool], index: int) -> bool:
    return index < len(verbs) and verbs[index]


def _lacks_object(following: str) -> bool:
    """Tell by the word after a verb whether the verb has no object."""
    ends = not following.isalpha() or following in _INTRANSITIVE_FOLLOWERS or following in lexicon.FINITE_VERBS
    return ends or following.endswith("ly")


def _is_noun(lower: Sequence[str], index: int) -> bool:
    """Tell whether a word follows an article or a measure, perhaps with an adjective between ("a quarter turn")."""
    before = lower[max(index - 2, 0) : index]
    return bool(before) and (
        before[-1] in _NOUN_MARKERS or (before[0] in ("a", "an", "one", "two") and before[-1] in _NOUN_ADJECTIVES)
    )


def _is_direction(lower: Sequence[str], index: int) -> bool:
    """Tell whether "left" or "right" at an index is an adverb, not an adjective or a noun."""
    before = lower[index - 1] if index else ""
    return before.isalpha() and before not in _DETERMINERS and _ends_phrase(lower, index + 1)


def _ends_phrase(lower: Sequence[str], index: int) -> bool:
    """Tell whether the word at an index cannot be a noun that an adjective before it modifies."""
    following = lower[index] if index < len(lower) else ""
    return not following.isalpha() or following in _SIDE_FOLLOWERS or following.endswith("ly")


def correct_spelling(word: str, is_known: Callable[[str], bool]) -> str:
    """Replace an unknown word by a word of the lexicon at edit distance 1, if there is one.

    Edits are tried in the order transposition, insertion, deletion, substitution; within one kind the first match in
    alphabetical order counts.
    """
    lower = word.lower()
    if len(word) < _MIN_CORRECTED_LENGTH or not lower.isascii() or not lower.isalpha() or lower in lexicon.VOCABULARY:
        return word
    if lower in lexicon.CONFUSED:
        return lexicon.CONFUSED[lower]
    if is_known(lower):
        return word
    for edits in (_transpositions, _insertions, _deletions, _substitutions):
        matches = sorted(lexicon.VOCABULARY.intersection(edits(lower)))
        if matches:
            return matches[0].capitalize() if word[0].isupper() else matches[0]
    return word


def _transpositions(word: str) -> Iterator[str]:
    return (word[:i] + word[i + 1] + word[i] + word[i + 2 :] for i in range(len(word) - 1))


def _insertions(word: str) -> Iterator[str]:
    return (word[:i] + letter + word[i:] for i in range(len(word) + 1) for letter in _LETTERS)


def _deletions(word: str) -> Iterator[str]:
    return (word[:i] + word[i + 1 :] for i in range(len(word)))


def _substitutions(word: str) -> Iterator[str]:
    return (word[:i] + letter + word[i + 1 :] for i in range(len(word)) for letter in _LETTERS)
