"""A caption's words with spaCy's dependency parse of them, read as `kinegraph.text.normalise` has it."""

from __future__ import annotations

import threading
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

from kinegraph.errors import BundleFormatError, MissingExtraError
from kinegraph.text import lexicon
from kinegraph.text.candidates import ParsedTokens
from kinegraph.text.normalise import normalise_tokens

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
"""The pipeline is built from this table and only filled from the bundle's bytes: nothing in those names code."""


def load_pipeline(data: bytes) -> Any:
    """A spaCy pipeline of `COMPONENTS` with the weights of `nlp.to_bytes()`.

    Raises:
        MissingExtraError: spaCy is not installed.
        BundleFormatError: the bytes do not fit the pipeline.
    """
    try:
        from spacy.lang.en import English
        from spacy.tokenizer import Tokenizer
    except ImportError as error:
        raise MissingExtraError(
            'parsing a sentence needs spaCy: pip install "kinegraph[text]"; or pass a graph instead of a sentence'
        ) from error

    # The tokenizer's rules come with the bytes; making English's own first takes a tenth of a second.
    pipeline = English(create_tokenizer=lambda made: Tokenizer(made.vocab))
    for name in PIPES:
        pipeline.add_pipe(name, config=COMPONENTS[name])
    try:
        return pipeline.from_bytes(data, exclude=["meta", "config", "config.cfg", "meta.json"])
    except Exception as error:
        raise BundleFormatError(f"parser.bin does not hold the parser's weights: {error}") from error


def import_in_background() -> None:
    """Begin to import spaCy, which takes half a second, while something else is read."""

    def load() -> None:
        with suppress(ImportError):  # said by `load_pipeline`, to whoever asked for a sentence
            pass

    threading.Thread(target=load, daemon=True).start()


@dataclass(frozen=True)
class DependencyParse:
    """One caption, analysed; word i is the same in all three."""

    written: Any
    """spaCy tokens of the caption as it is written: offsets come from here."""
    parsed: Any
    """spaCy tokens with the dependency parse, of the words as they were read."""
    words: ParsedTokens


class DependencyParser:
    """Text to `DependencyParse`; deterministic, safe to share between threads.

    Raises:
        MissingExtraError: spaCy is not installed.
        BundleFormatError: the bytes are no pipeline.
    """

    def __init__(self, pipeline_bytes: bytes) -> None:
        self._pipeline = load_pipeline(pipeline_bytes)
        index = self._pipeline.get_pipe("lemmatizer").lookups.get_table("lemma_index", {})
        self._dictionary = frozenset(self._pipeline.Defaults.stop_words).union(*(set(part) for part in index.values()))

    def __call__(self, text: str) -> DependencyParse:
        """Analyse a text; where no clause has a verb, once more with the first plural that may be one as a verb."""
        written = self._pipeline.make_doc(text)
        parsed, mended = self._parsed(written, ())
        overlooked = _overlooked_verb(parsed, mended)
        if overlooked is not None:
            parsed, mended = self._parsed(written, (overlooked,))
        return DependencyParse(written, parsed, ParsedTokens.of(parsed, mended))

    def _parsed(self, written: Any, verbs_at: Collection[int]) -> tuple[Any, tuple[str, ...]]:
        from spacy.tokens import Doc

        found = normalise_tokens([token.text for token in written], self._known, verbs_at)
        spaces = [bool(token.whitespace_) for token in written]
        doc = Doc(self._pipeline.vocab, words=list(found.surrogates), spaces=spaces)
        for _, component in self._pipeline.pipeline:
            doc = component(doc)
        for token, lemma in zip(doc, found.lemmas, strict=True):
            if lemma is not None:
                token.lemma_ = lemma
        return doc, found.words

    def _known(self, word: str) -> bool:
        """Whether a word in lower case, or what it is a regular form of, is in the dictionary."""
        return word in self._dictionary or any(
            word.endswith(ending) and word[: len(word) - len(ending)] + rest in self._dictionary
            for ending, rest in _ENDINGS
        )


_ENDINGS: Final = (
    ("s", ""), ("es", ""), ("ies", "y"), ("ed", ""), ("ed", "e"), ("ied", "y"), ("ing", ""), ("ing", "e"), ("ly", ""),
    ("er", ""), ("er", "e"), ("est", ""), ("est", "e"),
)  # fmt: skip


def _overlooked_verb(parsed: Any, mended: tuple[str, ...]) -> int | None:
    """A verb behind a subject that the parser took for the sentence ("a person on a chair waves")."""
    for sentence in parsed.sents:
        root = sentence.root
        if root.pos_ not in ("NOUN", "PROPN", "PRON") or root.lemma_.lower() in lexicon.EVENT_NOUNS:
            continue
        for token in sentence:
            word = mended[token.i].lower()
            before = parsed[token.i - 1] if token.i else None
            if word in lexicon.FINITE_VERBS and token.tag_ == "NNS" and before is not None and token.i > root.i:
                noun = before.pos_ in ("DET", "ADJ", "NUM", "ADP", "PUNCT") or before.lower_ in lexicon.BODY_NOUNS
                if not noun and before.tag_ != "PRP$":
                    place: int = token.i
                    return place
    return None
