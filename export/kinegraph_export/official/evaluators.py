"""The evaluators of Guo et al. (2022), which the papers' columns are measured with, as ONNX.

Three networks of `text_mot_match`: a convolution over motion features (without contacts) that makes a movement of every
four frames, and two recurrent encoders that make one embedding of a sequence of movements, or of words.

The graphs are written node by node: torch exports a packed sequence only as one of a fixed length, where ONNX's GRU
takes the lengths as an input.

Shapes: b sequences, l frames, m = l // 4 movements, w words, e embedding.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper
from torch import Tensor

from kinegraph.errors import InvalidInputError
from kinegraph_export.onnx_export import OPSET, serialise

SLOPE: Final = 0.2
"""Of every leaky ReLU."""
NORM_EPSILON: Final = 1e-5
PARTS: Final[Mapping[str, tuple[str, ...]]] = {
    "movement": ("t2m_moveencoder", "movement_encoder"),
    "motion": ("t2m_motionencoder", "motion_encoder"),
    "text": ("t2m_textencoder", "text_encoder"),
}
"""Network -> its name in a checkpoint of GraphMotion or MLD, and in the evaluators' own `finest.tar`."""


@dataclass
class _Graph:
    """An ONNX graph that grows node by node."""

    nodes: list[onnx.NodeProto] = field(default_factory=list)
    weights: list[onnx.TensorProto] = field(default_factory=list)

    def add(self, operator: str, inputs: Sequence[str], output: str, **attributes: object) -> str:
        """Append a node with one output, and return its name."""
        self.nodes.append(helper.make_node(operator, list(inputs), [output], **attributes))
        return output

    def weight(self, name: str, value: np.ndarray) -> str:
        """Store a constant, and return its name."""
        self.weights.append(numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name

    def linear(self, x: str, weights: Mapping[str, np.ndarray], name: str, output: str) -> str:
        """Append x W^T + b, on the last axis."""
        product = self.add("MatMul", [x, self.weight(f"{name}.W", weights[f"{name}.weight"].T)], f"{output}_product")
        return self.add("Add", [product, self.weight(f"{name}.b", weights[f"{name}.bias"])], output)

    def serialise(self, inputs: Mapping[str, tuple[int, Sequence[str | int]]], output: Sequence[str | int]) -> bytes:
        """Close the graph, with inputs as name -> (type, axes) and the output "embedding"."""
        infos = [helper.make_tensor_value_info(name, kind, axes) for name, (kind, axes) in inputs.items()]
        result = helper.make_tensor_value_info("embedding", TensorProto.FLOAT, output)
        graph = helper.make_graph(self.nodes, "graph", infos, [result], self.weights)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="kinegraph")
        model.ir_version = 10
        return serialise(model)


def evaluator_weights(tensors: Mapping[str, Tensor], part: str) -> dict[str, np.ndarray]:
    """Pick the weights of one network out of a checkpoint.

    Args:
        tensors: by name, of `tensor_files.read_tensors`.
        part: of `PARTS`.

    Raises:
        InvalidInputError: the checkpoint has none.
    """
    for prefix in PARTS[part]:
        start = f"{prefix}."
        weights = {name.removeprefix(start): value.numpy() for name, value in tensors.items() if name.startswith(start)}
        if weights:
            return weights
    raise InvalidInputError(
        f"the checkpoint has no {' or '.join(PARTS[part])}: bring t2m/text_mot_match/model/finest.tar, or a checkpoint "
        "of GraphMotion or MLD, which holds the evaluators too"
    )


def movement_encoder(weights: Mapping[str, np.ndarray]) -> bytes:
    """Build the movement encoder: features (b, l, F) -> embedding (b, l // 4, e)."""
    graph = _Graph()
    features = _need(weights, "main.0.weight").shape[1]
    x = graph.add("Transpose", ["features"], "channels", perm=[0, 2, 1])
    for layer in ("main.0", "main.3"):
        names = [graph.weight(f"{layer}.{kind}", _need(weights, f"{layer}.{kind}")) for kind in ("weight", "bias")]
        x = graph.add("Conv", [x, *names], f"{layer}.out", kernel_shape=[4], strides=[2], pads=[1, 1])
        x = graph.add("LeakyRelu", [x], f"{layer}.active", alpha=SLOPE)
    x = graph.add("Transpose", [x], "movements", perm=[0, 2, 1])
    graph.linear(x, weights, "out_net", "embedding")
    width = _need(weights, "out_net.weight").shape[0]
    return graph.serialise({"features": (TensorProto.FLOAT, ("B", "L", features))}, ("B", "M", width))


def motion_encoder(weights: Mapping[str, np.ndarray]) -> bytes:
    """Build the motion encoder: movements (b, m, e'), lengths (b,) int32 in movements -> embedding (b, e)."""
    graph = _Graph()
    width = _need(weights, "input_emb.weight").shape[1]
    embedded = graph.linear("tokens", weights, "input_emb", "embedded")
    size = _append_recurrent(graph, weights, embedded)
    return graph.serialise(
        {"tokens": (TensorProto.FLOAT, ("B", "S", width)), "lengths": (TensorProto.INT32, ("B",))}, ("B", size)
    )


def text_encoder(weights: Mapping[str, np.ndarray]) -> bytes:
    """Build the text encoder: words (b, w, 300), tags (b, w, 15), lengths (b,) int32 in words -> embedding (b, e)."""
    graph = _Graph()
    words, tags = _need(weights, "pos_emb.weight").shape
    tagged = graph.linear("tags", weights, "pos_emb", "tag_embedding")
    both = graph.add("Add", ["tokens", tagged], "both")
    embedded = graph.linear(both, weights, "input_emb", "embedded")
    size = _append_recurrent(graph, weights, embedded)
    inputs = {
        "tokens": (TensorProto.FLOAT, ("B", "S", words)),
        "tags": (TensorProto.FLOAT, ("B", "S", tags)),
        "lengths": (TensorProto.INT32, ("B",)),
    }
    return graph.serialise(inputs, ("B", size))


def _append_recurrent(graph: _Graph, weights: Mapping[str, np.ndarray], x: str) -> int:
    """Append the bidirectional GRU and the perceptron over both last states; returns the width of the embedding.

    ONNX's GRU stacks update, reset and new gates (z, r, h), torch's reset, update and new (r, z, n).
    """

    def stacked(kind: str) -> np.ndarray:
        return np.stack([_as_zrh(_need(weights, f"gru.{kind}_l0{side}")) for side in ("", "_reverse")])

    biases = np.concatenate([stacked("bias_ih"), stacked("bias_hh")], axis=1)
    names = [graph.weight(name, value) for name, value in (("W", stacked("weight_ih")), ("R", stacked("weight_hh")))]
    hidden = _need(weights, "hidden")  # (2, 1, h), learned; the same for all sequences
    by_time = graph.add("Transpose", [x], "by_time", perm=[1, 0, 2])
    count = graph.add("Shape", ["lengths"], "count")
    ends = [graph.weight(name, np.array([value])) for name, value in (("two", 2), ("width", hidden.shape[-1]))]
    shape = graph.add("Concat", [ends[0], count, ends[1]], "state_shape", axis=0)
    initial = graph.add("Expand", [graph.weight("hidden", hidden), shape], "initial")
    inputs = [by_time, *names, graph.weight("B", biases), "lengths", initial]
    graph.nodes.append(
        helper.make_node(
            "GRU", inputs, ["", "last"], direction="bidirectional", hidden_size=hidden.shape[-1], linear_before_reset=1
        )
    )
    both = graph.add("Transpose", ["last"], "last_by_row", perm=[1, 0, 2])
    flat = graph.add("Reshape", [both, graph.weight("flat", np.array([0, -1]))], "states")
    inner = graph.linear(flat, weights, "output_net.0", "inner")
    norm = [graph.weight(f"norm.{kind}", _need(weights, f"output_net.1.{kind}")) for kind in ("weight", "bias")]
    normed = graph.add("LayerNormalization", [inner, *norm], "normed", axis=-1, epsilon=NORM_EPSILON)
    active = graph.add("LeakyRelu", [normed], "active", alpha=SLOPE)
    graph.linear(active, weights, "output_net.3", "embedding")
    return int(_need(weights, "output_net.3.weight").shape[0])


def _as_zrh(gates: np.ndarray) -> np.ndarray:
    reset, update, new = np.split(gates, 3)
    return np.concatenate([update, reset, new])


def _need(weights: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    if name not in weights:
        raise InvalidInputError(f"the evaluators lack {name}: they are another version, or the file was cut short")
    return weights[name]


BUILDERS: Final = {"movement": movement_encoder, "motion": motion_encoder, "text": text_encoder}
"""Network -> function that builds its ONNX graph from its weights."""
