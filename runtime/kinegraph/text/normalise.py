"""Token normalisation: correct spelling slips and choose the surrogates that the dependency parser reads.

The small spaCy model mistags common words of motion captions, such as "waves" after "and" or "human" before a verb.
It gets a surrogate instead, a word of the same form that it knows ("goes", "person"). Tokens stay those of the caption,
and so do all offsets.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, zip_longest

from kinegraph.text import lexicon
from kinegraph.text.caption_tokens import CaptionToken
from kinegraph.text.clauses import ORDINALS, SEPARATORS, Form, find_clause_verbs

_LETTERS = "abcdefghijklmnopqrstuvwxyz"
_MIN_CORRECTED_LENGTH = 4
"""Shorter words are one edit away from too many others to be corrected."""

_DETERMINERS = frozenset(
    "a an the this that these those his her its their my your our some any no each every both another one two three"
    " four five six seven eight nine ten several few many more most of with without for by in on to from".split()
)
_NOUN_MARKERS = frozenset("a an degree degrees °".split())
_EVENT_ADJECTIVES = frozenset(
    "quarter half full left right sharp slight small little big quick slow deep single".split()
)
_SIDE_FOLLOWERS = frozenset(
    "and or but then while when before after by for at with in around again until over along through on during"
    " from".split()
)
_VERB_SIDE_FOLLOWERS = (
    lexicon.DIRECTION_PREPOSITIONS
    | lexicon.TIME_PREPOSITIONS
    | lexicon.MANNER_PREPOSITIONS
    | lexicon.TIME_ADVERBS
    | frozenset("a an one two three four five six seven eight nine ten some once twice thrice because instead".split())
)
"""Words behind "left" and "right" that make them adverbs where a verb stands before ("turns left without ...")."""
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
_TAKES_PLACE = frozenset("on in at above over under behind below beside between against near inside around to".split())
"""Words that would follow "is" and name a place with the words behind them ("hands | on the hips")."""


@dataclass(frozen=True)
class Dictionary:
    """Lookups in a dictionary of English, by lower-case word."""

    is_known: Callable[[str], bool]
    """Tells whether a word is in the dictionary, in any form."""
    is_verb: Callable[[str], bool]
    """Tells whether a word is the base form of a verb."""


@dataclass(frozen=True)
class NormalisedTokens:
    """N tokens of a caption after normalisation."""

    words: tuple[str, ...]
    """Words with corrected spelling: what the rules and the features see."""
    surrogates: tuple[str, ...]
    """Words that the dependency parser reads in their place."""
    lemmas: tuple[str | None, ...]
    """Base forms of the words that a surrogate of another verb or noun replaces, else None."""
    states: frozenset[int]
    """Indices of the words that would follow "is" in phrases without a verb."""
    clause_verbs: frozenset[int]
    """Indices of the verbs that their place tells, one clause each."""
    begins_sentence: tuple[bool, ...]
    """Whether a sentence begins at a token; False leaves it to the dependency parser."""


def normalise_tokens(
    tokens: Sequence[CaptionToken], dictionary: Dictionary, verbs_at: Collection[int] = ()
) -> NormalisedTokens:
    """Correct spelling slips and choose a surrogate for each token.

    Args:
        tokens: the caption's N tokens.
        dictionary: English words.
        verbs_at: indices of tokens that are known to be finite verbs; the others are judged by their neighbours.
    """
    words = tuple(
        _corrected(token.text, following.text if following else "", dictionary.is_known)
        for token, following in zip_longest(tokens, tokens[1:])
    )
    lower = [word.lower() for word in words]
    surrogates = _lower_case(words)
    lemmas: list[str | None] = []
    forms: list[Form] = []
    begins = [False] * len(tokens)
    for start, end in _sentences(tokens, lower, dictionary):
        sentence = _Sentence(lower[start:end], surrogates[start:end], [None] * (end - start), [])
        sentence.forms = find_clause_verbs(
            sentence.lower, tokens[start].is_told, start > 0 or end < len(tokens), dictionary.is_verb
        )
        for index in verbs_at:
            if start <= index < end:
                sentence.forms[index - start] = Form.THIRD
        sentence.choose_surrogates(tokens[start].is_told)
        surrogates[start:end] = sentence.surrogates
        lemmas += sentence.lemmas
        forms += sentence.forms
        begins[start] = start > 0
    states = frozenset(index for index, form in enumerate(forms) if form is Form.STATE)
    clause_verbs = frozenset(index for index, form in enumerate(forms) if form in _CLAUSE_FORMS)
    for index in clause_verbs - {0}:
        begins[index] = begins[index] or lower[index - 1] in _RUN_ON or index - 1 in clause_verbs
    return NormalisedTokens(words, tuple(surrogates), tuple(lemmas), states, clause_verbs, tuple(begins))


def _sentences(tokens: Sequence[CaptionToken], lower: Sequence[str], dictionary: Dictionary) -> list[tuple[int, int]]:
    """Cut a caption where a step begins, and where a line begins with the verb of a clause."""
    starts = {0, len(tokens)}
    for index, token in enumerate(tokens):
        if token.begins_step:
            starts.add(index)
        elif token.begins_line:
            line = lower[index : index + 8]
            if any(form is not Form.NONE for form in find_clause_verbs(line, False, True, dictionary.is_verb)[:1]):
                starts.add(index)
    return list(pairwise(sorted(starts)))


_CLAUSE_FORMS = frozenset((Form.BASE, Form.THIRD, Form.PARTICIPLE))


def _lower_case(words: Sequence[str]) -> list[str]:
    """Write words in capitals in lower case, all words if most begin with a capital."""
    written = [word for word in words if word[:1].isalpha()]
    is_title = len(written) > 1 and 2 * sum(word[0].isupper() for word in written) > len(written)
    return [
        word.lower() if word[1:] != word[1:].lower() or (is_title and index) else word
        for index, word in enumerate(words)
    ]


@dataclass
class _Sentence:
    """Words of one step while their surrogates are chosen."""

    lower: list[str]
    surrogates: list[str]
    lemmas: list[str | None]
    forms: list[Form]

    def choose_surrogates(self, is_told: bool) -> None:
        """Choose what the dependency parser reads for each word; `is_told`: it begins with who is told to move."""
        for index, form in enumerate(self.forms):
            if form is not Form.NONE:
                self.surrogates[index], self.lemmas[index] = _verb_surrogate(self.lower, index, form)
            elif not (self._replace_noun(index) or self._replace_adverb(index)):
                self._replace_sign(index)
        if is_told and self._is_verb(1):
            self.surrogates[0] = _SUBJECT_PRONOUNS.get(self.lower[0], self.surrogates[0])

    def _word(self, index: int) -> str:
        return self.lower[index] if 0 <= index < len(self.lower) else ""

    def _is_verb(self, index: int) -> bool:
        return index < len(self.forms) and self.forms[index] is not Form.NONE

    def _replace_noun(self, index: int) -> bool:
        """Replace a noun of motion, a participle behind "no", or who moves; tells whether it was one."""
        word, following = self.lower[index], self._word(index + 1)
        if word in lexicon.EVENT_NOUNS and (_is_noun(self.lower, index) or self._is_title(index)):
            self.surrogates[index], self.lemmas[index] = "movement", word
        elif word in lexicon.PARTICIPLES and self._is_continuous(index):
            self.surrogates[index], self.lemmas[index] = _verb_surrogate(self.lower, index, Form.PARTICIPLE)
        elif word in lexicon.PARTICIPLES and self._word(index - 1) == "no" and self._word(index - 2) != "with":
            self.surrogates[index - 1] = "not"
            self.surrogates[index], self.lemmas[index] = _verb_surrogate(self.lower, index, Form.PARTICIPLE)
        elif self._is_actor(index) or (word in lexicon.PERSON_NOUNS and following not in lexicon.BODY_NOUNS):
            self.surrogates[index] = "person"
        else:
            return False
        return True

    def _is_continuous(self, index: int) -> bool:
        """Tell whether a participle follows "is", or a verb that ends it ("stops waving")."""
        before = index - 1
        while before > 0 and (self.lower[before].endswith("ly") or self.lower[before] in ("not", "n't", "then", "now")):
            before -= 1
        word = self._word(before)
        base = lexicon.FINITE_VERBS.get(word, word)
        return word in _BE or (base in lexicon.ENDING and self.forms[before] is not Form.NONE)

    def _is_actor(self, index: int) -> bool:
        """Tell whether a word is an unusual one for who moves, in a title with a participle ("a zombie walking")."""
        is_noun = index == 1 and self.lower[0] in ("a", "an", "the") and self._word(2) in lexicon.PARTICIPLES
        return is_noun and self.lower[1] not in _NO_ACTORS and self._word(3) not in lexicon.SUBJECT_NOUNS

    def _is_title(self, index: int) -> bool:
        """Tell whether a word is the second of a title without a verb, behind an adjective ("slow jog")."""
        is_modified = index == 1 and (self.lower[0] in lexicon.NOUN_ADJECTIVES or self.lower[0] in ("left", "right"))
        return is_modified and Form.BASE not in self.forms

    def _replace_adverb(self, index: int) -> bool:
        """Replace an adverb that taggers take for a noun; tells whether it was one."""
        word = self.lower[index]
        if word == "that" and self._word(index - 1) == "after" and self._is_verb(index + 1):
            self.surrogates[index - 1 : index + 1] = ["very", "soon"]
        elif word in lexicon.ROTATIONS and _ends_phrase(self.lower, index + 1):
            self.surrogates[index] = "slowly"
        elif word in ("left", "right") and self._is_side_of_noun(index):
            self.surrogates[index] = "other"
        elif word in ("left", "right") and (self._is_verb(index + 1) or _is_direction(self.lower, index)):
            self.surrogates[index] = "away"
        elif word in ORDINALS and self._is_verb(index + 2 if self._word(index + 1) in SEPARATORS else index + 1):
            self.surrogates[index] = "then"
        else:
            return False
        return True

    def _is_side_of_noun(self, index: int) -> bool:
        """Tell whether "left" or "right" begins a phrase without a verb ("left hand up", "left turn")."""
        is_part = Form.STATE in self.forms and self._word(index + 1) in lexicon.BODY_NOUNS
        return is_part or (index == 0 and self._word(1) in lexicon.EVENT_NOUNS)

    def _replace_sign(self, index: int) -> None:
        """Replace a sign before the verb of a clause by "and"."""
        word = self.lower[index]
        if word == "°":
            self.surrogates[index] = "degree"
        elif word in SEPARATORS and self._word(index - 1) not in _SEQUENCE:
            is_before_then = self._word(index + 1) == "then" and self._is_verb(index + 2)
            self.surrogates[index] = "and" if is_before_then or self._is_verb(index + 1) else self.surrogates[index]


_NO_ACTORS = lexicon.EVENT_NOUNS | lexicon.NOUN_ADJECTIVES | lexicon.BODY_NOUNS | lexicon.DIRECTION_ADVERBS
_BE = frozenset("is are was were am 's 're".split())
_SEQUENCE = ORDINALS | {"first", "then", "next", "finally"}
_RUN_ON = frozenset(lexicon.DIRECTION_ADVERBS | {"steps", "times", "meters", "metres", "seconds", "twice", "thrice"})
"""Words behind which the verb of a clause begins a sentence, because nothing else parts the clauses."""


def _verb_surrogate(lower: Sequence[str], index: int, form: Form) -> tuple[str, str]:
    """Choose a verb of the same form that the parser knows, without or with an object; also the base form."""
    word, following = lower[index], lower[index + 1] if index + 1 < len(lower) else ""
    base = lexicon.FINITE_VERBS.get(word) or lexicon.PARTICIPLES.get(word, word)
    lacks_object = _lacks_object(following) and not _has_object_behind(lower, index, base)
    if form is Form.STATE:
        return ("goes" if lacks_object or word not in _TAKES_PLACE else "takes"), word
    if following in lexicon.PARTICIPLES:
        if base in lexicon.CATENATIVE and (form is Form.BASE or base in lexicon.ENDING):
            return ("start" if form is Form.BASE else "stops"), base
        lacks_object = base not in lexicon.CATENATIVE and _is_clause_of_verb(lower, index + 1)
    verbs = {Form.THIRD: ("goes", "takes"), Form.PARTICIPLE: ("going", "taking"), Form.BASE: ("go", "take")}[form]
    return verbs[0 if lacks_object else 1], base


_SUBJECT_PRONOUNS = {"him": "he", "her": "she", "them": "they", "me": "I", "us": "we"}
_PARTICLES = frozenset("up down off out over away back on".split())
_OBJECT_OPENERS = frozenset("a an the his her their my your its it them both one two something".split())


def _is_clause_of_verb(lower: Sequence[str], index: int) -> bool:
    """Tell whether a participle is a verb with a phrase of its own ("swinging | the arms", not "swiping gestures")."""
    following = lower[index + 1] if index + 1 < len(lower) else ""
    return following in _OBJECT_OPENERS or (_lacks_object(following) and following not in lexicon.FINITE_VERBS)


_MOVING_VERBS = lexicon.TRANSFER | lexicon.TRANSITIVE


def _has_object_behind(lower: Sequence[str], index: int, base: str) -> bool:
    """Tell whether a verb has an object behind a particle or a side ("picks up | a ball", "raise | left arm")."""
    following = lower[index + 1 : index + 3]
    if len(following) < 2 or base not in _MOVING_VERBS:
        return False
    is_part = following[0] in ("left", "right") and following[1] in lexicon.BODY_NOUNS
    return is_part or (following[0] in _PARTICLES and not _lacks_object(following[1]))


def _lacks_object(following: str) -> bool:
    """Tell by the word after a verb whether the verb has no object."""
    ends = not following.isalpha() or following in _INTRANSITIVE_FOLLOWERS or following in lexicon.FINITE_VERBS
    return ends or following.endswith("ly")


def _is_noun(lower: Sequence[str], index: int) -> bool:
    """Tell whether a word follows an article or a measure, perhaps with an adjective between ("a quarter turn")."""
    before = lower[max(index - 2, 0) : index]
    return bool(before) and (
        before[-1] in _NOUN_MARKERS or (before[0] in ("a", "an", "one", "two") and before[-1] in _EVENT_ADJECTIVES)
    )


def _is_direction(lower: Sequence[str], index: int) -> bool:
    """Tell whether "left" or "right" at an index is an adverb, not an adjective, a noun, or the past of "leave"."""
    before = lower[index - 1] if index else ""
    if not before.isalpha() or before in _DETERMINERS:
        return False
    following = lower[index + 1] if index + 1 < len(lower) else ""
    return _ends_phrase(lower, index + 1) or (following in _VERB_SIDE_FOLLOWERS and _is_behind_verb(lower, index))


def _is_behind_verb(lower: Sequence[str], index: int) -> bool:
    """Tell whether a verb of motion stands before an index, with nothing but adverbs in -ly between."""
    before = index - 1
    while before > 0 and lower[before].endswith("ly"):
        before -= 1
    word = lower[before]
    is_past = word.endswith("ed") or word in lexicon.IRREGULAR_FORMS
    return is_past or word in lexicon.VERBS or word in lexicon.FINITE_VERBS or word in lexicon.PARTICIPLES


def _ends_phrase(lower: Sequence[str], index: int) -> bool:
    """Tell whether the word at an index cannot be a noun that an adjective before it modifies."""
    following = lower[index] if index < len(lower) else ""
    return not following.isalpha() or following in _SIDE_FOLLOWERS or following.endswith("ly")


def _corrected(word: str, following: str, is_known: Callable[[str], bool]) -> str:
    """Correct a slip, but make no verb of who moves: "Kate walks" is no "Skate walks"."""
    corrected = correct_spelling(word, is_known)
    is_verb = corrected.lower() in lexicon.VERBS or corrected.lower() in lexicon.FINITE_VERBS
    return word if is_verb and following.lower() in lexicon.FINITE_VERBS else corrected


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
    doubled = lower[:-3] + lower[-4] + "ing"
    if lower.endswith("ing") and doubled in lexicon.PARTICIPLES:  # "stoping", though a dictionary may have it
        return doubled
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
