"""A small vocabulary, and an encoder of bags of words: sentences are alike by the words they share."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.bundle.vocabulary import Facts, Phrase, Vocabulary, pack_vocabulary, sentences_to_embed
from kinegraph.graph import Action, SemanticGraph
from kinegraph.text.words import combinations, split_words, stem

WIDTH = 1024
CAPTIONS = {
    "a person walks": "walks",
    "a person walks forward slowly": "walks",
    "a person walks like a giant": "walks",
    "someone raises the left hand above the head": "raises",
    "a person raises both arms": "raises",
    "a person waves with the right hand": "waves",
    "a person takes two steps": "takes",
    "the left foot": "foot",
}
"""Captions of an imagined training, with their verbs."""
MEANINGS = {"strolls": "walks", "stroll": "walks", "hops": "jumps"}
"""Words that the encoder takes for others."""
_ENGLISH = "walk raise wave stroll hop jump juggle robot hat suitcase hand head foot left forward giant sit take step"
ENGLISH = frozenset(_ENGLISH.split())
"""Words that the tokenizer knows."""


def graph_of(caption: str, *verbs: str) -> SemanticGraph:
    """Build a graph whose actions are some words of a caption, without arguments."""
    starts = [caption.index(verb) for verb in verbs]
    actions = (Action(verb, start, start + len(verb), order) for order, (verb, start) in enumerate(zip(verbs, starts)))  # noqa: B905
    return SemanticGraph(caption, tuple(actions))


@dataclass
class BagEncoder:
    """Sentences as counts of their words; remembers what it was asked."""

    asked: list[list[str]] = field(default_factory=list)
    """Sentences of each run."""

    def is_word(self, word: str) -> bool:
        return word in ENGLISH

    def embed(self, sentences: Sequence[str]) -> FloatArray:
        self.asked.append(list(sentences))
        return self.rows(sentences)

    def rows(self, sentences: Sequence[str]) -> FloatArray:
        """Embed sentences; "a person" counts for little, as it stands in all of them."""
        rows = np.zeros((len(sentences), WIDTH), dtype=np.float32)
        for row, sentence in zip(rows, sentences, strict=True):
            for word in sentence.lower().split():
                column = zlib.crc32(MEANINGS.get(word, word).encode("utf-8", "replace")) % WIDTH
                row[column] += 0.2 if word in ("a", "person") else 1.0
        return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def small_facts(**changes: object) -> Facts:
    """Build the facts of `CAPTIONS`; `changes` replace fields."""
    words = {stem(word.text) for caption in CAPTIONS for word in split_words(caption)}
    pairs = {
        found.key
        for caption, verb in CAPTIONS.items()
        for found in combinations(split_words(caption), graph_of(caption, verb))
    }
    fields = {
        "words": tuple(sorted(words)),
        "combinations": tuple(sorted(pairs)),
        "phrases": (
            Phrase("walk", "action", 9, "a person walks", ("walks", "walks forward")),
            Phrase("raise-left", "action", 5, "a person raises the left hand", ("raises the left hand",)),
            Phrase("raise-right", "action", 5, "a person raises the right hand", ("raises the right hand",)),
            Phrase("wave", "action", 4, "a person waves", ("waves with the right hand",)),
            Phrase("giant", "style", 3, "a person walks like a giant", ("like a giant",)),
        ),
        "others": ("jumps", "sits down"),
        "paraphrase": 0.6,
        "near": 0.1,
    }
    return Facts(**{**fields, **changes})  # type: ignore[arg-type]


def small_vocabulary(encoder: BagEncoder) -> Vocabulary:
    """Build the vocabulary of `CAPTIONS`, embedded by an encoder."""
    facts = small_facts()
    return Vocabulary(facts, encoder.rows(sentences_to_embed(facts)))


def vocabulary_file(width: int) -> bytes:
    """Pack the small vocabulary with random embeddings of some width."""
    facts = small_facts()
    rows = len(sentences_to_embed(facts))
    return pack_vocabulary(facts, np.random.default_rng(0).standard_normal((rows, width)).astype(np.float32))
