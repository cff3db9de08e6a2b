"""Word pieces with the characters they came from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import IntArray
from kinegraph.errors import BundleFormatError, InvalidInputError, MissingExtraError
from kinegraph.limits import MAX_PIECES


@dataclass(frozen=True)
class TokenIds:
    """One caption as T word pieces, special ones included."""

    ids: IntArray
    """(T,)."""
    mask: IntArray
    """(T,) ones."""
    offsets: IntArray
    """(T, 2) start and end in characters of the caption; (0, 0) for special pieces."""


class CaptionTokenizer:
    """The tokenizer a bundle carries; safe to share between threads.

    Raises:
        MissingExtraError: the package `tokenizers` is not installed.
        BundleFormatError: the bytes are no tokenizer.
    """

    def __init__(self, tokenizer_json: bytes) -> None:
        try:
            from tokenizers import Tokenizer
        except ImportError as error:
            raise MissingExtraError("captions need the package tokenizers: pip install tokenizers") from error
        try:
            self._tokenizer = Tokenizer.from_str(tokenizer_json.decode("utf-8"))
        except Exception as error:
            raise BundleFormatError(f"tokenizer.json is not a tokenizer: {error}") from error
        # the file may ask for both; captions are bounded elsewhere and a batch of one needs no padding
        self._tokenizer.no_truncation()
        self._tokenizer.no_padding()

    def encode(self, text: str) -> TokenIds:
        """Pieces of a caption; T is at least 2.

        Raises:
            InvalidInputError: half a surrogate pair, or more pieces than the text encoder has positions.
        """
        check_unicode(text)
        encoding = self._tokenizer.encode(text)
        if len(encoding.ids) > MAX_PIECES:
            # Cut off silently, the end of the sentence would not be obeyed.
            raise InvalidInputError(
                f"the caption makes {len(encoding.ids)} word pieces, at most {MAX_PIECES} fit; shorten it"
            )
        return TokenIds(
            ids=np.array(encoding.ids, dtype=np.int64),
            mask=np.ones(len(encoding.ids), dtype=np.int64),
            offsets=np.array(encoding.offsets, dtype=np.int64).reshape(-1, 2),
        )


def check_unicode(text: str) -> None:
    """Refuse half a surrogate pair, which no UTF-8 holds: what is left of bytes that were not text."""
    try:
        text.encode("utf-8")
    except UnicodeEncodeError as error:
        shown = ascii(text[error.start])
        raise InvalidInputError(f"character {error.start + 1} of the caption is {shown}, which is no text") from None


def span_mask(offsets: IntArray, start: int, end: int) -> NDArray[np.bool_]:
    """(T,) True for pieces that share a character with [start, end); special pieces never do."""
    return (offsets[:, 0] < end) & (offsets[:, 1] > start) & (offsets[:, 1] > offsets[:, 0])
