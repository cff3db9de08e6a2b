"""Export torch modules to self-contained, reproducible ONNX, and shrink stored weights."""

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
MIN_COMPRESSED_SIZE = 1024
"""Elements up to which a tensor stays float32, because it is not worth a Cast node."""


def to_onnx(
    module: nn.Module,
    example_inputs: tuple[Any, ...],
    input_names: Sequence[str],
    output_names: Sequence[str],
    dynamic_shapes: tuple[Any, ...],
) -> onnx.ModelProto:
    """Export a module in evaluation mode, with weights inside and no trace of this machine in the file.

    Args:
        module: its forward takes `example_inputs`.
        example_inputs: sample arguments; lists of tensors are flattened in order.
        input_names: names of the flattened inputs.
        output_names: names of the outputs.
        dynamic_shapes: free axes in the form of torch.export, nested like `example_inputs`.
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
    """Remove documentation, metadata (stack traces hold local paths) and intermediate shapes; changes the model."""
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
    """Store large float32 weights as float16 behind a Cast, which onnxruntime folds at load; changes the model.

    Computation stays float32, on rounded weights; the file takes half the space.
    """
    casts = []
    for tensor in model.graph.initializer:
        if tensor.data_type != TensorProto.FLOAT:
            continue
        values = numpy_helper.to_array(tensor)
        if values.size <= MIN_COMPRESSED_SIZE:
            continue
        name = tensor.name
        tensor.CopyFrom(numpy_helper.from_array(values.astype(np.float16), f"{name}.half"))
        casts.append(helper.make_node("Cast", [f"{name}.half"], [name], name=f"Widen_{name}", to=TensorProto.FLOAT))
    for index, cast in enumerate(casts):
        model.graph.node.insert(index, cast)
    return model


def store_int8(model: onnx.ModelProto) -> onnx.ModelProto:
    """Store large float32 matrices as int8 with a scale per column behind Cast and Mul; changes the model.

    Folded at load as in `store_float16`: float32 arithmetic, a quarter of the space.
    """
    nodes = []
    for tensor in list(model.graph.initializer):  # scales are appended to it
        values = numpy_helper.to_array(tensor)
        if tensor.data_type != TensorProto.FLOAT or values.ndim != 2 or values.size <= MIN_COMPRESSED_SIZE:
            continue
        name = tensor.name
        scale = np.maximum(np.abs(values).max(axis=0, keepdims=True), 1e-12) / 127.0
        tensor.CopyFrom(numpy_helper.from_array(np.rint(values / scale).astype(np.int8), f"{name}.int8"))
        model.graph.initializer.append(numpy_helper.from_array(scale.astype(np.float32), f"{name}.scale"))
        nodes.append(helper.make_node("Cast", [f"{name}.int8"], [f"{name}.wide"], to=TensorProto.FLOAT))
        nodes.append(helper.make_node("Mul", [f"{name}.wide", f"{name}.scale"], [name]))
    for index, node in enumerate(nodes):
        model.graph.node.insert(index, node)
    return model


@torch.no_grad()
def round_weights(module: nn.Module) -> None:
    """Round the weights of a module to those that its exported file will hold (see `store_float16`)."""
    for value in [*module.parameters(), *module.buffers()]:
        if value.is_floating_point() and value.numel() > MIN_COMPRESSED_SIZE:
            value.copy_(value.half().float())


def serialise(model: onnx.ModelProto) -> bytes:
    """Check a model and serialise it, to the same bytes for the same model."""
    onnx.checker.check_model(model)
    return model.SerializeToString(deterministic=True)
