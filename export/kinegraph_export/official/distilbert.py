"""DistilBERT (Sanh et al., 2019) with the parameter names of Hugging Face's checkpoints: the words that TMR reads.

b captions, t word pieces, d width.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import torch
from tokenizers import Tokenizer
from tokenizers.implementations import BertWordPieceTokenizer
from torch import Tensor, nn
from torch.nn import functional

from kinegraph.bundle.contract import PADDING_BIAS
from kinegraph.errors import InvalidInputError
from kinegraph.validation import short_repr
from kinegraph_export.model_folder import find_weights, read_settings
from kinegraph_export.self_attention import NamedSelfAttention
from kinegraph_export.tensor_files import load_weights, read_tensors

MODEL: Final = "distilbert-base-uncased"
PARTS: Final = ("distilbert", "embeddings", "transformer")
"""First parts of its names; the rest is the head that it was trained with."""
BEGIN, END = "[CLS]", "[SEP]"
PROJECTIONS: Final = ("q_lin", "k_lin", "v_lin", "out_lin")
"""Of self-attention, in checkpoints."""
EPSILON: Final = 1e-12
HEAD_WIDTH: Final = 64
"""Of the published model; for configurations that leave out the number of heads."""


@dataclass(frozen=True)
class DistilBertConfig:
    """Shape of the network."""

    vocabulary: int
    positions: int
    width: int
    layers: int
    heads: int
    feed_forward: int


class DistilBertLayer(nn.Module):
    """Self-attention and feed-forward (exact GELU), each added and then normalised."""

    def __init__(self, config: DistilBertConfig) -> None:
        super().__init__()
        width = config.width
        self.attention = NamedSelfAttention(width, config.heads, PROJECTIONS)
        self.sa_layer_norm = nn.LayerNorm(width, eps=EPSILON)
        self.ffn = nn.ModuleDict(
            {"lin1": nn.Linear(width, config.feed_forward), "lin2": nn.Linear(config.feed_forward, width)}
        )
        self.output_layer_norm = nn.LayerNorm(width, eps=EPSILON)

    def forward(self, x: Tensor, bias: Tensor) -> Tensor:
        x = self.sa_layer_norm(x + self.attention(x, bias))
        return self.output_layer_norm(x + self.ffn["lin2"](functional.gelu(self.ffn["lin1"](x))))


class DistilBert(nn.Module):
    """Encoder of captions: the state of every word piece."""

    def __init__(self, config: DistilBertConfig) -> None:
        super().__init__()
        self.config = config
        self.embeddings = nn.ModuleDict(
            {
                "word_embeddings": nn.Embedding(config.vocabulary, config.width),
                "position_embeddings": nn.Embedding(config.positions, config.width),
                "LayerNorm": nn.LayerNorm(config.width, eps=EPSILON),
            }
        )
        self.transformer = nn.ModuleDict(
            {"layer": nn.ModuleList(DistilBertLayer(config) for _ in range(config.layers))}
        )

    def forward(self, input_ids: Tensor, attention_mask: Tensor) -> Tensor:
        """Encode ids (b, t) with a mask (b, t), 1 on word pieces: states (b, t, d)."""
        position = torch.cumsum(torch.ones_like(input_ids), dim=1) - 1
        parts = self.embeddings
        x: Tensor = parts["LayerNorm"](parts["word_embeddings"](input_ids) + parts["position_embeddings"](position))
        bias = ((1.0 - attention_mask.to(x.dtype)) * PADDING_BIAS)[:, None, None, :]
        for layer in self.transformer["layer"]:
            x = layer(x, bias)
        return x


def load_distilbert(folder: Path) -> DistilBert:
    """Load the network of a folder in Hugging Face's layout.

    Raises:
        InvalidInputError: files are missing, or of another kind of model; says which.
    """
    tensors = {
        name.removeprefix("distilbert."): value
        for name, value in read_tensors(find_weights(folder, MODEL), PARTS).items()
        if not name.endswith("position_ids")  # a table of 0 to 511 that older files hold
    }
    model = DistilBert(read_config(folder, tensors))
    load_weights({"": model}, tensors, "DistilBERT")
    return model


def read_config(folder: Path, tensors: Mapping[str, Tensor]) -> DistilBertConfig:
    """Read the shape off the tensors, and off config.json what they do not tell.

    Raises:
        InvalidInputError: no DistilBERT, heads that do not divide its width, or another activation.
    """
    names = ("embeddings.word_embeddings", "embeddings.position_embeddings", "transformer.layer.0.ffn.lin1")
    for name in names:
        if f"{name}.weight" not in tensors or tensors[f"{name}.weight"].ndim != 2:
            raise InvalidInputError(f"{folder} is no DistilBERT: it has no {name}.weight; take {MODEL}")
    (vocabulary, width), (positions, _), (feed_forward, _) = (tensors[f"{name}.weight"].shape for name in names)
    settings = read_settings(folder)
    activation, heads = settings.get("activation", "gelu"), settings.get("n_heads", width // HEAD_WIDTH)
    if activation != "gelu":
        raise InvalidInputError(f"{folder}: activation {short_repr(activation)} is not gelu; take {MODEL}")
    if not isinstance(heads, int) or heads < 1 or width % heads:
        raise InvalidInputError(f"{folder}: {short_repr(heads)} heads do not divide the width {width}")
    layers = len({name.split(".")[2] for name in tensors if name.startswith("transformer.layer.")})
    return DistilBertConfig(vocabulary, positions, width, layers, heads, feed_forward)


def read_tokenizer(folder: Path, vocabulary: int) -> bytes:
    """Read the folder's word piece tokenizer as the JSON of the package `tokenizers`.

    Args:
        folder: with tokenizer.json, or vocab.txt.
        vocabulary: ids that the network knows.

    Raises:
        InvalidInputError: it is missing, not DistilBERT's, or of another vocabulary.
    """
    try:
        if (folder / "tokenizer.json").is_file():
            tokenizer = Tokenizer.from_str((folder / "tokenizer.json").read_text(encoding="utf-8"))
        else:
            built = BertWordPieceTokenizer(str(folder / "vocab.txt"), lowercase=True)
            tokenizer = Tokenizer.from_str(built.to_str())
    except Exception as error:
        raise InvalidInputError(f"{folder} has no readable tokenizer (tokenizer.json, vocab.txt): {error}") from error
    tokenizer.no_truncation()
    tokenizer.no_padding()
    tokens = tokenizer.encode("a").tokens
    if len(tokens) != 3 or tokens[0] != BEGIN or tokens[-1] != END:
        raise InvalidInputError(f"the tokenizer of {folder} does not put {BEGIN} and {END} around a word: not BERT's")
    if tokenizer.get_vocab_size() > vocabulary:
        raise InvalidInputError(
            f"the tokenizer of {folder} has {tokenizer.get_vocab_size()} tokens, its weights {vocabulary}: the files "
            "are of different models"
        )
    return tokenizer.to_str().encode()
