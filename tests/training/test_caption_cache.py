"""Captions encoded for training: caching, several processes, and masked verbs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("spacy")

from kinegraph.bundle.reader import text_files_folder
from kinegraph_training.data import caption_cache
from kinegraph_training.data.caption_cache import CaptionEncoder, encode_graphs

ASSETS = text_files_folder()
CAPTIONS = ["a person walks and turns left", "someone bows", "a person runs and turns left"]


def test_what_was_encoded_is_read_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = tmp_path / "captions.npz"
    first = encode_graphs(CAPTIONS, ASSETS, cache)
    monkeypatch.setattr(caption_cache, "CaptionEncoder", lambda folder: pytest.fail("encoded again"))
    again = encode_graphs([*CAPTIONS, CAPTIONS[0]], ASSETS, cache)
    for caption in CAPTIONS:
        np.testing.assert_array_equal(again.get(caption).nodes, first.get(caption).nodes)
        np.testing.assert_array_equal(again.get(caption).relation, first.get(caption).relation)


def test_only_what_is_new_is_encoded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache, encoded = tmp_path / "captions.npz", []
    whole = encode_graphs(CAPTIONS, ASSETS, tmp_path / "whole.npz")
    encode_graphs(CAPTIONS[:2], ASSETS, cache)

    def noted(assets: Path, verbs_masked: bool, captions: list[str], encode: Any = caption_cache._encode_chunk) -> Any:
        encoded.extend(captions)
        return encode(assets, verbs_masked, captions)

    monkeypatch.setattr(caption_cache, "_encode_chunk", noted)
    both = encode_graphs(CAPTIONS, ASSETS, cache)
    fewer = encode_graphs(CAPTIONS[1:], ASSETS, cache)
    assert encoded == CAPTIONS[2:]
    assert set(fewer.captions) == set(CAPTIONS[1:])
    for encoded_graphs, captions in ((both, CAPTIONS), (fewer, CAPTIONS[1:])):
        for caption in captions:
            for name, value in vars(whole.get(caption)).items():
                np.testing.assert_array_equal(getattr(encoded_graphs.get(caption), name), value)


def test_what_other_assets_encoded_is_encoded_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = tmp_path / "captions.npz"
    encode_graphs(CAPTIONS, ASSETS, cache)
    assets = {**caption_cache.read_assets(ASSETS), "parser.bin": b"another parser"}
    monkeypatch.setattr(caption_cache, "read_assets", lambda folder: assets)
    monkeypatch.setattr(caption_cache, "_encode_chunk", lambda *_: pytest.fail("encoded again"))
    with pytest.raises(pytest.fail.Exception, match="encoded again"):
        encode_graphs(CAPTIONS, ASSETS, cache)


def test_several_processes_encode_what_one_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    alone = encode_graphs(CAPTIONS, ASSETS, tmp_path / "alone.npz")
    monkeypatch.setattr(caption_cache, "CHUNK", 2)
    monkeypatch.setattr(caption_cache, "available_cpus", lambda: 2)
    together = encode_graphs(CAPTIONS, ASSETS, tmp_path / "together.npz")
    for caption in CAPTIONS:
        np.testing.assert_array_equal(together.get(caption).nodes, alone.get(caption).nodes)
        np.testing.assert_array_equal(together.get(caption).relation, alone.get(caption).relation)


def test_masked_captions_keep_their_graph_and_tell_no_verb(tmp_path: Path) -> None:
    whole = encode_graphs(CAPTIONS, ASSETS, tmp_path / "whole.npz")
    masked = encode_graphs(CAPTIONS, ASSETS, tmp_path / "masked.npz", verbs_masked=True)
    for caption in CAPTIONS:
        np.testing.assert_array_equal(masked.get(caption).relation, whole.get(caption).relation)
        assert np.abs(masked.get(caption).nodes - whole.get(caption).nodes).max() > 0.1
    # two captions that differ in a verb alone are the same without verbs
    walks, runs = (masked.get(CAPTIONS[index]).nodes for index in (0, 2))
    np.testing.assert_array_equal(walks, runs)
    direct = CaptionEncoder(ASSETS).encode(CAPTIONS[0]).nodes
    np.testing.assert_allclose(whole.get(CAPTIONS[0]).nodes, direct, atol=2e-3)  # kept as float16


def test_a_cache_of_0_7_0_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = tmp_path / "captions.npz"
    new = encode_graphs(CAPTIONS, ASSETS, cache)
    arrays = {name: np.array(getattr(new, name)) for name in ("offsets", "nodes", "kind", "order", "owner", "relation")}
    with np.load(cache) as stored:
        np.savez(tmp_path / "old.npz", origin=stored["origin"], captions=np.array(list(new.captions)), **arrays)
    monkeypatch.setattr(caption_cache, "CaptionEncoder", lambda folder: pytest.fail("encoded again"))
    old = encode_graphs(CAPTIONS, ASSETS, tmp_path / "old.npz")
    for caption in CAPTIONS:
        for name, value in vars(new.get(caption)).items():
            np.testing.assert_array_equal(getattr(old.get(caption), name), value)


def test_arrays_are_mapped_and_captions_take_their_own_length(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    captions = ["a person bows", "a person's café — très long: " + "and bows again " * 8, "ein Mensch grüßt"]
    cache = tmp_path / "captions.npz"
    graphs = encode_graphs(captions, ASSETS, cache)
    assert all(isinstance(getattr(graphs, name), np.memmap) for name in caption_cache._STORED)
    assert cache.stat().st_size < 2000 + sum(map(len, captions))
    monkeypatch.setattr(caption_cache, "CaptionEncoder", lambda folder: pytest.fail("encoded again"))
    assert list(encode_graphs(captions, ASSETS, cache).captions) == sorted(captions)
    # an array of another size belongs to other captions
    caption_cache.array_file(cache, "kind").write_bytes(b"\0\0")
    with pytest.raises(pytest.fail.Exception, match="encoded again"):
        encode_graphs(captions, ASSETS, cache)
    assert list(encode_graphs([], ASSETS, tmp_path / "none.npz").captions) == []
