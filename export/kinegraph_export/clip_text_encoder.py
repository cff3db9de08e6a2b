"""Export the text tower of CLIP (Radford et al., 2021) to ONNX from a Hugging Face folder on this disk.

    python -m kinegraph_export.clip_text_encoder --clip clip-vit-large-patch14 --out assets

The folder is that of openai/clip-vit-large-patch14 (768 wide, what GraphMotion and MLD were trained with),
openai/clip-vit-base-patch32 (512 wide) or any of their kind: config.json, model.safetensors or pytorch_model.bin, and
tokenizer.json or vocab.json with merges.txt. Nothing is downloaded, and no code of the folder is run.

Attention is causal. So a caption is cut at its end token: what stands behind it, the released code's padding to 77
positions, changes nothing before it.

b captions, t tokens, d width.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from tokenizers import Regex, Tokenizer, models, normalizers, pre_tokenizers, processors
from torch import Tensor, nn

from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import PADDING_BIAS, text_encoder
from kinegraph.errors import InvalidInputError
from kinegraph.validation import short_repr
from kinegraph_export.model_folder import find_weights, read_settings
from kinegraph_export.onnx_export import serialise, to_onnx
from kinegraph_export.parity import InputGenerator, max_difference, relative_error
from kinegraph_export.self_attention import NamedSelfAttention
from kinegraph_export.tensor_files import load_weights, read_tensors
from kinegraph_export.text_encoder import PRECISIONS, quantise_text_encoder

TEXT_PARTS = ("text_model", "text_projection")
"""First parts of the names of the text tower; the rest is the image tower."""
BEGIN, END = "<|startoftext|>", "<|endoftext|>"
HEAD_WIDTH = 64
"""Of all published towers; for configurations that leave out the number of heads."""
PROJECTIONS = ("q_proj", "k_proj", "v_proj", "out_proj")
"""Of self-attention, in checkpoints."""
_WORDS = r"""'s|'t|'re|'ve|'m|'ll|'d|[\p{L}]+|[\p{N}]|[^\s\p{L}\p{N}]+"""


@dataclass(frozen=True)
class ClipConfig:
    """Shape of a text tower."""

    vocabulary: int
    positions: int
    width: int
    layers: int
    heads: int
    feed_forward: int
    projection: int
    """Width of the text feature."""
    epsilon: float
    activation: str
    """"quick_gelu" or "gelu"."""


class QuickGelu(nn.Module):
    """x sigmoid(1.702 x), the GELU that CLIP was trained with."""

    def forward(self, x: Tensor) -> Tensor:
        return x * torch.sigmoid(1.702 * x)


ACTIVATIONS: dict[str, type[nn.Module]] = {"quick_gelu": QuickGelu, "gelu": nn.GELU}


class ClipLayer(nn.Module):
    """Pre-norm self-attention and feed-forward."""

    def __init__(self, config: ClipConfig) -> None:
        super().__init__()
        self.layer_norm1 = nn.LayerNorm(config.width, eps=config.epsilon)
        self.self_attn = NamedSelfAttention(config.width, config.heads, PROJECTIONS)
        self.layer_norm2 = nn.LayerNorm(config.width, eps=config.epsilon)
        self.mlp = nn.ModuleDict(
            {"fc1": nn.Linear(config.width, config.feed_forward), "fc2": nn.Linear(config.feed_forward, config.width)}
        )
        self.activation = ACTIVATIONS[config.activation]()

    def forward(self, x: Tensor, bias: Tensor) -> Tensor:
        x = x + self.self_attn(self.layer_norm1(x), bias)
        return x + self.mlp["fc2"](self.activation(self.mlp["fc1"](self.layer_norm2(x))))


class ClipText(nn.Module):
    """Text tower with the parameter names of Hugging Face's checkpoints."""

    def __init__(self, config: ClipConfig) -> None:
        super().__init__()
        self.config = config
        tower = nn.Module()
        tower.embeddings = nn.ModuleDict(
            {
                "token_embedding": nn.Embedding(config.vocabulary, config.width),
                "position_embedding": nn.Embedding(config.positions, config.width),
            }
        )
        tower.encoder = nn.ModuleDict({"layers": nn.ModuleList(ClipLayer(config) for _ in range(config.layers))})
        tower.final_layer_norm = nn.LayerNorm(config.width, eps=config.epsilon)
        self.text_model = tower
        self.text_projection = nn.Linear(config.width, config.projection, bias=False)

    def forward(self, input_ids: Tensor, attention_mask: Tensor) -> tuple[Tensor, Tensor]:
        """Encode captions.

        Args:
            input_ids: (b, t) begin, word pieces, end.
            attention_mask: (b, t) 1 up to the end token, 0 behind it.

        Returns:
            Hidden states (b, t, d) after the last norm, not projected; and the state of the end token, projected
            (b, p), not of length 1.
        """
        tower = self.text_model
        position = torch.cumsum(torch.ones_like(input_ids), dim=1) - 1
        x = tower.embeddings["token_embedding"](input_ids) + tower.embeddings["position_embedding"](position)
        hidden = (position[:, None, :] > position[:, :, None]) | (attention_mask[:, None, :] == 0)
        bias = hidden[:, None].to(x.dtype) * PADDING_BIAS
        for layer in tower.encoder["layers"]:
            x = layer(x, bias)
        x = tower.final_layer_norm(x)
        end = (attention_mask.sum(dim=1) - 1)[:, None, None].expand(-1, -1, x.shape[-1])
        return x, self.text_projection(torch.gather(x, 1, end)[:, 0])


def load_clip(folder: Path) -> ClipText:
    """Load the text tower of a folder.

    Raises:
        InvalidInputError: no such folder, files are missing, they are of another kind of model, or the text feature is
            not as wide as the states; says which.
    """
    weights = find_weights(folder, "openai/clip-vit-large-patch14")
    tensors = {
        name: value
        for name, value in read_tensors(weights, TEXT_PARTS).items()
        if not name.endswith("embeddings.position_ids")  # a table of 0 to 76 that older files hold
    }
    config = read_config(folder, tensors)
    if config.projection != config.width:
        raise InvalidInputError(
            f"{folder}: the text feature is {config.projection} wide and the states {config.width}; a bundle needs one "
            "width, as openai/clip-vit-large-patch14 and -base-patch32 have"
        )
    model = ClipText(config)
    load_weights({"": model}, tensors, "CLIP's text tower")
    return model


def read_config(folder: Path, tensors: dict[str, Tensor]) -> ClipConfig:
    """Read the shape of the text tower off its tensors, and off config.json what they do not tell.

    Raises:
        InvalidInputError: no CLIP, or an activation that is not CLIP's.
    """
    shapes = {
        "token": "text_model.embeddings.token_embedding.weight",
        "position": "text_model.embeddings.position_embedding.weight",
        "feed": "text_model.encoder.layers.0.mlp.fc1.weight",
        "projection": "text_projection.weight",
    }
    for name in shapes.values():
        if name not in tensors or tensors[name].ndim != 2:
            raise InvalidInputError(
                f"{folder} is not CLIP with its text projection: it has no {name}; take openai/clip-vit-large-patch14"
            )
    (vocabulary, width), (positions, _), (feed_forward, _), (projection, _) = (
        tensors[name].shape for name in shapes.values()
    )
    settings = _text_settings(folder)
    heads = int(settings.get("num_attention_heads", width // HEAD_WIDTH))
    activation = settings.get("hidden_act", "quick_gelu")
    if activation not in ACTIVATIONS:
        raise InvalidInputError(f"{folder}: hidden_act {short_repr(activation)} is none of {', '.join(ACTIVATIONS)}")
    if heads < 1 or width % heads:
        raise InvalidInputError(f"{folder}: {heads} heads do not divide the width {width}")
    layers = len({name.split(".")[3] for name in tensors if name.startswith("text_model.encoder.layers.")})
    epsilon = float(settings.get("layer_norm_eps", 1e-5))
    return ClipConfig(vocabulary, positions, width, layers, heads, feed_forward, projection, epsilon, activation)


def _text_settings(folder: Path) -> dict[str, Any]:
    content = read_settings(folder)
    settings = content.get("text_config", content)
    if not isinstance(settings, dict):
        raise InvalidInputError(f"{folder}: config.json is not CLIP's; it comes with the model's weights")
    return settings


def read_tokenizer(folder: Path, vocabulary: int) -> bytes:
    """Read the folder's byte-pair tokenizer as the JSON of the package `tokenizers`.

    Args:
        folder: with tokenizer.json, or vocab.json and merges.txt.
        vocabulary: ids that the text tower knows.

    Raises:
        InvalidInputError: it is missing, not CLIP's, or of another vocabulary.
    """
    try:
        if (folder / "tokenizer.json").is_file():
            tokenizer = Tokenizer.from_str((folder / "tokenizer.json").read_text(encoding="utf-8"))
        else:
            tokenizer = _build_tokenizer(folder / "vocab.json", folder / "merges.txt")
    except Exception as error:
        raise InvalidInputError(f"{folder} has no readable tokenizer (vocab.json, merges.txt): {error}") from error
    tokenizer.no_truncation()
    tokenizer.no_padding()
    begin, end = tokenizer.token_to_id(BEGIN), tokenizer.token_to_id(END)
    ids = tokenizer.encode("a").ids
    if len(ids) != 3 or ids[0] != begin or ids[-1] != end:
        raise InvalidInputError(f"the tokenizer of {folder} does not put {BEGIN} and {END} around a word: not CLIP's")
    if end != vocabulary - 1 or tokenizer.get_vocab_size() != vocabulary:
        raise InvalidInputError(
            f"the tokenizer of {folder} has {tokenizer.get_vocab_size()} tokens, its weights {vocabulary}: the files "
            "are of different models"
        )
    return tokenizer.to_str().encode()


def _build_tokenizer(vocabulary: Path, merges: Path) -> Tokenizer:
    """Build CLIP's tokenizer: lower case, words and signs, byte pairs with an end-of-word mark."""
    model = models.BPE.from_file(
        str(vocabulary), str(merges), unk_token=END, continuing_subword_prefix="", end_of_word_suffix="</w>"
    )
    tokenizer = Tokenizer(model)
    blank = normalizers.Replace(Regex(r"\s+"), " ")
    tokenizer.normalizer = normalizers.Sequence([normalizers.NFC(), blank, normalizers.Lowercase()])
    words = pre_tokenizers.Split(Regex(_WORDS), behavior="removed", invert=True)
    tokenizer.pre_tokenizer = pre_tokenizers.Sequence([words, pre_tokenizers.ByteLevel(add_prefix_space=False)])
    special = [(token, tokenizer.token_to_id(token)) for token in (BEGIN, END)]
    tokenizer.post_processor = processors.TemplateProcessing(single=f"{BEGIN} $A {END}", special_tokens=special)
    return tokenizer


@dataclass(frozen=True)
class ClipAssets:
    """What a bundle needs of CLIP."""

    text_encoder: bytes
    """ONNX."""
    tokenizer: bytes
    """JSON."""
    empty_caption: FloatArray
    """(1 + positions, d): sentence feature and hidden states of an empty caption, padded with end tokens."""
    positions: int
    parity: dict[str, float]


def export_clip(model: ClipText, folder: Path, *, precision: str) -> ClipAssets:
    """Export the text tower of a folder, and measure how far the graph is from it.

    Args:
        model: of `load_clip`.
        folder: of Hugging Face's files.
        precision: "fp32", or "int8" (see `text_encoder.quantise_text_encoder`).

    Raises:
        InvalidInputError: see `read_tokenizer`.
        ParityError: the graph differs from the module.
    """
    if precision not in PRECISIONS:
        raise InvalidInputError(f"precision must be {' or '.join(PRECISIONS)}, not {precision!r}")
    config, tokenizer = model.config, read_tokenizer(folder, model.config.vocabulary)
    contract, draw = text_encoder(config.width), draw_captions(config)
    graph = trace_clip(model)
    data = serialise(graph)
    parity = {contract.name: max_difference(data, model, contract, draw)}
    if precision == "int8":
        data = serialise(quantise_text_encoder(graph))
        parity[f"int8_{contract.name}"] = relative_error(data, model, contract, draw)
    return ClipAssets(data, tokenizer, encode_empty(model), config.positions, parity)


def trace_clip(model: ClipText) -> onnx.ModelProto:
    """Trace the text tower to ONNX."""
    end = model.config.vocabulary - 1
    ids = torch.tensor([[end - 1, 1, 2, end], [end - 1, 3, end, end]])
    mask = torch.tensor([[1, 1, 1, 1], [1, 1, 1, 0]])
    free = {0: torch.export.Dim.DYNAMIC, 1: torch.export.Dim.DYNAMIC}
    return to_onnx(model, (ids, mask), ["input_ids", "attention_mask"], ["hidden", "pooled"], (free, free))


def draw_captions(config: ClipConfig) -> InputGenerator:
    """Make a generator of random captions of several lengths."""

    def draw(rng: np.random.Generator) -> dict[str, np.ndarray]:
        rows, longest = int(rng.integers(1, 4)), int(rng.integers(3, min(20, config.positions) + 1))
        ids = rng.integers(0, config.vocabulary - 2, (rows, longest))
        lengths = np.minimum(rng.integers(2, longest + 1, rows), longest)
        mask = (np.arange(longest) < lengths[:, None]).astype(np.int64)
        ids[:, 0] = config.vocabulary - 2
        ids[np.arange(rows), lengths - 1] = config.vocabulary - 1
        return {"input_ids": ids, "attention_mask": mask}

    return draw


@torch.no_grad()
def encode_empty(model: ClipText) -> FloatArray:
    """Encode an empty caption at all positions, padded with end tokens as the released code does."""
    positions, end = model.config.positions, model.config.vocabulary - 1
    ids = torch.full((1, positions), end)
    ids[0, 0] = end - 1
    hidden, _ = model(ids, torch.ones_like(ids))
    # the text feature is that of the *first* end token
    _, pooled = model(ids[:, :2], torch.ones_like(ids[:, :2]))
    states: FloatArray = torch.cat([pooled, hidden[0]]).numpy()
    return states


def main(argv: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="kinegraph_export.clip_text_encoder", description=__doc__.split("\n")[0])
    parser.add_argument("--clip", type=Path, required=True, help="folder of Hugging Face's files")
    parser.add_argument("--out", type=Path, required=True, help="folder to write text_encoder.onnx, tokenizer.json to")
    parser.add_argument("--precision", choices=PRECISIONS, default="int8")
    options = parser.parse_args(argv)
    assets = export_clip(load_clip(options.clip), options.clip, precision=options.precision)
    options.out.mkdir(parents=True, exist_ok=True)
    for name, data in (("text_encoder.onnx", assets.text_encoder), ("tokenizer.json", assets.tokenizer)):
        (options.out / name).write_bytes(data)
        print(f"{len(data) / 1e6:8.2f} MB  {options.out / name}")
    for name, difference in assets.parity.items():
        print(f"{name:20s} {difference:.2e}")


if __name__ == "__main__":
    main()
