"""CLIP's text tower from a Hugging Face folder: official numbers, byte pairs with offsets, files that do not fit."""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

import onnxruntime

from kinegraph.errors import InvalidInputError
from kinegraph.text.tokenizer import CaptionTokenizer, span_mask
from kinegraph_export.clip_text_encoder import (
    TEXT_PARTS,
    ClipText,
    encode_empty,
    export_clip,
    load_clip,
    read_config,
    read_tokenizer,
    trace_clip,
)
from kinegraph_export.onnx_export import serialise
from kinegraph_export.tensor_files import load_weights, read_tensors
from support.official import BEGIN, END, MERGES, TEXT_WIDTH, write_clip
from support.shared import shared_path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_clip(tmp_path_factory.mktemp("clip") / "clip")


@pytest.fixture(scope="module")
def tokenizer(folder: Path) -> CaptionTokenizer:
    return CaptionTokenizer(read_tokenizer(folder, len(json.loads((folder / "vocab.json").read_text()))), 77)


@pytest.fixture(scope="module")
def official() -> tuple[ClipText, dict[str, np.ndarray]]:
    """The small official tower, whose text feature is narrower than its states."""
    tensors = read_tensors(shared_path("fixtures", "official", "clip_tiny.weights.safetensors"), TEXT_PARTS)
    with np.load(shared_path("fixtures", "official", "clip_tiny.npz"), allow_pickle=False) as pack:
        expected = dict(pack)
    config = {"num_attention_heads": int(expected["heads"][0])}
    model = ClipText(read_config_of(tensors, config))
    load_weights({"": model}, tensors, "CLIP")
    return model, expected


def read_config_of(tensors: dict[str, torch.Tensor], settings: dict[str, int]) -> object:
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "config.json").write_text(json.dumps({"text_config": settings}))
        return read_config(Path(folder), tensors)


def test_equals_the_official_tower_cut_at_the_end_token(official: tuple[ClipText, dict[str, np.ndarray]]) -> None:
    model, expected = official
    session = onnxruntime.InferenceSession(serialise(trace_clip(model)))
    ids = expected["input_ids"]
    for row, caption in enumerate(ids):
        length = int((caption == caption.max()).argmax()) + 1
        inputs = {"input_ids": caption[None, :length], "attention_mask": np.ones((1, length), dtype=np.int64)}
        hidden, pooled = session.run(["hidden", "pooled"], inputs)
        np.testing.assert_allclose(hidden[0], expected["last_hidden_state"][row, :length], rtol=0, atol=2e-5)
        np.testing.assert_allclose(pooled[0], expected["text_features"][row], rtol=0, atol=2e-5)
    lengths = (ids == ids.max(axis=1, keepdims=True)).argmax(axis=1) + 1
    mask = (np.arange(ids.shape[1]) < lengths[:, None]).astype(np.int64)
    (pooled,) = session.run(["pooled"], {"input_ids": ids, "attention_mask": mask})
    np.testing.assert_allclose(pooled, expected["text_features"], rtol=0, atol=2e-5)


def test_the_empty_caption_has_states_behind_its_end(folder: Path) -> None:
    model = load_clip(folder)
    states = encode_empty(model)
    assert states.shape == (78, TEXT_WIDTH)
    ids = torch.full((1, 77), model.config.vocabulary - 1)
    ids[0, 0] = model.config.vocabulary - 2
    with torch.no_grad():
        hidden, _ = model(ids, torch.ones_like(ids))
    np.testing.assert_allclose(states[1:], hidden[0], atol=1e-5)
    # the text feature is that of position 1, the first end token
    np.testing.assert_allclose(states[0], model.text_projection(hidden[0, 1]).detach(), atol=1e-5)


def test_byte_pairs_have_the_characters_of_the_caption(tokenizer: CaptionTokenizer) -> None:
    caption = "The person  WALKS on, naïvely!"
    tokens = tokenizer.encode(caption)
    names = [tokenizer._tokenizer.id_to_token(int(number)) for number in tokens.ids]
    assert names[0] == BEGIN
    assert names[-1] == END
    assert "the</w>" in names
    assert "walks</w>" in names
    start = caption.index("WALKS")
    pieces = np.flatnonzero(span_mask(tokens.offsets, start, start + 5))
    assert [names[piece] for piece in pieces] == ["walks</w>"]
    start = caption.index("naïvely")
    pieces = np.flatnonzero(span_mask(tokens.offsets, start, start + 7))
    assert len(pieces) > 7  # ï has two bytes
    assert tokens.offsets[pieces[0], 0] == start
    assert tokens.offsets[pieces[-1], 1] == start + 7
    assert not span_mask(tokens.offsets, 0, len(caption))[[0, -1]].any()


def test_longer_captions_are_refused_rather_than_cut(tokenizer: CaptionTokenizer) -> None:
    assert len(tokenizer.encode("the " * 75).ids) == 77
    with pytest.raises(InvalidInputError, match="makes 78 word pieces, at most 77"):
        tokenizer.encode("the " * 76)


def test_tokenizer_json_and_its_sources_agree(folder: Path, tokenizer: CaptionTokenizer, tmp_path: Path) -> None:
    vocabulary = len(json.loads((folder / "vocab.json").read_text()))
    copy = tmp_path / "clip"
    shutil.copytree(folder, copy)
    (copy / "tokenizer.json").write_bytes(read_tokenizer(folder, vocabulary))
    for name in ("vocab.json", "merges.txt"):
        (copy / name).unlink()
    again = CaptionTokenizer(read_tokenizer(copy, vocabulary))
    for caption in ("the person walks", "A b's  c\n"):
        assert again.encode(caption).ids.tolist() == tokenizer.encode(caption).ids.tolist()


def test_int8_stays_near(folder: Path) -> None:
    assets = export_clip(load_clip(folder), folder, precision="int8")
    assert assets.parity["text_encoder"] <= 1e-4
    assert assets.parity["int8_text_encoder"] <= 0.05
    assert assets.positions == 77
    session = onnxruntime.InferenceSession(assets.text_encoder)
    assert [output.name for output in session.get_outputs()] == ["hidden", "pooled"]


def test_torch_weights_are_read_without_running_code(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "clip"
    shutil.copytree(folder, copy)
    tensors = read_tensors(copy / "model.safetensors", TEXT_PARTS)
    (copy / "model.safetensors").unlink()
    torch.save({**tensors, "text_model.embeddings.position_ids": torch.arange(77)[None]}, copy / "pytorch_model.bin")
    ours, theirs = load_clip(copy).state_dict(), load_clip(folder).state_dict()
    assert all(torch.equal(ours[name], theirs[name]) for name in theirs)


def test_folders_that_do_not_fit(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="is no folder"):
        load_clip(tmp_path / "absent")
    copy = tmp_path / "clip"
    shutil.copytree(folder, copy)
    (copy / "model.safetensors").unlink()
    with pytest.raises(InvalidInputError, match=r"none of model\.safetensors, pytorch_model\.bin"):
        load_clip(copy)
    with pytest.raises(InvalidInputError, match="40 wide and the states 48"):
        load_clip(write_clip(tmp_path / "narrow", width=48, projection=40))
    with pytest.raises(InvalidInputError, match="hidden_act 'relu' is none of"):
        load_clip(write_clip(tmp_path / "other", hidden_act="relu"))
    with pytest.raises(InvalidInputError, match="different models"):
        read_tokenizer(folder, 49408)
    (copy / "merges.txt").unlink()
    with pytest.raises(InvalidInputError, match="no readable tokenizer"):
        read_tokenizer(copy, 525)
    assert len(MERGES) == 11
