"""Word pieces and the characters they came from."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.bundle.reader import text_files_folder
from kinegraph.errors import BundleFormatError, InvalidInputError
from kinegraph.limits import MAX_PIECES, MAX_TEXT
from kinegraph.text.tokenizer import CaptionTokenizer, span_mask

FILE = text_files_folder() / "tokenizer.json"


@pytest.fixture(scope="module")
def tokenizer() -> CaptionTokenizer:
    return CaptionTokenizer(FILE.read_bytes())


def test_ids_are_those_of_berts_uncased_vocabulary(tokenizer: CaptionTokenizer) -> None:
    # [CLS] a person walks [SEP], as published with the vocabulary
    tokens = tokenizer.encode("A person walks")
    assert tokens.ids.tolist() == [101, 1037, 2711, 7365, 102]
    assert tokens.mask.tolist() == [1] * 5
    assert tokens.offsets.tolist() == [[0, 0], [0, 1], [2, 8], [9, 14], [0, 0]]
    assert tokens.ids.dtype == tokens.mask.dtype == tokens.offsets.dtype == np.int64


def test_pieces_of_one_word_share_its_span(tokenizer: CaptionTokenizer) -> None:
    text = "someone moonwalks"
    tokens = tokenizer.encode(text)
    mask = span_mask(tokens.offsets, 8, len(text))
    assert mask.sum() > 1, "the word is cut into pieces"
    assert "".join(text[start:end] for start, end in tokens.offsets[mask]) == "moonwalks"


def test_a_span_masks_the_pieces_that_share_a_character_and_no_special_one(tokenizer: CaptionTokenizer) -> None:
    tokens = tokenizer.encode("walks to the left")
    assert span_mask(tokens.offsets, 9, 17).tolist() == [False, False, False, True, True, False]
    assert span_mask(tokens.offsets, 10, 11).tolist() == [False, False, False, True, False, False]
    assert not span_mask(tokens.offsets, 0, 0).any()


@given(st.text(alphabet=st.characters(exclude_categories=["Cs"]), min_size=1, max_size=80))
def test_offsets_are_characters_of_any_text(tokenizer: CaptionTokenizer, text: str) -> None:
    tokens = tokenizer.encode(text)
    assert len(tokens.ids) == len(tokens.mask) == len(tokens.offsets) >= 2
    assert (tokens.offsets >= 0).all() and (tokens.offsets <= len(text)).all()
    starts = tokens.offsets[1:-1, 0]
    assert (np.diff(starts) >= 0).all()


def test_more_pieces_than_positions_are_refused_not_cut_off(tokenizer: CaptionTokenizer) -> None:
    assert len(tokenizer.encode("走" * (MAX_PIECES - 2)).ids) == MAX_PIECES
    with pytest.raises(InvalidInputError, match=f"{MAX_TEXT + 2} word pieces"):
        tokenizer.encode("走" * MAX_TEXT)


def test_half_a_surrogate_pair_is_refused(tokenizer: CaptionTokenizer) -> None:
    with pytest.raises(InvalidInputError, match="character 3"):
        tokenizer.encode("a \udcff walks")


@pytest.mark.parametrize("wrong", [b"", b"{}", b"\xff\xfe", b'{"version": "1.0"}'])
def test_bytes_without_a_tokenizer_are_refused(wrong: bytes) -> None:
    with pytest.raises(BundleFormatError):
        CaptionTokenizer(wrong)
