"""Leave out of an ONNX file the weights that another file of the bundle has: they are stored once.

    without_shared      graphs of one module that were exported apart: weights are equal, names need not be
    without_namesakes   a graph that was derived from another: it has all of its weights, under their names

`kinegraph.bundle.contract.WEIGHT_SOURCES` says which file has them, and the runtime adds them when it opens the graph.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable
from typing import Final

import onnx
from onnx import numpy_helper

SMALLEST: Final = 1024
"""Bytes of a tensor from which on it is shared; smaller ones stay, so that a file can be read by itself."""


def without_shared(data: bytes, source: bytes) -> bytes:
    """Leave out the initializers of a graph that are equal to one of another file, bit by bit.

    They get the name that they have there. Whatever else has a name of that file's initializers is renamed.

    Args:
        data: ONNX bytes of the graph.
        source: ONNX bytes of the file that keeps its weights.
    """
    model, other = onnx.load_model_from_string(data), onnx.load_model_from_string(source)
    graph = model.graph
    large = [tensor for tensor in other.graph.initializer if numpy_helper.to_array(tensor).nbytes >= SMALLEST]
    names_by_content = {_content(tensor): tensor.name for tensor in large}
    taken = {tensor.name for tensor in other.graph.initializer}
    own = [name for node in graph.node for name in node.output] + [tensor.name for tensor in graph.initializer]
    outside = {value.name for value in (*graph.input, *graph.output)}
    names = {name: f"own.{name}" for name in own if name in taken and name not in outside}
    shared = {
        tensor.name: names_by_content[content]
        for tensor in graph.initializer
        if (content := _content(tensor)) in names_by_content
    }
    names |= shared
    kept = [tensor for tensor in graph.initializer if tensor.name not in shared]
    for tensor in kept:
        tensor.name = names.get(tensor.name, tensor.name)
    _replace(graph.initializer, kept)
    _replace(graph.value_info, [value for value in graph.value_info if value.name not in names])
    for node in graph.node:
        _replace(node.input, [names.get(name, name) for name in node.input])
        _replace(node.output, [names.get(name, name) for name in node.output])
    return model.SerializeToString(deterministic=True)


def without_namesakes(model: onnx.ModelProto, source: onnx.ModelProto) -> bytes:
    """Serialise a graph without the initializers whose names are those of another; they must be the same tensors."""
    lean = copy.deepcopy(model)
    names = {tensor.name for tensor in source.graph.initializer}
    _replace(lean.graph.initializer, [tensor for tensor in lean.graph.initializer if tensor.name not in names])
    return lean.SerializeToString(deterministic=True)


def _content(tensor: onnx.TensorProto) -> tuple[int, tuple[int, ...], bytes]:
    """Return what makes two tensors equal: type, shape and bits."""
    return tensor.data_type, tuple(tensor.dims), numpy_helper.to_array(tensor).tobytes()


def _replace(field: object, values: Iterable[object]) -> None:
    """Set a repeated field of a protobuf message."""
    values = list(values)
    del field[:]  # type: ignore[attr-defined]
    field.extend(values)  # type: ignore[attr-defined]
