"""Dependency parse of a caption with spaCy, and the tokens and spans that the later stages work on.

spaCy parses the surrogates of `kinegraph.text.normalise` instead of the words as they are written; token i is the same
word in both, so offsets stay those of the caption.
"""

from __future__ import annotations

import importlib
import random
import sys
import threading
from collections.abc import Callable, Collection, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from typing import Any, Final

from kinegraph.errors import BundleFormatError, MissingExtraError
from kinegraph.text import lexicon
from kinegraph.text.caption_tokens import UNUSUAL, CaptionToken, caption_tokens
from kinegraph.text.normalise import Dictionary, NormalisedTokens, normalise_tokens

PIPES: Final[tuple[str, ...]] = ("tok2vec", "tagger", "parser", "attribute_ruler", "lemmatizer")

_LISTENER: Final = {"@architectures": "spacy.Tok2VecListener.v1", "width": 96, "upstream": "tok2vec"}

COMPONENTS: Final[dict[str, dict[str, Any]]] = {
    "tok2vec": {
        "model": {
            "@architectures": "spacy.Tok2Vec.v2",
            "embed": {
                "@architectures": "spacy.MultiHashEmbed.v2",
                "width": 96,
                "attrs": ["NORM", "PREFIX", "SUFFIX", "SHAPE", "SPACY", "IS_SPACE"],
                "rows": [5000, 1000, 2500, 2500, 50, 50],
                "include_static_vectors": False,
            },
            "encode": {
                "@architectures": "spacy.MaxoutWindowEncoder.v2",
                "width": 96,
                "depth": 4,
                "window_size": 1,
                "maxout_pieces": 3,
            },
        }
    },
    "tagger": {"model": {"@architectures": "spacy.Tagger.v2", "nO": None, "normalize": False, "tok2vec": _LISTENER}},
    "parser": {
        "model": {
            "@architectures": "spacy.TransitionBasedParser.v2",
            "state_type": "parser",
            "extra_state_tokens": False,
            "hidden_width": 64,
            "maxout_pieces": 2,
            "use_upper": True,
            "nO": None,
            "tok2vec": _LISTENER,
        }
    },
    "attribute_ruler": {},
    "lemmatizer": {"mode": "rule"},
}
"""Configuration of the pipeline's components.

The pipeline is built from this table and takes only weights from the bundle: a bundle cannot name code to run."""


def load_pipeline(data: bytes) -> Any:
    """Build the spaCy pipeline of `COMPONENTS` and load its weights.

    Args:
        data: what `nlp.to_bytes()` returned.

    Raises:
        MissingExtraError: spaCy is not installed.
        BundleFormatError: the bytes do not fit the pipeline.
    """
    try:
        import_spacy()
        from spacy.lang.en import English
        from spacy.tokenizer import Tokenizer
    except ImportError as error:
        raise MissingExtraError(
            'parsing a sentence needs spaCy: pip install "kinegraph[text]"; or pass a graph instead of a sentence'
        ) from error

    # The bytes contain the tokenizer's rules. Building the default rules first would take a tenth of a second.
    pipeline = English(create_tokenizer=lambda language: Tokenizer(language.vocab))
    for name in PIPES:
        pipeline.add_pipe(name, config=COMPONENTS[name])
    try:
        return pipeline.from_bytes(data, exclude=["meta", "config", "config.cfg", "meta.json"])
    except Exception as error:
        raise BundleFormatError(f"parser.bin does not hold the parser's weights: {error}") from error


def import_spacy() -> None:
    """Import spaCy and leave Python's global random state as it is.

    One of the packages that come with it, rich, draws a number from it when it is imported. It is imported first, in a
    hundredth of a second, so that hardly any draw of another thread can fall between saving and restoring.
    """
    if "rich.style" not in sys.modules:
        state = random.getstate()
        with suppress(ImportError):
            importlib.import_module("rich.style")
        random.setstate(state)
    importlib.import_module("spacy.lang.en")


def import_in_background() -> None:
    """Start importing spaCy in a thread, so that its half a second overlaps with loading the bundle."""

    def load() -> None:
        with suppress(ImportError):  # `load_pipeline` reports it when a sentence has to be parsed
            import_spacy()

    threading.Thread(target=load, daemon=True).start()


def clean(caption: str) -> str:
    """Replace white space and control characters by blanks, and curly quotes by straight ones; offsets hold."""
    return "".join(lexicon.STRAIGHT.get(char, char) if char.isprintable() else " " for char in caption)


Span = tuple[int, int]
"""First and last token, both included."""


def has_word(text: str) -> bool:
    """Tell whether a text contains a letter or a digit."""
    return any(char.isalnum() for char in text)


def is_filler(text: str, dep: str) -> bool:
    """Tell whether a token is punctuation or a coordinating conjunction, which no span begins or ends with."""
    return not has_word(text) or dep == "cc"


def trim_span(span: Span, is_filler_at: Callable[[int], bool]) -> Span | None:
    """Shrink a span to its first and last token that is no filler; None if there is none."""
    solid = [index for index in range(span[0], span[1] + 1) if not is_filler_at(index)]
    return (solid[0], solid[-1]) if solid else None


@dataclass(frozen=True)
class ParsedTokens:
    """Dependency parse of N tokens as plain tuples, which are much faster to read than spaCy tokens."""

    text: tuple[str, ...]
    """Words with corrected spelling, lower case."""
    lemma: tuple[str, ...]
    """Base forms, lower case."""
    pos: tuple[str, ...]
    """Universal part of speech."""
    tag: tuple[str, ...]
    """Penn Treebank tag."""
    dep: tuple[str, ...]
    """Label of the edge to the head."""
    head: tuple[int, ...]
    """Index of the head; a root is its own head."""
    first: tuple[int, ...]
    """First token of the subtree."""
    last: tuple[int, ...]
    """Last token of the subtree."""
    sentence: tuple[int, ...]
    """First token of the sentence."""

    @staticmethod
    def from_doc(doc: Any, words: Sequence[str]) -> ParsedTokens:
        """Copy the parse of a spaCy document; `words` are the corrected words that its surrogates stand for."""
        rows = [
            (t.lemma_.lower(), t.pos_, t.tag_, t.dep_, t.head.i, t.left_edge.i, t.right_edge.i, sentence.start)
            for sentence in doc.sents
            for t in sentence
        ]
        columns = list(zip(*rows, strict=True)) or [()] * 8
        return ParsedTokens(tuple(word.lower() for word in words), *columns)

    def __len__(self) -> int:
        return len(self.text)

    def trim(self, span: Span) -> Span | None:
        """Drop punctuation and conjunctions at the ends of a span; None if nothing is left."""
        return trim_span(span, lambda index: is_filler(self.text[index], self.dep[index]))


@dataclass(frozen=True)
class DependencyParse:
    """Dependency parse of one caption; token i is the same word in all fields."""

    offsets: tuple[tuple[int, int], ...]
    """Characters of the caption that each token stands for, end exclusive."""
    doc: Any
    """spaCy document of the surrogates, with the dependency parse: the input of the rules."""
    tokens: ParsedTokens
    """The same parse with the corrected words: the input of the argument classifier."""
    states: frozenset[int]
    """Indices of the words that would follow "is" in phrases without a verb ("left hand up"); `doc` has verbs there."""
    clause_verbs: frozenset[int]
    """Indices of the verbs that their place tells, one clause each."""


class DependencyParser:
    """Text to `DependencyParse`; deterministic, safe to share between threads.

    Raises:
        MissingExtraError: spaCy is not installed.
        BundleFormatError: the bytes are no pipeline.
    """

    def __init__(self, pipeline_bytes: bytes) -> None:
        self._pipeline = load_pipeline(pipeline_bytes)
        lemma_index = self._pipeline.get_pipe("lemmatizer").lookups.get_table("lemma_index", {})
        stop_words = frozenset(self._pipeline.Defaults.stop_words)
        self._words = stop_words.union(*(set(words) for words in lemma_index.values()))
        verbs = frozenset(lemma_index["verb"]) if "verb" in lemma_index else frozenset()
        self._dictionary = Dictionary(self._is_known, verbs.__contains__)

    def __call__(self, caption: str) -> DependencyParse:
        """Parse a caption.

        If the parser took a verb for a plural noun, the caption is parsed a second time with that word as a verb.
        """
        written = self._pipeline.make_doc(clean(caption))
        if UNUSUAL.search(caption):
            tokens = caption_tokens(written, caption)
        else:
            tokens = [CaptionToken(t.text, t.idx, t.idx + len(t), bool(t.whitespace_)) for t in written]
        doc, normalised = self._run_pipeline(tokens, ())
        verb = _find_overlooked_verb(doc, normalised.words)
        if verb is not None:
            doc, normalised = self._run_pipeline(tokens, (verb,))
        offsets = tuple((token.start, token.end) for token in tokens)
        return DependencyParse(
            offsets, doc, ParsedTokens.from_doc(doc, normalised.words), normalised.states, normalised.clause_verbs
        )

    def forgetting(self) -> AbstractContextManager[Any]:
        """Open a block at whose end spaCy forgets the words that came up in it; its documents end there, too."""
        zone: AbstractContextManager[Any] = self._pipeline.memory_zone()
        return zone

    def _run_pipeline(self, tokens: Sequence[CaptionToken], verbs_at: Collection[int]) -> tuple[Any, NormalisedTokens]:
        """Parse the surrogates of a caption's tokens; returns the document and what was normalised."""
        from spacy.tokens import Doc

        normalised = normalise_tokens(tokens, self._dictionary, verbs_at)
        doc = Doc(self._pipeline.vocab, words=list(normalised.surrogates), spaces=[token.space for token in tokens])
        for token, begins in zip(doc, normalised.begins_sentence, strict=True):
            if begins:
                token.is_sent_start = True
        for _, component in self._pipeline.pipeline:
            doc = component(doc)
        for token, lemma in zip(doc, normalised.lemmas, strict=True):
            if lemma is not None:
                token.lemma_ = lemma
        return doc, normalised

    def _is_known(self, word: str) -> bool:
        """Tell whether the dictionary has a lower-case word, or the base form of which it is a regular form."""
        return word in self._words or any(
            word.endswith(suffix) and word[: len(word) - len(suffix)] + base_ending in self._words
            for suffix, base_ending in _SUFFIXES
        )


_SUFFIXES: Final = (
    ("s", ""), ("es", ""), ("ies", "y"), ("ed", ""), ("ed", "e"), ("ied", "y"), ("ing", ""), ("ing", "e"), ("ly", ""),
    ("er", ""), ("er", "e"), ("est", ""), ("est", "e"),
)  # fmt: skip
"""Endings of regular forms, with the ending of their base form."""


def _find_overlooked_verb(doc: Any, words: Sequence[str]) -> int | None:
    """Find a verb that the parser took for a plural noun, in a sentence without one ("a person on a chair waves")."""
    for sentence in doc.sents:
        root = sentence.root
        if root.pos_ not in ("NOUN", "PROPN", "PRON") or root.lemma_.lower() in lexicon.EVENT_NOUNS:
            continue
        for token in sentence:
            word = words[token.i].lower()
            before = doc[token.i - 1] if token.i else None
            if word in lexicon.FINITE_VERBS and token.tag_ == "NNS" and before is not None and token.i > root.i:
                noun = before.pos_ in ("DET", "ADJ", "NUM", "ADP", "PUNCT") or before.lower_ in lexicon.BODY_NOUNS
                if not noun and before.tag_ != "PRP$":
                    index: int = token.i
                    return index
    return None
