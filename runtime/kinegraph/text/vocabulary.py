"""Find the words of a sentence that a bundle was never shown.

1. Words: a word is known if a training caption has it in some inflection, or has a word one slip of spelling away.
2. People: a second person is told, since a bundle moves one.
3. Combinations: known words may mean another action in another order. A verb must have been seen with its direction, or
   with the part of the body that follows it ("raises the head" is not "raises the hand above the head").
4. Paraphrases: where the verb of a clause is the only unknown word, the text encoder compares the clause with known
   phrases, and with other actions that training did not show ("strolls" is near to "walks", "hops" to "jumps").

The text encoder runs only where something is unknown, once for all clauses of a sentence.

`find_seldom` tells what is known, and yet seldom comes out as asked, where that was measured.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final, Protocol

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.bundle.vocabulary import ACTION_SENTENCE, STYLE_SENTENCE, Vocabulary
from kinegraph.graph import SemanticGraph
from kinegraph.text import lexicon
from kinegraph.text.narration import is_plural_noun, subject_of
from kinegraph.text.normalise import correct_spelling
from kinegraph.text.words import (
    CONTRACTION,
    FUNCTION,
    LIGHT_VERBS,
    PERSON_PLURALS,
    PERSONS,
    PLACES,
    REQUESTS,
    STOPS,
    Word,
    base_forms,
    combinations,
    edits_of,
    split_clauses,
    split_words,
    stem,
)
from kinegraph.unknown import Reason, Unknown

NEAREST: Final = 3
"""Known phrases that are named for each unknown span."""
MARGIN: Final = 0.01
"""Cosine by which another wording must be nearer to a known phrase than to any other action."""
SELDOM: Final = 0.2
"""Share of its clips below which an action that is recognised in them is told to come out seldom."""
MASK: Final = "[MASK]"
"""Word piece of the text encoder for a word that an edit hides."""
_MAX_SPANS: Final = 64
"""Spans of one caption that are told; a list of single letters would have more."""
_MAX_QUERY: Final = 200
"""Characters of a clause that are embedded."""
_MIN_CORRECTED: Final = 4
"""Shorter words are one slip away from too many others."""
_MAX_GAP: Final = 3
"""Words of no content that may stand inside an unknown span ("plays [with a] ball")."""
_PERSON_NOUNS: Final = PERSONS & lexicon.SUBJECT_NOUNS - frozenset("he she it they".split())
_SIDE: Final = re.compile(r"\b(?:(?:the )?(?:left|right)(?=ward|\b)|both\b)")
_LIMB: Final = re.compile(r"\b(?:hand|arm)s?\b")
_EACH_OTHER: Final = frozenset((("other", "each"), ("another", "one")))
_JOINING: Final = frozenset("with behind beside alongside near against past toward towards".split())
"""Prepositions of a person who takes part; one may wave "to somebody" alone."""
_NO_PERSONS: Final = lexicon.EVENT_NOUNS | lexicon.MANNER_NOUNS | lexicon.BODY_NOUNS
_DETERMINERS: Final = frozenset("a an the his her their my another some this that".split())
_LIKENESS: Final = frozenset("like as way manner".split())
"""Words before a person who is only compared with ("like old people")."""


class PhraseEncoder(Protocol):
    """What the text encoder and its tokenizer are asked where something is unknown."""

    def is_word(self, word: str) -> bool:
        """Tell whether a lower-case word is a word piece of its own."""

    def embed(self, sentences: Sequence[str]) -> FloatArray:
        """Encode sentences to (n, D), each of length 1, in one run."""


@dataclass(frozen=True)
class _Span:
    """Words of a caption, first and last included, with the reason why they are unknown."""

    first: int
    last: int
    reason: Reason
    has_body: bool = False
    """True for a combination of a verb and a part of the body."""


def find_unknown(graph: SemanticGraph, vocabulary: Vocabulary, encoder: PhraseEncoder) -> tuple[Unknown, ...]:
    """Find what the bundle was never shown in the caption of a graph, from left to right.

    Args:
        graph: the parsed caption, or a graph that the caller brings; its actions say which words are verbs.
        vocabulary: what the bundle was shown.
        encoder: of the same bundle; asked only where a word is unknown.
    """
    return _Finder(graph, vocabulary, encoder).find()


def find_slips(graph: SemanticGraph, vocabulary: Vocabulary, encoder: PhraseEncoder) -> dict[tuple[int, int], str]:
    """Find the words of a caption that are known ones but for a slip of spelling: span -> how they are read.

    `find_unknown` takes them for known: what is encoded must be spelled so, too.
    """
    caption = graph.caption.replace(MASK, " " * len(MASK))
    if all(is_shown(word.text, vocabulary) for word in split_words(caption)):
        return {}
    read = _Finder(graph, vocabulary, encoder).words
    return {
        (word.start, word.end): corrected.text
        for word, corrected in zip(split_words(caption), read, strict=True)
        if corrected.text != word.text
    }


def is_shown(word: str, vocabulary: Vocabulary) -> bool:
    """Tell whether a lower-case word is in a caption of training, in any inflection, or names no motion."""
    return not FUNCTION.isdisjoint((word, word.replace("-", ""), CONTRACTION.sub("", word))) or (
        stem(word) in vocabulary.words
    )


def find_seldom(graph: SemanticGraph, vocabulary: Vocabulary) -> tuple[str, ...]:
    """Tell which actions of a graph are recognised in fewer than `SELDOM` of the clips that the bundle makes of them.

    A clause asks for the action whose wording it holds, in any inflection; of several, for that of the longest wording,
    or the best recognised. An action that was not measured, or is negated, is not told.
    """
    words = split_words(graph.caption)
    wanted = {action.start for action in graph.actions if not action.negated}
    notes = []
    for clause in split_clauses(words, graph):
        if wanted.isdisjoint(words[index].start for index in clause):
            continue
        said = _stems(words[index] for index in clause)
        held = [(len(stems), share, wording) for stems, share, wording in _measured(vocabulary) if stems in said]
        if held:
            _, share, wording = max(held)
            if share < SELDOM:
                notes.append(f"{wording!r} seldom comes out as asked: it is recognised in {share:.0%} of its clips")
    return tuple(dict.fromkeys(notes))


@lru_cache(maxsize=4)
def _measured(vocabulary: Vocabulary) -> list[tuple[str, float, str]]:
    """List stems, share and text of each wording of the actions that were measured."""
    return [
        (_stems(split_words(wording)), phrase.recognised, wording)
        for phrase in vocabulary.facts.phrases
        if phrase.recognised is not None
        for wording in phrase.wordings
    ]


def _stems(words: Iterable[Word]) -> str:
    """Join the stems of words with spaces between and around them, so that one text holds another by whole words."""
    return f" {' '.join(stem(word.text) for word in words)} "


class _Finder:
    """The caption of one graph beside a vocabulary."""

    def __init__(self, graph: SemanticGraph, vocabulary: Vocabulary, encoder: PhraseEncoder) -> None:
        self._graph, self._vocabulary, self._encoder = graph, vocabulary, encoder
        self._caption = graph.caption.replace(MASK, " " * len(MASK))
        self._words = [self._corrected(word) for word in split_words(self._caption)]
        self._verbs = {action.start for action in graph.actions}
        self._clauses = split_clauses(self._words, graph)

    @property
    def words(self) -> list[Word]:
        """The words of the caption as they are read."""
        return self._words

    def find(self) -> tuple[Unknown, ...]:
        """Find all unknown spans; see `find_unknown`."""
        people = list(self._people())
        taken = {index for span in people for index in range(span.first, span.last + 1)}
        unknown = {index for index in range(len(self._words)) if index not in taken and not self._is_known(index)}
        if not people and not unknown and not self._has_content():
            spans = [_Span(0, len(self._words) - 1, "word")] if self._words else []
        else:
            spans = [*people, *self._word_spans(unknown), *self._unseen_combinations(unknown | taken)]
        ordered = sorted(spans, key=lambda span: span.first)[:_MAX_SPANS]
        return self._without_paraphrases(ordered) if ordered else ()

    # Words

    def _is_known(self, index: int) -> bool:
        word, following = self._words[index].text, self._following(index)
        if self._ends_an_action(index) or word + following in lexicon.ROTATIONS:
            return True
        if word in ("couple", "pair") and following == "of":
            return True
        return word[0].isdigit() or self._is_shown(word) or all(map(self._is_shown, word.split("-")))

    def _ends_an_action(self, index: int) -> bool:
        """Tell whether a word is a verb that negates the participle after it ("| stops | waving")."""
        return self._words[index].text in STOPS and self._following(index).endswith("ing")

    def _following(self, index: int) -> str:
        """Return the word after an index, or nothing at the end."""
        return self._words[index + 1].text if index + 1 < len(self._words) else ""

    def _is_shown(self, word: str) -> bool:
        return is_shown(word, self._vocabulary)

    def _corrected(self, word: Word) -> Word:
        """Replace a word that is no English word by a known one that is one slip of spelling away, if there is one."""
        text = word.text
        if len(text) < _MIN_CORRECTED or not text.isascii() or not text.isalpha() or self._is_shown(text):
            return word
        if text in PERSON_PLURALS or text in STOPS or any(map(self._encoder.is_word, base_forms(text))):
            return word
        for edit in (correct_spelling(text, lambda _: False), *edits_of(text)):  # as the parser reads it, if it can
            is_long = len(edit) >= _MIN_CORRECTED
            if is_long and self._is_shown(edit) and any(map(self._encoder.is_word, base_forms(edit))):
                return replace(word, text=edit)
        return word

    def _has_content(self) -> bool:
        """Tell whether the caption names anything at all; a hidden word counts."""
        content = any(not (word.text in FUNCTION or word.text[0].isdigit()) for word in self._words)
        return content or MASK in self._graph.caption

    def _word_spans(self, unknown: set[int]) -> Iterator[_Span]:
        """Join unknown words of a clause with the words of no content between them, and with their preposition."""
        for clause in self._clauses:
            first = last = -1
            for index in clause:
                if index not in unknown:
                    continue
                if first >= 0 and index - last - 1 <= _MAX_GAP and self._is_filler(last + 1, index):
                    last = index
                    continue
                if first >= 0:
                    yield _Span(self._phrase_start(first, clause.start), last, "word")
                first = last = index
            if first >= 0:
                yield _Span(self._phrase_start(first, clause.start), last, "word")

    def _is_filler(self, first: int, stop: int) -> bool:
        words = self._words[first:stop]
        return all((word.text in FUNCTION or word.text in PLACES) and not word.opens for word in words)

    def _phrase_start(self, first: int, begin: int) -> int:
        """Take in the article and the preposition before an unknown noun ("with a suitcase")."""
        if self._words[first].start in self._verbs:
            return first
        start = first
        while (
            start > begin
            and not self._words[start].opens
            and self._words[start - 1].text in ("a", "an", "the", "his", "her")
        ):
            start -= 1
        before = self._words[start - 1].text if start > begin and not self._words[start].opens else ""
        return start - 1 if before in ("with", "like", "on", "in", "at", "to", "from", "by") else first

    # People

    def _people(self) -> Iterator[_Span]:
        """Find persons beside the one who moves, with the word before them: "two women", "another man"."""
        words = [word.text for word in self._words]
        for index, word in enumerate(words):
            if not _LIKENESS.isdisjoint(words[max(index - 3, 0) : index]):
                continue
            before = words[index - 1] if index else ""
            if word in PERSON_PLURALS and words[index + 1 : index + 2] != ["of"]:
                first = index if self._words[index].opens else index - 1
            elif (word in PERSONS and before in ("another", "other")) or (word, before) in _EACH_OTHER:
                first = index - 1
            elif word in _PERSON_NOUNS and (joined := self._joined_from(index)) is not None:
                first = joined
            else:
                continue
            yield _Span(max(first, 0), index, "people")
        yield from self._several_actors()

    def _several_actors(self) -> Iterator[_Span]:
        """Find nouns in the plural that no list has, of who moves: "two | boxers", "the | guards"."""
        found = set()
        for action in self._graph.actions:
            subject = subject_of(self._graph, action)
            own = [
                index
                for index, word in enumerate(self._words)
                if subject is not None and subject.start <= word.start and word.end <= subject.end
            ]
            word = self._words[own[-1]].text if own else ""
            is_person = word not in lexicon.BODY_PLURALS | PERSON_PLURALS | PERSONS and word[:-1] not in _NO_PERSONS
            if is_plural_noun(word) and is_person and own[-1] not in found:
                found.add(own[-1])
                yield _Span(max(own[0], own[-1] - 1), own[-1], "people")

    def _joined_from(self, index: int) -> int | None:
        """Return where a second person begins who is joined to the first ("a | woman and a man", "walks | with a man").

        None for a person at an index who is not.
        """
        first = index
        while first > 0 and not self._words[first].opens:
            before = self._words[first - 1].text
            if before == "and" and first > 1 and self._words[first - 2].text in _PERSON_NOUNS:
                return first - 2
            if before in _JOINING:
                return None if first > 1 and self._words[first - 2].text in REQUESTS else first - 1
            if before not in _DETERMINERS and first < index:
                return None
            first -= 1
        return None

    # Combinations

    def _unseen_combinations(self, unknown: set[int]) -> Iterator[_Span]:
        """Find verbs that training never joined with what follows them; what overlaps is one span."""
        seen, last = self._vocabulary.combinations, None
        for combination in combinations(self._words, self._graph):
            first = combination.first
            if combination.key in seen or self._words[first].text in FUNCTION or self._ends_an_action(first):
                continue
            if not unknown.isdisjoint(range(combination.first, combination.last + 1)):
                continue
            if combination.has_body and f"with {combination.key.split()[-1]}" == combination.key.partition(" ")[2]:
                continue
            span = _Span(combination.first, combination.last, "combination", combination.has_body)
            if last is not None and span.first <= last.last:
                last = replace(last, last=max(last.last, span.last), has_body=last.has_body or span.has_body)
                continue
            if last is not None:
                yield last
            last = span
        if last is not None:
            yield last

    # Phrases

    def _without_paraphrases(self, spans: Sequence[_Span]) -> tuple[Unknown, ...]:
        """Compare spans with the known phrases: drop paraphrases, and name what is nearest to the others."""
        vocabulary = self._vocabulary
        queries = [self._query(span) for span in spans]
        styles = np.array([is_style for _, is_style in queries])
        cosines = self._encoder.embed([sentence for sentence, _ in queries]) @ vocabulary.embeddings.T
        count = len(vocabulary.wordings)
        known, others = cosines[:, :count], cosines[:, count:].max(axis=1, initial=-1.0)
        known = np.where(vocabulary.style_rows == styles[:, None], known, -1.0)
        result = []
        for span, row, other in zip(spans, known, others, strict=True):
            best = float(row.max())
            if self._may_be_paraphrase(span) and best >= max(vocabulary.facts.paraphrase, float(other) + MARGIN):
                continue
            result.append(self._unknown(span, self._nearest(row)))
        return tuple(result)

    def _query(self, span: _Span) -> tuple[str, bool]:
        """Return the sentence to embed for a span, and whether it is a style."""
        words = range(span.first, span.last + 1)
        if self._is_style(span):
            return STYLE_SENTENCE.format(self._text(words)), True
        clause = self._clause(span)
        verbs = [index for index in clause if self._words[index].start in self._verbs]
        first = min([span.first, *verbs[:1]])
        if any(self._words[index].text in lexicon.BODY_NOUNS for index in range(clause.start, first)):
            return self._text(clause), False  # "both hands go up"
        if span.reason != "combination" or span.has_body:
            words = range(first, self._core_end(span, clause.stop))
        return ACTION_SENTENCE.format(self._text(words)), False

    def _core_end(self, span: _Span, stop: int) -> int:
        """Return where the style of a clause begins ("strolls | in a tired way"), or its end."""
        for index in range(span.last + 1, stop):
            following = self._words[index + 1].text if index + 1 < stop else ""
            word = self._words[index]
            if word.opens or word.text in ("like", "as") or (word.text == "in" and following in ("a", "an")):
                return index
        return stop

    def _text(self, indices: range) -> str:
        return self._caption[self._words[indices[0]].start : self._words[indices[-1]].end][:_MAX_QUERY]

    def _clause(self, span: _Span) -> range:
        return next(clause for clause in self._clauses if span.first in clause)

    def _is_style(self, span: _Span) -> bool:
        start, end = self._words[span.first].start, self._words[span.last].end
        if span.reason != "word" or any(start <= verb < end for verb in self._verbs):
            return False
        manner = any(
            part.role == "ARGM-MNR" and part.start < end and start < part.end and not part.text.startswith("with")
            for action in self._graph.actions
            for part in action.arguments
        )
        return manner or self._words[span.last].text.endswith("ly") or self._words[span.first].text == "like"

    def _may_be_paraphrase(self, span: _Span) -> bool:
        """Tell whether a span may only be another wording: a verb in a clause whose other words are known."""
        if span.reason == "combination":
            return not span.has_body
        if span.reason == "people" or span.first != span.last or not self._is_verb(span.first):
            return False
        return all(index == span.first or self._is_known(index) for index in self._clause(span))

    def _is_verb(self, index: int) -> bool:
        """Tell whether a word is a verb, or stands for one: "takes a stroll"; what an article precedes is none."""
        words = [word.text for word in self._words[max(index - 2, 0) : index + 1]]
        before = words[-2] if len(words) > 1 and not self._words[index].opens else ""
        if before in ("a", "an") and len(words) == 3:
            return stem(words[0]) in LIGHT_VERBS
        is_noun = before in _DETERMINERS or before in _LIKENESS or before in PLACES
        return self._words[index].start in self._verbs and not is_noun and not words[-1].endswith("ly")

    def _nearest(self, row: FloatArray) -> tuple[str, ...]:
        """Name the nearest phrases, each by the wording that is nearest; sides and hands or arms count as one."""
        vocabulary = self._vocabulary
        nearest: list[str] = []
        shown: set[int | str] = set()
        for index in np.argsort(-row, kind="stable"):
            if row[index] < vocabulary.facts.near or len(nearest) == NEAREST:
                break
            wording, phrase = vocabulary.wordings[index], int(vocabulary.wording_phrases[index])
            either_side = _LIMB.sub("hand", _SIDE.sub("side", wording))
            if shown.isdisjoint((phrase, either_side)):
                nearest.append(wording)
            shown |= {phrase, either_side}
        return tuple(nearest)

    def _unknown(self, span: _Span, nearest: tuple[str, ...]) -> Unknown:
        start, end = self._words[span.first].start, self._words[span.last].end
        return Unknown(self._graph.caption[start:end], start, end, nearest, span.reason)
