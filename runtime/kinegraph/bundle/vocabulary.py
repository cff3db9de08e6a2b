"""`vocabulary.npz`: what a bundle was shown in training, optional.

The file holds two arrays: `facts`, UTF-8 of one JSON object (`Facts`) as bytes, and `embeddings`, one float16 row for
each wording of each phrase and then for each other action. `kinegraph_export.vocabulary` writes it;
`kinegraph.text.vocabulary` compares sentences with it.
"""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from kinegraph.archives import UNREADABLE, read_arrays
from kinegraph.arrays import FloatArray
from kinegraph.bundle.strict_json import decode, parse_object, to_plain
from kinegraph.errors import BundleFormatError

FILE: Final = "vocabulary.npz"
FACTS: Final = "facts"
EMBEDDINGS: Final = "embeddings"

MAX_FACTS_BYTES: Final = 1 << 20
MAX_WORDS: Final = 20_000
MAX_COMBINATIONS: Final = 50_000
MAX_PHRASES: Final = 1000
"""Actions and styles."""
MAX_ROWS: Final = 4000
"""Rows of the embeddings."""

ACTION_SENTENCE: Final = "a person {}"
STYLE_SENTENCE: Final = "a person walks {}"
"""Sentences in which wordings of actions and styles are embedded."""


@dataclass(frozen=True)
class Phrase:
    """An action or a style that training showed."""

    name: str
    """Label: "wave-right-hand"."""
    kind: Literal["action", "style"]
    clips: int
    """Recorded clips that show it."""
    example: str
    """A sentence for it."""
    wordings: tuple[str, ...]
    """Ways to say it, as they stand in `ACTION_SENTENCE` or `STYLE_SENTENCE`."""
    recognised: float | None = None
    """Share of clips made for it that an evaluator of captured motion takes for it, among 32 actions; None where it was
    not measured."""


@dataclass(frozen=True)
class Facts:
    """Words and phrases of the training captions."""

    words: tuple[str, ...]
    """Stems of all words (`kinegraph.text.words.stem`)."""
    combinations: tuple[str, ...]
    """Verbs with what follows them (`kinegraph.text.words.combinations`)."""
    phrases: tuple[Phrase, ...]
    others: tuple[str, ...]
    """Actions that training did not show, as wordings: what is nearer to one of them is not known."""
    paraphrase: float
    """Cosine from which another wording of an action counts as that action."""
    near: float
    """Cosine from which a phrase is worth naming."""


@dataclass(frozen=True, eq=False)
class Vocabulary:
    """Content of `vocabulary.npz`, validated.

    Raises:
        BundleFormatError: thresholds out of range, more than the limits, or embeddings of another shape or not finite.
    """

    facts: Facts
    embeddings: FloatArray
    """(rows, D) float32, each of length 1: wordings of the phrases in order, then `others`."""

    def __post_init__(self) -> None:
        facts = self.facts
        for name, values, most in (
            ("words", facts.words, MAX_WORDS),
            ("combinations", facts.combinations, MAX_COMBINATIONS),
            ("phrases", facts.phrases, MAX_PHRASES),
        ):
            _require(len(values) <= most, f"{name} has {len(values)} entries; {most} are allowed")
        _require(bool(facts.phrases), "phrases is empty")
        for phrase in facts.phrases:
            _require(phrase.clips >= 0, f"phrase {phrase.name!r} has {phrase.clips} clips")
            _require(bool(phrase.wordings), f"phrase {phrase.name!r} has no wording")
            share = phrase.recognised
            _require(share is None or 0 <= share <= 1, f"phrase {phrase.name!r} is recognised {share}, not 0 to 1")
        for name in ("paraphrase", "near"):
            value = getattr(facts, name)
            _require(0 <= value <= 1, f"{name} must be 0 to 1, found {value}")
        rows = len(self.wording_phrases) + len(facts.others)
        _require(rows <= MAX_ROWS, f"it has {rows} wordings; {MAX_ROWS} are allowed")
        shape = self.embeddings.shape
        _require(len(shape) == 2 and shape[0] == rows, f"{EMBEDDINGS} must have {rows} rows, found shape {shape}")
        _require(bool(np.isfinite(self.embeddings).all()), f"{EMBEDDINGS} holds NaN or infinity")
        lengths = np.linalg.norm(self.embeddings, axis=1, keepdims=True)
        _require(bool((lengths > 0).all()), f"{EMBEDDINGS} holds a row of zeros")
        unit = (self.embeddings / lengths).astype(np.float32)
        unit.setflags(write=False)
        object.__setattr__(self, "embeddings", unit)

    @cached_property
    def words(self) -> frozenset[str]:
        """Stems of all known words."""
        return frozenset(self.facts.words)

    @cached_property
    def combinations(self) -> frozenset[str]:
        """Known verbs with what follows them."""
        return frozenset(self.facts.combinations)

    @cached_property
    def wording_phrases(self) -> NDArray[np.int64]:
        """Number of the phrase that each wording belongs to."""
        counts = [len(phrase.wordings) for phrase in self.facts.phrases]
        return np.repeat(np.arange(len(counts)), counts)

    @cached_property
    def wordings(self) -> tuple[str, ...]:
        """Wordings of all phrases, in the order of the embeddings."""
        return tuple(wording for phrase in self.facts.phrases for wording in phrase.wordings)

    @cached_property
    def style_rows(self) -> NDArray[np.bool_]:
        """True for each wording of a style, False for each of an action."""
        return np.array([phrase.kind == "style" for phrase in self.facts.phrases])[self.wording_phrases]


def sentences_to_embed(facts: Facts) -> list[str]:
    """List the sentences whose embeddings are the rows of the file."""
    templates = {"action": ACTION_SENTENCE, "style": STYLE_SENTENCE}
    wordings = [templates[phrase.kind].format(text) for phrase in facts.phrases for text in phrase.wordings]
    return wordings + [ACTION_SENTENCE.format(text) for text in facts.others]


def pack_vocabulary(facts: Facts, embeddings: FloatArray) -> bytes:
    """Pack `vocabulary.npz`; the same input gives the same bytes.

    Args:
        facts: words and phrases.
        embeddings: (rows, D) of `sentences_to_embed`.

    Raises:
        BundleFormatError: as in `Vocabulary`.
    """
    text = json.dumps(to_plain(Vocabulary(facts, embeddings).facts), ensure_ascii=False, separators=(",", ":"))
    facts_bytes = np.frombuffer(text.encode(), dtype=np.uint8)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, facts=facts_bytes, embeddings=embeddings.astype(np.float16))
    return buffer.getvalue()


def read_vocabulary(data: bytes, width: int) -> Vocabulary:
    """Read `vocabulary.npz` from memory, without pickle.

    Args:
        data: content of the file.
        width: D, width of the bundle's text encoder.

    Raises:
        BundleFormatError: another archive, an array of another type or larger than allowed, unknown or missing keys,
            or values out of range.
    """
    limits = {FACTS: MAX_FACTS_BYTES, EMBEDDINGS: MAX_ROWS * width * 2}
    try:
        arrays = read_arrays(data, limits)
        facts, embeddings = arrays[FACTS], arrays[EMBEDDINGS]
    except UNREADABLE as error:
        raise BundleFormatError(f"{FILE} is not an npz archive of plain arrays: {error}") from error
    _require_array(facts, FACTS, np.uint8, 1)
    _require_array(embeddings, EMBEDDINGS, np.float16, 2)
    _require(embeddings.shape[1] == width, f"{EMBEDDINGS} must have {width} columns, found {embeddings.shape[1]}")
    record = decode(Facts, parse_object(facts.tobytes(), FILE), FILE)
    return Vocabulary(record, embeddings.astype(np.float32))


def _require_array(array: NDArray[Any], name: str, dtype: type, dimensions: int) -> None:
    if array.dtype != dtype or array.ndim != dimensions:
        kind = f"{array.dtype} {array.shape}"
        raise BundleFormatError(f"{FILE}: {name} must be {np.dtype(dtype)} of {dimensions} dimensions, found {kind}")


def _require(holds: bool, message: str) -> None:
    if not holds:
        raise BundleFormatError(f"{FILE}: {message}")
