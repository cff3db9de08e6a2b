"""`vocabulary.npz`: what is written comes back, and broken files are refused before they are unpacked."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.bundle import vocabulary
from kinegraph.bundle.reader import read_bundle
from kinegraph.bundle.strict_json import to_plain
from kinegraph.bundle.vocabulary import Facts, Phrase, Vocabulary, read_vocabulary, sentences_to_embed
from kinegraph.errors import BundleFormatError
from support.synthetic_bundle import TEXT_WIDTH, bundle_files, write_bundle
from support.vocabularies import BagEncoder, small_facts, small_vocabulary, vocabulary_file

ROWS = len(sentences_to_embed(small_facts()))


def packed(facts: object = None, embeddings: Any = None, **more: np.ndarray) -> bytes:
    """Pack arrays that need not be valid: facts as plain JSON, or as bytes."""
    text = (
        facts if isinstance(facts, bytes) else json.dumps(to_plain(small_facts()) if facts is None else facts).encode()
    )
    rows = np.ones((ROWS, 8), np.float16) if embeddings is None else embeddings
    buffer = io.BytesIO()
    np.savez_compressed(buffer, facts=np.frombuffer(text, np.uint8), embeddings=rows, **more)
    return buffer.getvalue()


def changed(**changes: object) -> dict[str, Any]:
    """Return the facts as plain JSON with other values."""
    return {**to_plain(small_facts()), **changes}


def test_what_is_packed_comes_back() -> None:
    data = vocabulary_file(TEXT_WIDTH)
    assert data == vocabulary_file(TEXT_WIDTH)
    found = read_vocabulary(data, TEXT_WIDTH)
    assert found.facts == small_facts()
    assert found.embeddings.dtype == np.float32 and not found.embeddings.flags.writeable
    np.testing.assert_allclose(np.linalg.norm(found.embeddings, axis=1), 1.0, atol=1e-6)
    assert found.wordings[:3] == ("walks", "walks forward", "raises the left hand")
    assert found.wording_phrases.tolist() == [0, 0, 1, 2, 3, 4] and found.style_rows.tolist() == [False] * 5 + [True]


def test_sentences_to_embed_are_wordings_in_their_sentence_then_the_others() -> None:
    assert sentences_to_embed(small_facts())[4:] == [
        "a person waves with the right hand", "a person walks like a giant", "a person jumps", "a person sits down",
    ]  # fmt: skip


def test_a_bundle_may_have_one_or_none(tmp_path: Path) -> None:
    assert read_bundle(write_bundle(tmp_path / "none")).vocabulary is None
    files = {**bundle_files(), vocabulary.FILE: vocabulary_file(TEXT_WIDTH)}
    found = read_bundle(write_bundle(tmp_path / "one", files)).vocabulary
    assert found is not None and found.facts == small_facts()


def test_a_broken_one_is_refused_with_the_bundle(tmp_path: Path) -> None:
    files = {**bundle_files(), vocabulary.FILE: vocabulary_file(TEXT_WIDTH + 1)}
    with pytest.raises(BundleFormatError, match=r"vocabulary\.npz: embeddings must have 12 columns, found 13"):
        read_bundle(write_bundle(tmp_path / "wide", files))


HUGE = np.zeros(vocabulary.MAX_FACTS_BYTES + 10_000, np.uint8).tobytes()
NAN, INFINITE, ZERO = (np.full((ROWS, 8), value, np.float16) for value in (np.nan, np.inf, 0.0))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"no archive", "not an npz"),
        (packed()[:-30], "not an npz"),
        (packed(extra=np.zeros(2)), "may hold"),
        (packed(HUGE), "unpacks to"),
        (packed(embeddings=np.zeros((vocabulary.MAX_ROWS + 600, 8), np.float16)), "unpacks to"),
        (packed(embeddings=np.ones((ROWS, 8), np.float32)), "must be float16"),
        (packed(embeddings=np.ones(ROWS * 8, np.float16)), "must be float16 of 2"),
        (packed(embeddings=np.ones((ROWS - 1, 8), np.float16)), f"must have {ROWS} rows"),
        (packed(embeddings=NAN), "NaN or infinity"),
        (packed(embeddings=INFINITE), "NaN or infinity"),
        (packed(embeddings=ZERO), "row of zeros"),
        (packed(b"{"), "not valid JSON"),
        (packed(b"\xff\xfe"), "not valid JSON"),
        (packed(b"[]"), "must be a JSON object"),
        (packed(changed(more=1)), "unknown key 'more'"),
        (packed({key: value for key, value in changed().items() if key != "near"}), "missing key 'near'"),
        (packed(changed(near=-0.1)), "near must be 0 to 1"),
        (packed(changed(paraphrase=1.01)), "paraphrase must be 0 to 1"),
        (packed(changed(paraphrase="high")), "paraphrase must be float"),
        (packed(changed(words=["\u0007"])), "cannot be printed"),
        (packed(changed(phrases=[])), "phrases is empty"),
        (packed(changed(phrases=[{**changed()["phrases"][0], "kind": "song"}])), "kind must be one of"),
        (packed(changed(phrases=[{**changed()["phrases"][0], "clips": -1}])), "-1 clips"),
        (packed(changed(phrases=[{**changed()["phrases"][0], "wordings": []}])), "no wording"),
        (packed(changed(phrases=[{**changed()["phrases"][0], "recognised": 1.5}])), "recognised 1.5, not 0 to 1"),
        (packed(changed(phrases=[{**changed()["phrases"][0], "recognised": "often"}])), "recognised must be float"),
    ],
)
def test_broken_files_are_refused(data: bytes, message: str) -> None:
    with pytest.raises(BundleFormatError, match=rf"vocabulary\.npz.*{message}"):
        read_vocabulary(data, 8)


@pytest.mark.parametrize(
    ("field", "values", "most"),
    [
        ("words", ("a",), vocabulary.MAX_WORDS),
        ("combinations", ("a .",), vocabulary.MAX_COMBINATIONS),
        ("phrases", (small_facts().phrases[0],), vocabulary.MAX_PHRASES),
    ],
)
def test_more_than_allowed_is_refused(field: str, values: tuple[Any, ...], most: int) -> None:
    facts = replace(small_facts(), **{field: values * (most + 1)})
    with pytest.raises(BundleFormatError, match=f"{field} has {most + 1} entries; {most} are allowed"):
        Vocabulary(facts, np.ones((1, 8), np.float32))


def test_more_wordings_than_rows_are_refused() -> None:
    phrase = Phrase("walk", "action", 1, "a person walks", ("walks",) * (vocabulary.MAX_ROWS + 1))
    with pytest.raises(BundleFormatError, match=f"wordings; {vocabulary.MAX_ROWS} are allowed"):
        Vocabulary(replace(small_facts(), phrases=(phrase,)), np.ones((1, 8), np.float32))


def test_a_pickle_is_not_opened(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[object, ...]:
            return Path.touch, (tmp_path / "executed",)

    trap = np.empty((ROWS, 8), dtype=object)
    trap[:] = Trap()
    with pytest.raises(BundleFormatError, match=r"vocabulary\.npz"):
        read_vocabulary(packed(embeddings=trap), 8)
    assert not (tmp_path / "executed").exists()


def test_a_repeated_member_is_refused() -> None:
    buffer = io.BytesIO(vocabulary_file(8))
    with zipfile.ZipFile(buffer, "a") as archive, pytest.warns(UserWarning, match="Duplicate"):
        archive.writestr("facts.npy", b"another one")
    with pytest.raises(BundleFormatError, match="more than once"):
        read_vocabulary(buffer.getvalue(), 8)


def test_the_small_vocabulary_of_the_tests_holds_together() -> None:
    encoder = BagEncoder()
    known = small_vocabulary(encoder)
    assert "walk forward" in known.combinations and "rais hand" in known.combinations
    assert isinstance(known.facts, Facts) and encoder.asked == []
