"""A made TMR in its published layout, with random weights, on torch's own layers; a made DistilBERT folder."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from safetensors.torch import save_file
from torch import Tensor, nn

from kinegraph_export.official.distilbert import read_tokenizer
from support.official import randomise

WORDS = (
    "[PAD]",
    "[UNK]",
    "[CLS]",
    "[SEP]",
    "a",
    "person",
    "walk",
    "##s",
    "forward",
    "turn",
    "left",
    "x",
    "in",
    "circle",
)
WIDTH, FEED_FORWARD, LAYERS, HEADS, POSITIONS = 24, 40, 1, 4, 64
"""Of the made DistilBERT."""
EMBEDDING = 16


class TorchSequenceEncoder(nn.Module):
    """Two tokens and a projected sequence, sines, and torch's own encoder; the first token's output."""

    def __init__(self, features: int, width: int = EMBEDDING, layers: int = 1, tokens: int = 2) -> None:
        super().__init__()
        self.projection = nn.Linear(features, width)
        self.tokens = nn.Parameter(torch.zeros(tokens, width))
        layer = nn.TransformerEncoderLayer(width, HEADS, 2 * width, activation="gelu", batch_first=True)
        self.seqTransEncoder = nn.TransformerEncoder(layer, layers, enable_nested_tensor=False)

    def forward(self, x: Tensor, lengths: Sequence[int]) -> Tensor:
        rows = []
        for row, length in zip(x, lengths, strict=True):  # one by one: nothing is padded
            sequence = torch.cat([self.tokens, self.projection(row[:length])])
            width = sequence.shape[1]
            for place in range(len(sequence)):
                for pair in range(width // 2):
                    angle = place / math.pow(10_000, 2 * pair / width)
                    sequence[place, 2 * pair] += math.sin(angle)
                    sequence[place, 2 * pair + 1] += math.cos(angle)
            rows.append(self.seqTransEncoder(sequence[None])[0, 0])
        return torch.stack(rows)


class TorchDistilBert(nn.Module):
    """DistilBERT on torch's own layers, from weights under their published names."""

    def __init__(self, tensors: Mapping[str, Tensor]) -> None:
        super().__init__()
        self.tensors = {name.removeprefix("distilbert."): value for name, value in tensors.items()}
        self.layers = nn.ModuleList(self.layer(number) for number in range(LAYERS))

    def layer(self, number: int) -> nn.Module:
        layer = nn.TransformerEncoderLayer(
            WIDTH, HEADS, FEED_FORWARD, activation="gelu", batch_first=True, layer_norm_eps=1e-12
        )
        start = f"transformer.layer.{number}."
        state = {}
        for kind in ("weight", "bias"):
            parts = [self.tensors[f"{start}attention.{part}_lin.{kind}"] for part in ("q", "k", "v")]
            state[f"self_attn.in_proj_{kind}"] = torch.cat(parts)
            for theirs, ours in (("attention.out_lin", "self_attn.out_proj"), ("ffn.lin1", "linear1"),
                                 ("ffn.lin2", "linear2"), ("sa_layer_norm", "norm1"),
                                 ("output_layer_norm", "norm2")):  # fmt: skip
                state[f"{ours}.{kind}"] = self.tensors[f"{start}{theirs}.{kind}"]
        layer.load_state_dict(state)
        return layer

    def forward(self, ids: Tensor) -> Tensor:
        """States of one caption (t,): (t, d)."""
        names = ("word_embeddings.weight", "position_embeddings.weight", "LayerNorm.weight", "LayerNorm.bias")
        table = {name: self.tensors[f"embeddings.{name}"] for name in names}
        words = table["word_embeddings.weight"][ids] + table["position_embeddings.weight"][: len(ids)]
        x = nn.functional.layer_norm(words, (WIDTH,), table["LayerNorm.weight"], table["LayerNorm.bias"], 1e-12)[None]
        for layer in self.layers:
            x = layer(x)
        return x[0]


def distilbert_tensors(width: int = WIDTH) -> dict[str, Tensor]:
    """A small DistilBERT with random weights under its published names, with its head and its table of places."""
    generator = torch.Generator().manual_seed(8)

    def draw(*shape: int) -> Tensor:
        return torch.randn(shape, generator=generator) / math.sqrt(shape[-1])

    tensors = {
        "embeddings.word_embeddings.weight": draw(len(WORDS), width),
        "embeddings.position_embeddings.weight": draw(POSITIONS, width),
        "vocab_transform.weight": draw(width, width),
        "embeddings.position_ids": torch.arange(POSITIONS)[None],
    }
    shapes = {f"attention.{part}_lin": (width, width) for part in ("q", "k", "v", "out")}
    shapes |= {"ffn.lin1": (FEED_FORWARD, width), "ffn.lin2": (width, FEED_FORWARD)}
    norms = ["embeddings.LayerNorm"]
    for number in range(LAYERS):
        start = f"transformer.layer.{number}"
        for name, shape in shapes.items():
            tensors |= {f"{start}.{name}.weight": draw(*shape), f"{start}.{name}.bias": 0.1 * draw(shape[0])}
        norms += [f"{start}.sa_layer_norm", f"{start}.output_layer_norm"]
    for name in norms:
        tensors |= {f"{name}.weight": 1 + 0.1 * draw(width), f"{name}.bias": 0.1 * draw(width)}
    head = ("vocab_transform",)
    return {name if name.startswith(head) else f"distilbert.{name}": value for name, value in tensors.items()}


def write_distilbert(folder: Path, width: int = WIDTH) -> Path:
    """Write a folder in the layout of distilbert-base-uncased."""
    folder.mkdir(parents=True)
    (folder / "vocab.txt").write_text("\n".join(WORDS) + "\n")
    (folder / "config.json").write_text(json.dumps({"n_heads": HEADS, "activation": "gelu", "dim": width}))
    save_file(distilbert_tensors(width), folder / "model.safetensors")
    return folder


def tmr_encoders(features: int = 263, width: int = WIDTH) -> dict[str, nn.Module]:
    """Both encoders with random weights."""
    parts = {"motion_encoder": TorchSequenceEncoder(features), "text_encoder": TorchSequenceEncoder(width, layers=2)}
    return {name: randomise(module, seed).eval() for seed, (name, module) in enumerate(parts.items())}


def write_tmr(folder: Path, encoders: Mapping[str, nn.Module]) -> Path:
    """Write a checkpoint as the trainer does, the decoder's weights included."""
    state = {
        f"{part}.{name}": value for part, module in encoders.items() for name, value in module.state_dict().items()
    }
    folder.mkdir(parents=True, exist_ok=True)
    decoder = {"motion_decoder.final_layer.bias": torch.zeros(3)}
    torch.save({"epoch": 499, "state_dict": {**state, **decoder}}, folder / "last.ckpt")
    return folder / "last.ckpt"


def write_split_tmr(folder: Path, encoders: Mapping[str, nn.Module]) -> Path:
    """Write the published folder, in which every part has its file."""
    (folder / "last_weights").mkdir(parents=True)
    for part, module in encoders.items():
        torch.save(module.state_dict(), folder / "last_weights" / f"{part}.pt")
    torch.save({"final_layer.bias": torch.zeros(3)}, folder / "last_weights" / "motion_decoder.pt")
    return folder


def write_tmr_stats(folder: Path, features: int = 263) -> Path:
    """Write mean.pt and std.pt."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.Generator(np.random.PCG64(6))
    torch.save(torch.from_numpy(rng.normal(0.0, 0.1, features)).float(), folder / "mean.pt")
    torch.save(torch.from_numpy(rng.uniform(0.05, 0.2, features)).float(), folder / "std.pt")
    return folder


def write_tmr_graphs(folder: Path, width: int = 8) -> Path:
    """Write graphs with the inputs of imported ones, which take the mean of frames and of words, and a tokenizer."""
    folder.mkdir(parents=True)
    rng = np.random.Generator(np.random.PCG64(7))
    shapes = {"motion": (263, width), "text": (len(WORDS), width)}
    inputs = {
        "motion": {"features": (TensorProto.FLOAT, ("B", "L", 263)), "lengths": (TensorProto.INT64, ("B",))},
        "text": dict.fromkeys(("input_ids", "attention_mask"), (TensorProto.INT64, ("B", "T"))),
    }
    for name, shape in shapes.items():
        operator, names = ("MatMul", ["features", "W"]) if name == "motion" else ("Gather", ["W", "input_ids"])
        weights = [
            numpy_helper.from_array(rng.standard_normal(shape).astype(np.float32), "W"),
            numpy_helper.from_array(np.array([1]), "axes"),
        ]
        nodes = [
            helper.make_node(operator, names, ["rows"]),
            helper.make_node("ReduceMean", ["rows", "axes"], ["vector"], keepdims=0),
        ]
        infos = [helper.make_tensor_value_info(key, kind, axes) for key, (kind, axes) in inputs[name].items()]
        output = helper.make_tensor_value_info("vector", TensorProto.FLOAT, ("B", width))
        graph = helper.make_graph(nodes, name, infos, [output], weights)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)])
        model.ir_version = 10
        onnx.save(model, folder / f"{name}.onnx")
    (folder / "tokenizer.json").write_bytes(read_tokenizer(write_distilbert(folder / "distilbert"), len(WORDS)))
    return folder
