"""The bytes of a manifest: any input gives a manifest or a bundle error."""

from __future__ import annotations

import json
import random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinegraph.bundle.manifest import decode_manifest, encode_manifest, seal
from kinegraph.errors import BundleError, BundleFormatError, BundleIntegrityError
from support.manifests import ALL_PATHS, changed
from support.synthetic_bundle import bundle_files, manifest_for, sealed


@pytest.mark.parametrize("token", ["NaN", "Infinity", "-Infinity", "1e999", "1" + "0" * 400])
def test_numbers_must_be_finite(token: str) -> None:
    body = json.dumps(changed(("schedule", "beta_end"), "HERE"), indent=1).replace('"HERE"', token)
    with pytest.raises(BundleFormatError):
        decode_manifest(seal(body.removesuffix("\n}").encode()))


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"[1",
        b"[]",
        b"null",
        b'{"name": 1, "name": 2',
        b'{"\xff": 1',
        b"[" * 100_000,
        b'{"a": ' * 100_000,
    ],
    ids=["empty", "cut", "list", "null", "repeated", "not utf-8", "deep list", "deep object"],
)
def test_text_that_is_no_object_is_refused(body: bytes) -> None:
    with pytest.raises(BundleFormatError, match=r"manifest\.json"):
        decode_manifest(seal(body))


def test_a_flipped_bit_anywhere_is_noticed() -> None:
    data = encode_manifest(manifest_for(bundle_files()))
    generator = random.Random(20)
    for _ in range(400):
        position = generator.randrange(len(data))
        flipped = bytearray(data)
        flipped[position] ^= 1 << generator.randrange(8)
        with pytest.raises(BundleIntegrityError, match=r"manifest\.json"):
            decode_manifest(bytes(flipped))


@pytest.mark.parametrize("size", [0, 1, 50, 100, 1000])
def test_a_cut_manifest_is_noticed(size: int) -> None:
    with pytest.raises(BundleIntegrityError):
        decode_manifest(encode_manifest(manifest_for(bundle_files()))[:size])


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(ALL_PATHS), JSON)
def test_any_json_anywhere_gives_a_manifest_or_a_bundle_error(path: tuple[Any, ...], value: object) -> None:
    try:
        manifest = decode_manifest(sealed(changed(path, value)))
    except BundleError:
        return
    assert manifest.contracts
    assert decode_manifest(encode_manifest(manifest)) == manifest


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_give_a_bundle_error(data: bytes) -> None:
    with pytest.raises(BundleError):
        decode_manifest(data)
    with pytest.raises(BundleError):
        decode_manifest(seal(data))
