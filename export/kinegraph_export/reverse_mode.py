"""Derive the vector-Jacobian product of an exported decoder: reverse-mode differentiation of its ONNX graph.

The derived graph holds the nodes of the decoder, then for each of them, last to first, the nodes that carry the
cotangent of its output back to its input (Griewank & Walther, *Evaluating Derivatives*, 2008, section 3.2). All weights
keep their names, so a bundle need not hold them twice: `shared_weights.without_namesakes` leaves them out, and
the runtime adds those of the decoder's file (`kinegraph.bundle.onnx_inspect.with_initializers`).

Only what depends on the latent carries a cotangent, and only the operators of our decoders have a rule in `RULES`.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import onnx
from onnx import helper, numpy_helper

from kinegraph.errors import InvalidInputError

COTANGENT, GRADIENT = "cotangent", "gradient"
"""Names of the derived graph's further input, and of its output."""

MICROSOFT = "com.microsoft"
_TO_THE_END = 1 << 31
"""Ends of slices from here on mean the end of the axis."""


class Adjoint:
    """The growing graph of adjoint nodes, and the cotangent that each tensor has gathered so far."""

    def __init__(self, constants: Mapping[str, np.ndarray]) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.initializers: list[onnx.TensorProto] = []
        self.constants = constants
        """Weights and constants of the decoder that are stored as they are."""
        self.cotangents: dict[str, str] = {}
        self._count = 0

    def emit(self, operator: str, *inputs: str, outputs: int = 1, domain: str = "", **attributes: Any) -> list[str]:
        """Add a node; returns the names of its outputs."""
        self._count += 1
        names = [f"d{self._count}" if outputs == 1 else f"d{self._count}_{index}" for index in range(outputs)]
        self.nodes.append(helper.make_node(operator, inputs, names, domain=domain, **attributes))
        return names

    def one(self, operator: str, *inputs: str, **attributes: Any) -> str:
        """Add a node with one output; returns its name."""
        return self.emit(operator, *inputs, **attributes)[0]

    def constant(self, value: np.ndarray) -> str:
        """Add a constant, once for equal values; returns its name."""
        for tensor in self.initializers:
            known = numpy_helper.to_array(tensor)
            if known.dtype == value.dtype and known.shape == value.shape and np.array_equal(known, value):
                return tensor.name
        name = f"d_constant_{len(self.initializers)}"
        self.initializers.append(numpy_helper.from_array(value, name))
        return name

    def number(self, value: float) -> str:
        """Add a float constant; returns its name."""
        return self.constant(np.array(value, dtype=np.float32))

    def axes(self, *axes: int) -> str:
        """Add a list of axes or sizes; returns its name."""
        return self.constant(np.array(axes, dtype=np.int64))

    def add(self, tensor: str, cotangent: str) -> None:
        """Add to the cotangent of a tensor."""
        known = self.cotangents.get(tensor)
        self.cotangents[tensor] = cotangent if known is None else self.one("Add", known, cotangent)


Rule = Callable[[Adjoint, onnx.NodeProto, str, frozenset[str]], None]
"""(graph, node, cotangent of its output, tensors that depend on the latent): adds to the cotangents of its inputs."""


def _attributes(node: onnx.NodeProto) -> dict[str, Any]:
    return {attribute.name: helper.get_attribute_value(attribute) for attribute in node.attribute}


def _add(graph: Adjoint, node: onnx.NodeProto, cotangent: str, active: frozenset[str]) -> None:
    for name in node.input:
        if name in active:
            graph.add(name, cotangent)


def _multiply(graph: Adjoint, node: onnx.NodeProto, cotangent: str, active: frozenset[str]) -> None:
    for name, other in zip(node.input, reversed(node.input), strict=True):
        if name in active:
            graph.add(name, graph.one("Mul", cotangent, other))


def _matrix_product(graph: Adjoint, node: onnx.NodeProto, cotangent: str, active: frozenset[str]) -> None:
    """Y = A B: dA = dY B^T, dB = A^T dY."""
    left, right = node.input
    if left in active:
        graph.add(left, graph.one("FusedMatMul", cotangent, right, domain=MICROSOFT, transB=1))
    if right in active:
        graph.add(right, graph.one("FusedMatMul", left, cotangent, domain=MICROSOFT, transA=1))


def _layer_normalization(graph: Adjoint, node: onnx.NodeProto, cotangent: str, active: frozenset[str]) -> None:
    """y = w n + b with n = (x - mean) / deviation: dx = (e - mean(e) - n mean(e n)) / deviation, e = w dy."""
    x, weight, _ = node.input
    _, mean, inverse = node.output
    last = graph.axes(-1)
    normal = graph.one("Mul", graph.one("Sub", x, mean), inverse)
    scaled = graph.one("Mul", cotangent, weight)
    along = graph.one("ReduceMean", graph.one("Mul", scaled, normal), last, keepdims=1)
    centred = graph.one("Sub", scaled, graph.one("ReduceMean", scaled, last, keepdims=1))
    rest = graph.one("Sub", centred, graph.one("Mul", normal, along))
    graph.add(x, graph.one("Mul", rest, inverse))


def _gelu(graph: Adjoint, node: onnx.NodeProto, cotangent: str, active: frozenset[str]) -> None:
    """y = x P(x), P and p the distribution and density of the normal distribution: dx = (P(x) + x p(x)) dy."""
    if _attributes(node).get("approximate", b"none") != b"none":
        raise InvalidInputError("only the exact GELU has a rule")
    (x,) = node.input
    erf = graph.one("Erf", graph.one("Mul", x, graph.number(0.5**0.5)))
    distribution = graph.one("Mul", graph.one("Add", erf, graph.number(1.0)), graph.number(0.5))
    exponent = graph.one("Mul", graph.one("Mul", x, x), graph.number(-0.5))
    density = graph.one("Mul", graph.one("Exp", exponent), graph.number((2.0 * np.pi) ** -0.5))
    slope = graph.one("Add", distribution, graph.one("Mul", x, density))
    graph.add(x, graph.one("Mul", cotangent, slope))


def _softmax(graph: Adjoint, node: onnx.NodeProto, cotangent: str, active: frozenset[str]) -> None:
    """y = softmax(x): dx = y (dy - sum(dy y)), along the last axis."""
    (y,) = node.output
    inner = graph.one("ReduceSum", graph.one("Mul", cotangent, y), graph.axes(-1), keepdims=1)
    graph.add(node.input[0], graph.one("Mul", graph.one("Sub", cotangent, inner), y))


def _convolution(graph: Adjoint, node: onnx.NodeProto, cotangent: str, active: frozenset[str]) -> None:
    x, weight, _ = node.input
    kept = {key: value for key, value in _attributes(node).items() if key != "auto_pad"}
    graph.add(x, graph.one("ConvTranspose", cotangent, weight, **kept))


def _transpose(graph: Adjoint, node: onnx.NodeProto, cotangent: str, active: frozenset[str]) -> None:
    inverse = [int(axis) for axis in np.argsort(_attributes(node)["perm"])]
    graph.add(node.input[0], graph.one("Transpose", cotangent, perm=inverse))


def _reshape(graph: Adjoint, node: onnx.NodeProto, cotangent: str, active: frozenset[str]) -> None:
    graph.add(node.input[0], graph.one("Reshape", cotangent, graph.one("Shape", node.input[0])))


def _slice(graph: Adjoint, node: onnx.NodeProto, cotangent: str, active: frozenset[str]) -> None:
    """y = x[:, start:]: dx is dy behind `start` zeros."""
    start, end, axis, step = (int(graph.constants[name].item()) for name in node.input[1:])
    if (axis, step) != (1, 1) or start < 0 or end < _TO_THE_END:
        raise InvalidInputError("only slices of axis 1 to its end have a rule")
    graph.add(node.input[0], graph.one("Pad", cotangent, graph.axes(0, start, 0, 0, 0, 0)))


def _concatenation(graph: Adjoint, node: onnx.NodeProto, cotangent: str, active: frozenset[str]) -> None:
    """y = [a, b]: each gets its part of dy."""
    axis = _attributes(node)["axis"]
    first, second = node.input
    places = {"start": axis, "end": axis + 1} if axis >= 0 else {"start": axis}
    sizes = graph.one("Concat", *(graph.one("Shape", name, **places) for name in (first, second)), axis=0)
    for name, part in zip(node.input, graph.emit("Split", cotangent, sizes, outputs=2, axis=axis), strict=True):
        if name in active:
            graph.add(name, part)


RULES: dict[str, Rule] = {
    "Add": _add,
    "Mul": _multiply,
    "MatMul": _matrix_product,
    "LayerNormalization": _layer_normalization,
    "Gelu": _gelu,
    "Softmax": _softmax,
    "Conv": _convolution,
    "Transpose": _transpose,
    "Reshape": _reshape,
    "Slice": _slice,
    "Concat": _concatenation,
}
"""Operator -> its adjoint; `Split` is apart, because it has several outputs."""


def derive_gradient(decoder: onnx.ModelProto) -> onnx.ModelProto:
    """Derive the graph of a decoder's vector-Jacobian product.

    Args:
        decoder: as the bundle stores it: latent (B, C, z), frame_mask (B, L) -> features (B, L, F).

    Returns:
        latent, frame_mask, cotangent (B, L, F) of the features -> gradient (B, C, z), all weights inside.

    Raises:
        InvalidInputError: the graph has an operator without a rule.
    """
    model = copy.deepcopy(decoder)
    graph = model.graph
    constants = {tensor.name: numpy_helper.to_array(tensor) for tensor in graph.initializer}
    forward = [part for node in graph.node for part in _differentiable(node, graph)]
    latent, features = graph.input[0], graph.output[0]
    active = _depending_on(latent.name, forward)
    adjoint = Adjoint(constants)
    adjoint.add(features.name, COTANGENT)
    for node in reversed(forward):
        if not active.intersection(node.output):
            continue
        if node.op_type == "Split":
            parts = [adjoint.cotangents[name] for name in node.output]
            adjoint.add(node.input[0], adjoint.one("Concat", *parts, axis=_attributes(node)["axis"]))
        elif node.output[0] in adjoint.cotangents:
            if node.op_type not in RULES:
                raise InvalidInputError(f"{node.op_type} has no rule in reverse_mode.RULES")
            RULES[node.op_type](adjoint, node, adjoint.cotangents[node.output[0]], active)
    adjoint.nodes.append(helper.make_node("Identity", [adjoint.cotangents[latent.name]], [GRADIENT]))
    del graph.node[:]
    graph.node.extend([*forward, *adjoint.nodes])
    for node in graph.node:
        node.ClearField("name")  # a tenth of the file
    graph.initializer.extend(adjoint.initializers)
    graph.input.append(_renamed(features, COTANGENT))
    graph.output[0].CopyFrom(_renamed(latent, GRADIENT))
    if not any(opset.domain == MICROSOFT for opset in model.opset_import):
        model.opset_import.append(helper.make_opsetid(MICROSOFT, 1))
    return model


def _renamed(value: onnx.ValueInfoProto, name: str) -> onnx.ValueInfoProto:
    renamed = onnx.ValueInfoProto()
    renamed.CopyFrom(value)
    renamed.name = name
    return renamed


def _depending_on(latent: str, nodes: list[onnx.NodeProto]) -> frozenset[str]:
    """List the tensors whose values depend on the latent; shapes do not."""
    active = {latent}
    for node in nodes:
        if node.op_type != "Shape" and active.intersection(node.input):
            active.update(node.output)
    return frozenset(active)


def _differentiable(node: onnx.NodeProto, graph: onnx.GraphProto) -> list[onnx.NodeProto]:
    """Rewrite a node so that its adjoint can reach what it needs: attention in parts, statistics of a norm."""
    if node.op_type == "LayerNormalization":
        stem = node.output[0]
        del node.output[1:]
        node.output.extend([f"{stem}_mean", f"{stem}_inverse"])
        return [node]
    if node.op_type == "MultiHeadAttention":
        return _attention_in_parts(node, graph)
    return [node]


def _attention_in_parts(node: onnx.NodeProto, graph: onnx.GraphProto) -> list[onnx.NodeProto]:
    """Write fused attention as softmax(q k^T / sqrt(d/h) + bias) v with heads (b, h, s, d/h)."""
    query, key, value, *_, bias = node.input
    stem, heads = node.output[0], _attributes(node)["num_heads"]
    norm = next(other for other in graph.node if other.op_type == "LayerNormalization")  # of the same width
    width = next(tensor.dims[0] for tensor in graph.initializer if tensor.name == norm.input[1])
    shapes = {"split": [0, 0, heads, width // heads], "merge": [0, 0, width]}
    for name, shape in shapes.items():
        if not any(tensor.name == f"heads_{name}" for tensor in graph.initializer):
            graph.initializer.append(numpy_helper.from_array(np.array(shape, dtype=np.int64), f"heads_{name}"))
    scale = "heads_scale"
    if not any(tensor.name == scale for tensor in graph.initializer):
        root = np.array((width // heads) ** -0.5, dtype=np.float32)
        graph.initializer.append(numpy_helper.from_array(root, scale))
    nodes = []
    for source, name in ((query, "q"), (key, "k"), (value, "v")):
        nodes.append(helper.make_node("Reshape", [source, "heads_split"], [f"{stem}_{name}_rows"]))
        order = [0, 2, 3, 1] if name == "k" else [0, 2, 1, 3]
        nodes.append(helper.make_node("Transpose", [f"{stem}_{name}_rows"], [f"{stem}_{name}"], perm=order))
    nodes += [
        helper.make_node("MatMul", [f"{stem}_q", f"{stem}_k"], [f"{stem}_product"]),
        helper.make_node("Mul", [f"{stem}_product", scale], [f"{stem}_scaled"]),
        helper.make_node("Add", [f"{stem}_scaled", bias], [f"{stem}_logits"]),
        helper.make_node("Softmax", [f"{stem}_logits"], [f"{stem}_attention"], axis=-1),
        helper.make_node("MatMul", [f"{stem}_attention", f"{stem}_v"], [f"{stem}_mixed"]),
        helper.make_node("Transpose", [f"{stem}_mixed"], [f"{stem}_merged"], perm=[0, 2, 1, 3]),
        helper.make_node("Reshape", [f"{stem}_merged", "heads_merge"], [stem]),
    ]
    return nodes
