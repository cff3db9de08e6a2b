"""Words of a caption for comparison with the training captions: tokens, stems, clauses and verb combinations.

No model runs here and no part of speech is known, so that a graph that the caller brings can be read as well: its
actions say which words are verbs. The export stores stems and combinations of the training captions by these functions,
so a change here needs a new `vocabulary.npz`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from kinegraph.graph import SemanticGraph
from kinegraph.text import lexicon

_WORD: Final = re.compile(r"[^\W_]+(?:['’-][^\W_]+)*")
_BREAK: Final = re.compile(r"[,.;:!?&/+()]|\s[-–—]\s|\n")

CONNECTIVES: Final = frozenset("and then while before after but or until as when without".split())
"""Words that may begin a clause."""

PERSONS: Final = lexicon.SUBJECT_NOUNS - frozenset("people dancer player actor athlete".split()) | frozenset(
    "he she it they him her them me you i we who anyone anybody everyone gentleman male female human".split()
)
"""Words for the one person who moves."""
PERSON_PLURALS: Final = frozenset(
    "people persons men women humans figures characters individuals children kids boys girls guys ladies adults"
    " players dancers actors athletes subjects couples pairs groups crowds couple pair group crowd".split()
)

_ARTICLES: Final = frozenset("a an the this that these those another one".split())
_POSSESSIVES: Final = frozenset("his her their its my your our one's".split())
_QUANTIFIERS: Final = frozenset(
    "all both some any each every no more most much many few little less lot bit several enough whole".split()
)
_NUMBERS: Final = frozenset(
    "one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen seventeen "
    "eighteen nineteen twenty thirty forty fifty sixty hundred half once twice thrice dozen".split()
)
_AUXILIARIES: Final = frozenset(
    "is are was were be been being am do does did done has have had having can could will would shall should may might"
    " must gonna".split()
)
_NEGATIONS: Final = frozenset("not no never without nor neither except instead n't".split())
_PRONOUNS: Final = frozenset(
    "he she it they him her them me you i we us himself herself itself themselves who which what where there"
    " here".split()
)
_PREPOSITIONS: Final = frozenset("of to in on at with by for from as like than".split())
_DISCOURSE: Final = frozenset(
    "and or but then while before after until when if so because also too just only even still again first second third"
    " last next finally eventually later afterwards afterward meanwhile now immediately please kindly maybe very really"
    " quite rather pretty almost about roughly nearly exactly approximately same time times such".split()
)
REQUESTS: Final = frozenset(
    "make makes made let let's want wants need needs show see give create generate animate animation clip motion"
    " movement video someone's start starts starting begin begins beginning continue continues continuing keep keeps"
    " keeping seconds second minute minutes sec secs s".split()
)
FUNCTION: Final = (
    _ARTICLES | _POSSESSIVES | _QUANTIFIERS | _NUMBERS | _AUXILIARIES | _NEGATIONS | _PRONOUNS | _PREPOSITIONS
    | _DISCOURSE | REQUESTS | PERSONS | lexicon.ROTATIONS
)  # fmt: skip
"""Words that every bundle takes: they name no motion by themselves, or the parser gives them their meaning."""

CONTRACTION: Final = re.compile(r"(?:n't|'(?:s|re|m|ve|ll|d))$")
"""What is written together with the word before it: "doesn't", "he's"."""

STOPS: Final = frozenset("stop stops stopping stopped avoid avoids avoiding".split())
"""Verbs that negate the participle after them ("stops waving")."""

_IRREGULAR: Final = {
    "ran": "run", "went": "go", "gone": "go", "going": "go", "goes": "go", "held": "hold", "brought": "bring",
    "took": "take", "taken": "take", "said": "say", "gave": "give", "given": "give", "bent": "bend", "swung": "swing",
    "led": "lead", "caught": "catch", "got": "get", "kept": "keep", "came": "come", "crept": "creep", "slid": "slide",
    "drew": "draw", "shook": "shake", "swam": "swim", "strode": "stride", "leapt": "leap", "threw": "throw",
    "thrown": "throw", "shown": "show", "feet": "foot", "knelt": "kneel",
    "sat": "sit", "stood": "stand", "fell": "fall", "fallen": "fall", "rose": "rise", "risen": "rise", "leant": "lean",
    "spun": "spin", "faster": "fast", "fastest": "fast", "slower": "slow", "quicker": "quick", "higher": "high",
    "older": "old", "younger": "young", "happier": "happy", "angrier": "angry", "sadder": "sad", "prouder": "proud",
}  # fmt: skip
_SIBILANT: Final = ("sses", "shes", "ches", "xes", "zes")
_VOWEL: Final = re.compile("[aeiouy]")


@dataclass(frozen=True)
class Word:
    """A word of a caption."""

    text: str
    """Lower case, with straight apostrophes."""
    start: int
    end: int
    """Characters of the caption, end exclusive."""
    opens: bool
    """True if punctuation stands before it, or it begins the caption."""


def split_words(caption: str) -> list[Word]:
    """Split a caption into words of letters and digits; hyphens and apostrophes inside a word belong to it."""
    words: list[Word] = []
    end = 0
    for match in _WORD.finditer(caption):
        opens = not words or _BREAK.search(caption, end, match.start()) is not None
        words.append(Word(match.group().lower().replace("’", "'"), match.start(), match.end(), opens))
        end = match.end()
    return words


def stem(word: str) -> str:
    """Cut the inflection off a lower-case word: "raises", "raising" and "raise" are "rais".

    Plural and possessive, third person, participles and adverbs of manner; no part of speech is looked at.
    """
    word = word.removesuffix("'s")
    if word in _IRREGULAR:
        word = _IRREGULAR[word]
    if word.endswith("ies") and len(word) > 4:
        word = word[:-3] + "y"
    elif word.endswith(_SIBILANT):
        word = word[:-2]
    elif word.endswith("s") and not word.endswith(("ss", "us", "is")) and len(word) > 3:
        word = word[:-1]
    word = _cut_participle(word)
    if word.endswith("ically"):
        word = word[:-4]
    elif word.endswith("ly") and len(word) > 4:
        word = _cut_participle(word[:-2])
    if word.endswith("e") and len(word) > 3:
        return word[:-1]
    return word[:-1] + "i" if word.endswith("y") and len(word) > 2 else word


def _cut_participle(word: str) -> str:
    for suffix in ("ing", "ed"):
        rest = word.removesuffix(suffix)
        if rest != word and len(rest) > 2 and _VOWEL.search(rest) and not word.endswith("eed"):
            return rest[:-1] if rest[-1] == rest[-2] and rest[-1] not in "lsz" else rest
    return word


LIGHT_VERBS: Final = frozenset(
    map(stem, "take make do does perform have give go get start begin continue keep".split())
)
"""Stems of verbs that leave the motion to another word: "takes a stroll"."""


def split_clauses(words: Sequence[Word], graph: SemanticGraph) -> list[range]:
    """Group the words of a caption by clauses: each but the first begins at a connective and holds an action.

    A part between two connectives without an action, such as the second noun of a pair, belongs to the clause before.
    """
    starts = {action.start for action in graph.actions}
    has_action = [word.start in starts for word in words]
    parts: list[range] = []
    begin = 0
    for index in range(1, len(words) + 1):
        if index == len(words) or words[index].opens or _is_connective(words, index):
            parts.append(range(begin, index))
            begin = index
    clauses: list[range] = []
    for part in parts:
        previous_acts = clauses and any(has_action[i] for i in clauses[-1])
        if clauses and not (any(has_action[i] for i in part) and previous_acts):
            clauses[-1] = range(clauses[-1].start, part.stop)
        else:
            clauses.append(part)
    return clauses


def _is_connective(words: Sequence[Word], index: int) -> bool:
    return words[index].text in CONNECTIVES and words[index - 1].text not in CONNECTIVES


@dataclass(frozen=True)
class Combination:
    """A verb with what follows it."""

    key: str
    """Stems: "walk forward", "rais hand", "turn side" for "turns left"; "walk ." where nothing that counts follows."""
    first: int
    last: int
    """Words of the caption that it spans, both included."""
    has_body: bool = False
    """True where a part of the body follows the verb."""


_SIDES: Final = frozenset(("left", "right"))
_SKIPPED: Final = (FUNCTION | _SIDES | {"straight", "upper", "fast"}) - _PREPOSITIONS - CONNECTIVES - lexicon.ROTATIONS
"""Words between a verb and what says where it goes."""
PLACES: Final = (
    lexicon.DIRECTION_PREPOSITIONS | lexicon.PLACE_PREPOSITIONS | frozenset("with at of for from by".split())
)
"""Prepositions and particles."""
_WAYS: Final = (lexicon.DIRECTION_ADVERBS | PLACES | frozenset("past sideway".split())) - frozenset(
    {*lexicon.ROTATIONS, *"right left with of for from by".split()}
)
"""Words after a verb that may make another action of it ("looks up")."""


def combinations(words: Sequence[Word], graph: SemanticGraph) -> Iterator[Combination]:
    """List each verb of a caption with its direction, and with the part of the body that follows it.

    Args:
        words: of the caption.
        graph: its graph; the actions are the verbs.
    """
    starts = {action.start for action in graph.actions}
    for clause in split_clauses(words, graph):
        for index in clause:
            if words[index].start in starts:
                yield from _verb_combinations(words, index, clause)


def _verb_combinations(words: Sequence[Word], verb: int, clause: range) -> Iterator[Combination]:
    if words[verb].text in lexicon.BODY_NOUNS | PLACES:  # "hands up" has no verb
        return
    moved = any(words[index].text in lexicon.BODY_NOUNS for index in range(clause.start, verb))  # "both hands go up"
    stop = clause.stop
    key = stem(words[verb].text)
    following = verb + 1
    while following < stop and (words[following].text.endswith("ly") or words[following].text in _SKIPPED):
        following += 1
    word = words[following].text if following < stop and not words[following].opens else ""
    sides = [index for index in range(verb + 1, following) if words[index].text in _SIDES]
    if not word or word in CONNECTIVES or word in ("in", "like", "with"):
        yield Combination(f"{key} side" if sides else f"{key} .", verb, max([verb, *sides]))
    elif word in _WAYS:
        last = following  # with the side of "leans to the left"
        while last + 1 < stop and words[last + 1].text in _ARTICLES | _SIDES and not words[last + 1].opens:
            last += 1
        yield Combination(f"{key} {stem(word)}", verb, last)
    preposition = ""
    for index in range(verb + 1, stop):
        word = words[index].text
        if word in CONNECTIVES or words[index].opens:
            return
        if word in lexicon.BODY_NOUNS and word != "back" and not (word == "foot" and words[index - 1].text == "on"):
            part = "hand" if stem(word) == "arm" else stem(word)
            yield Combination(f"{key} {preposition}{part}", verb, index, has_body=not moved)
            return
        preposition = f"{stem(word)} " if word in PLACES else preposition


def base_forms(word: str) -> Iterator[str]:
    """List a lower-case word and what its base form may be: "dives", "dive", "div"."""
    yield word
    for suffix in ("s", "es", "ed", "d", "ing", "ly"):
        base = word.removesuffix(suffix)
        if base != word and len(base) > 2:
            yield base
            yield base + "e"
            if base[-1] == base[-2]:
                yield base[:-1]


_LETTERS: Final = "abcdefghijklmnopqrstuvwxyz"


def edits_of(word: str) -> Iterator[str]:
    """List what one slip of spelling makes of a word: letters exchanged, left out, added or replaced."""
    for i in range(len(word)):
        yield word[:i] + word[i + 1 :]
        yield from (word[:i] + letter + word[i + 1 :] for letter in _LETTERS)
        yield from (word[:i] + letter + word[i:] for letter in _LETTERS)
        if i + 1 < len(word):
            yield word[:i] + word[i + 1] + word[i] + word[i + 2 :]
    yield from (word + letter for letter in _LETTERS)
