"""torch module -> self-contained, reproducible ONNX."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import nn

OPSET = 20
HALVED_ABOVE = 1024
"""Numbers; smaller tensors are not worth a Cast node."""


def to_onnx(
    module: nn.Module,
    example_inputs: tuple[Any, ...],
    input_names: Sequence[str],
    output_names: Sequence[str],
    dynamic_shapes: tuple[Any, ...],
) -> onnx.ModelProto:
    """Export in evaluation mode, weights inside, nothing in the file that tells of this machine.

    Args:
        module: its forward takes `example_inputs`.
        example_inputs: sample arguments; lists of tensors are flattened in order.
        input_names: of the flattened inputs.
        output_names: of the outputs.
        dynamic_shapes: free axes as torch.export wants them, nested like `example_inputs`.
    """
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            module.eval(),
            example_inputs,
            input_names=list(input_names),
            output_names=list(output_names),
            dynamic_shapes=dynamic_shapes,
            opset_version=OPSET,
            dynamo=True,
            optimize=True,
            verbose=False,
        )
    if program is None:
        raise RuntimeError("torch.onnx.export returned nothing")
    return strip_metadata(program.model_proto)


def strip_metadata(model: onnx.ModelProto) -> onnx.ModelProto:
    """Without documentation, metadata (stack traces hold local paths) and intermediate shapes."""
    del model.metadata_props[:]
    model.doc_string = ""
    model.producer_name, model.producer_version = "kinegraph", ""
    graph = model.graph
    graph.name, graph.doc_string = "graph", ""
    del graph.metadata_props[:]
    del graph.value_info[:]
    for item in [*graph.node, *graph.initializer, *graph.input, *graph.output]:
        item.doc_string = ""
        del item.metadata_props[:]
    for number, node in enumerate(graph.node):
        node.name = f"{node.op_type}_{number}"
    return model


def store_float16(model: onnx.ModelProto) -> onnx.ModelProto:
    """Large float32 weights stored as float16 behind a Cast, which onnxruntime folds at load: computation stays
    float32 on rounded weights, the file takes half the space. Changes the model that it is given."""
    casts = []
    for tensor in model.graph.initializer:
        if tensor.data_type != TensorProto.FLOAT:
            continue
        values = numpy_helper.to_array(tensor)
        if values.size <= HALVED_ABOVE:
            continue
        name = tensor.name
        tensor.CopyFrom(numpy_helper.from_array(values.astype(np.float16), f"{name}.half"))
        casts.append(helper.make_node("Cast", [f"{name}.half"], [name], name=f"Widen_{name}", to=TensorProto.FLOAT))
    for place, cast in enumerate(casts):
        model.graph.node.insert(place, cast)
    return model


def int8_weights(model: onnx.ModelProto) -> onnx.ModelProto:
    """Large float32 matrices stored as int8 with a scale per column behind Cast and Mul, folded at load as in
    `store_float16`: a quarter of the space, float32 arithmetic. Changes the model that it is given."""
    nodes = []
    for tensor in model.graph.initializer:
        values = numpy_helper.to_array(tensor)
        if tensor.data_type != TensorProto.FLOAT or values.ndim != 2 or values.size <= HALVED_ABOVE:
            continue
        name = tensor.name
        scale = np.maximum(np.abs(values).max(axis=0, keepdims=True), 1e-12) / 127.0
        tensor.CopyFrom(numpy_helper.from_array(np.rint(values / scale).astype(np.int8), f"{name}.int8"))
        model.graph.initializer.append(numpy_helper.from_array(scale.astype(np.float32), f"{name}.scale"))
        nodes.append(helper.make_node("Cast", [f"{name}.int8"], [f"{name}.wide"], to=TensorProto.FLOAT))
        nodes.append(helper.make_node("Mul", [f"{name}.wide", f"{name}.scale"], [name]))
    for place, node in enumerate(nodes):
        model.graph.node.insert(place, node)
    return model


@torch.no_grad()
def round_weights(module: nn.Module) -> None:
    """Give a module the weights its exported file will hold (see `store_float16`)."""
    for value in [*module.parameters(), *module.buffers()]:
        if value.is_floating_point() and value.numel() > HALVED_ABOVE:
            value.copy_(value.half().float())


def serialised(model: onnx.ModelProto) -> bytes:
    """The same bytes for the same model."""
    onnx.checker.check_model(model)
    return model.SerializeToString(deterministic=True)


def operators(model: onnx.ModelProto) -> list[str]:
    """Sorted `domain::OpType` of all nodes; "" is ONNX's own domain."""
    return sorted({f"{node.domain}::{node.op_type}" for node in model.graph.node})
