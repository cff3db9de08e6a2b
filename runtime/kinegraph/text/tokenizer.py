"""Tokenizer of the text encoder (WordPiece, or CLIP's byte pairs), with character offsets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import IntArray
from kinegraph.errors import BundleFormatError, InvalidInputError, MissingExtraError, ModelError
from kinegraph.limits import MAX_PIECES

_INTERRUPTS: Final = (KeyboardInterrupt, SystemExit)
"""Exceptions that pass. All others are the tokenizer's: a panic of its Rust code is a `BaseException`."""


@dataclass(frozen=True)
class TokenIds:
    """Word pieces of one caption: T of them, special ones included."""

    ids: IntArray
    """(T,) numbers in the vocabulary."""
    mask: IntArray
    """(T,) attention mask, all ones."""
    offsets: IntArray
    """(T, 2) start and end in characters of the caption, end exclusive; (0, 0) for special pieces."""


class CaptionTokenizer:
    """Caption to `TokenIds`, by the tokenizer of a bundle; safe to share between threads.

    Args:
        tokenizer_json: content of tokenizer.json.
        max_pieces: positions that the text encoder has.

    Raises:
        MissingExtraError: the package `tokenizers` is not installed.
        BundleFormatError: the bytes are no tokenizer.
    """

    def __init__(self, tokenizer_json: bytes, max_pieces: int = MAX_PIECES) -> None:
        self._max_pieces = max_pieces
        try:
            from tokenizers import Tokenizer
        except ImportError as error:
            raise MissingExtraError("captions need the package tokenizers: pip install tokenizers") from error
        try:
            self._tokenizer = Tokenizer.from_str(tokenizer_json.decode("utf-8"))
        except _INTERRUPTS:
            raise
        except BaseException as error:
            raise BundleFormatError(f"tokenizer.json is not a tokenizer: {error}") from error
        # The file may switch both on. `encode` refuses long captions instead, and a batch of one needs no padding.
        self._tokenizer.no_truncation()
        self._tokenizer.no_padding()

    def encode(self, text: str) -> TokenIds:
        """Split a caption into at least two word pieces.

        Raises:
            InvalidInputError: the caption has an unpaired surrogate, or more pieces than the encoder has positions.
            ModelError: the tokenizer failed.
        """
        check_unicode(text)
        try:
            encoding = self._tokenizer.encode(text)
        except _INTERRUPTS:
            raise
        except BaseException as error:
            raise ModelError(f"the tokenizer failed: {error}") from error
        if len(encoding.ids) > self._max_pieces:
            # Truncation would silently ignore the end of the sentence.
            raise InvalidInputError(
                f"the caption makes {len(encoding.ids)} word pieces, at most {self._max_pieces} fit; shorten it"
            )
        return TokenIds(
            ids=np.array(encoding.ids, dtype=np.int64),
            mask=np.ones(len(encoding.ids), dtype=np.int64),
            offsets=np.array(encoding.offsets, dtype=np.int64).reshape(-1, 2),
        )

    def is_word(self, word: str) -> bool:
        """Tell whether a lower-case word is a word piece of its own, as frequent English words are."""
        return self._tokenizer.token_to_id(word) is not None


def check_unicode(text: str) -> None:
    """Refuse unpaired surrogates: they have no UTF-8 encoding, and come from decoding bytes that are not text."""
    try:
        text.encode("utf-8")
    except UnicodeEncodeError as error:
        escaped = ascii(text[error.start])
        raise InvalidInputError(f"character {error.start + 1} of the caption is {escaped}, which is no text") from None


def span_mask(offsets: IntArray, start: int, end: int) -> NDArray[np.bool_]:
    """Mark the word pieces that share a character with a span; special pieces never do.

    Args:
        offsets: (T, 2) characters of the pieces, see `TokenIds`.
        start: first character of the span.
        end: one past its last character.

    Returns:
        (T,) True where a piece overlaps the span.
    """
    return (offsets[:, 0] < end) & (offsets[:, 1] > start) & (offsets[:, 1] > offsets[:, 0])
