"""ONNX inspection compared with models written field by field, and with the onnx package if installed."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any

import numpy as np
import onnxruntime
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.bundle.contract import TensorSpec, contracts
from kinegraph.bundle.onnx_inspect import check_self_contained, summarise, with_initializers
from kinegraph.errors import BundleFormatError
from support.synthetic_bundle import LEVEL_SPECS, field, filler_model, model, node, value_info

CONTRACTS = contracts(LEVEL_SPECS, 12, 137)


def subgraph(name: str, *nodes: bytes) -> bytes:
    """Encode a graph attribute."""
    body = b"".join(field(1, item) for item in nodes)
    return field(5, field(1, name) + field(6, body) + field(20, 5))


def external_tensor() -> bytes:
    return field(8, "w") + field(13, field(1, "location") + field(2, "w.bin")) + field(14, 1)


def test_domains_nested_graphs_and_functions_are_listed() -> None:
    inner = node("If", ["c"], ["y"], subgraph("then_branch", node("Gelu", ["x"], ["y"], domain="com.microsoft")))
    outer = node("Loop", ["n"], ["y"], subgraph("body", inner))
    function = field(1, "Mine") + field(10, "local") + field(7, node("Tanh", ["x"], ["y"]))
    data = model([outer, node("Mine", ["x"], ["z"], domain="local")]) + field(25, function)
    assert summarise(data, "m.onnx").operators == (
        "ai.onnx::If",
        "ai.onnx::Loop",
        "ai.onnx::Tanh",
        "com.microsoft::Gelu",
        "local::Mine",
    )


def test_the_default_domain_has_one_name() -> None:
    data = model([node("Add", ["a", "b"], ["c"]), node("Add", ["a", "c"], ["d"], domain="ai.onnx")])
    assert summarise(data, "m.onnx").operators == ("ai.onnx::Add",)


TENSOR_PLACES = {
    "initializer": model([node("Add", ["a"], ["b"])], initializers=field(5, external_tensor())),
    "sparse values": model([node("Add", ["a"], ["b"])], initializers=field(15, field(1, external_tensor()))),
    "sparse indices": model([node("Add", ["a"], ["b"])], initializers=field(15, field(2, external_tensor()))),
    "constant": model([node("Constant", [], ["b"], field(5, field(1, "value") + field(5, external_tensor())))]),
    "list of constants": model([node("X", [], ["b"], field(5, field(1, "v") + field(10, external_tensor())))]),
    "nested": model(
        [
            node(
                "If",
                ["c"],
                ["y"],
                subgraph("then_branch", node("Constant", [], ["b"], field(5, field(5, external_tensor())))),
            )
        ]
    ),
    "function": model([node("Add", ["a"], ["b"])])
    + field(25, field(7, node("Constant", [], ["b"], field(5, field(5, external_tensor()))))),
}


@pytest.mark.parametrize("place", TENSOR_PLACES)
def test_external_data_is_found_wherever_tensors_may_be(place: str) -> None:
    assert summarise(TENSOR_PLACES[place], "m.onnx").external_data
    with pytest.raises(BundleFormatError, match=r"m\.onnx keeps tensors in another file"):
        check_self_contained(TENSOR_PLACES[place], "m.onnx")


def test_a_node_called_location_is_no_external_data() -> None:
    data = model([node("Add", ["/location/weight"], ["location"])])
    assert not summarise(data, "m.onnx").external_data
    check_self_contained(data, "m.onnx")


def test_graphs_nested_without_end_are_refused() -> None:
    inner = node("Add", ["a"], ["b"])
    for _ in range(200):
        inner = node("If", ["c"], ["y"], subgraph("then_branch", inner))
    with pytest.raises(BundleFormatError, match="nested deeper"):
        summarise(model([inner]), "m.onnx")


@given(st.binary(max_size=300))
def test_any_bytes_are_a_model_or_a_typed_error(data: bytes) -> None:
    try:
        summary = summarise(data, "m.onnx")
    except BundleFormatError:
        return
    assert summary.operators


def test_cut_and_flipped_models_are_a_model_or_a_typed_error() -> None:
    good = filler_model(CONTRACTS["denoiser_action"])
    generator = random.Random(3)
    outcomes = set()
    for _ in range(500):
        data = bytearray(good[: generator.randrange(len(good))] if generator.random() < 0.3 else good)
        if data:
            data[generator.randrange(len(data))] ^= 1 << generator.randrange(8)
        try:
            summarise(bytes(data), "m.onnx")
            outcomes.add("model")
        except BundleFormatError:
            outcomes.add("error")
    assert outcomes == {"model", "error"}


def operators_of(onnx: Any, graph: Any) -> Iterator[str]:
    for item in graph.node:
        yield f"{item.domain or 'ai.onnx'}::{item.op_type}"
        for attribute in item.attribute:
            if attribute.type == onnx.AttributeProto.GRAPH:
                yield from operators_of(onnx, attribute.g)
            for inner in attribute.graphs:
                yield from operators_of(onnx, inner)


@pytest.mark.parametrize("name", CONTRACTS)
def test_the_onnx_package_reads_the_same(name: str) -> None:
    onnx = pytest.importorskip("onnx", reason="the onnx package is part of the export extra")
    data = filler_model(CONTRACTS[name])
    proto = onnx.load_from_string(data)
    onnx.checker.check_model(proto)
    assert summarise(data, name).operators == tuple(sorted(set(operators_of(onnx, proto.graph))))
    assert [item.name for item in proto.graph.input] == [spec.name for spec in CONTRACTS[name].inputs]


def test_models_of_the_onnx_package_are_read() -> None:
    onnx = pytest.importorskip("onnx", reason="the onnx package is part of the export extra")
    helper = onnx.helper
    tensor = helper.make_tensor("w", onnx.TensorProto.FLOAT, [64], [float(i) for i in range(64)])
    branch = helper.make_graph(
        [
            helper.make_node("Constant", [], ["v"], value=tensor),
            helper.make_node("Gelu", ["v"], ["y"], domain="com.microsoft"),
        ],
        "branch",
        [],
        [helper.make_tensor_value_info("y", onnx.TensorProto.FLOAT, None)],
    )
    nodes = [
        helper.make_node("If", ["c"], ["a"], then_branch=branch, else_branch=branch),
        helper.make_node("Twice", ["a"], ["b"], domain="mine"),
    ]
    graph = helper.make_graph(
        nodes,
        "g",
        [helper.make_tensor_value_info("c", onnx.TensorProto.BOOL, [])],
        [helper.make_tensor_value_info("b", onnx.TensorProto.FLOAT, None)],
        [tensor],
    )
    opsets = [helper.make_opsetid("", 18), helper.make_opsetid("mine", 1)]
    twice = helper.make_function("mine", "Twice", ["x"], ["y"], [helper.make_node("Add", ["x", "x"], ["y"])], opsets)
    proto = helper.make_model(graph, functions=[twice], opset_imports=opsets)
    expected = {*operators_of(onnx, proto.graph), "ai.onnx::Add"}
    summary = summarise(proto.SerializeToString(), "m.onnx")
    assert summary.operators == tuple(sorted(expected))
    assert not summary.external_data
    onnx.external_data_helper.convert_model_to_external_data(proto, size_threshold=0, convert_attribute=True)
    for item in proto.graph.initializer:
        item.data_location = onnx.TensorProto.EXTERNAL
    assert summarise(proto.SerializeToString(), "m.onnx").external_data


def test_weights_of_one_file_are_added_to_another() -> None:
    tensor = field(1, 2) + field(2, 1) + field(8, "w") + field(9, np.array([2.0, 3.0], dtype=np.float32).tobytes())
    source = model([node("Add", ["x", "w"], ["y"])], initializers=field(5, tensor))
    vector = value_info(TensorSpec("x", (2,))), value_info(TensorSpec("y", (2,)))
    graph = model([node("Mul", ["x", "w"], ["y"])], field(11, vector[0]), field(12, vector[1]))
    session = onnxruntime.InferenceSession(with_initializers(graph, source, "source.onnx"))
    np.testing.assert_array_equal(session.run(None, {"x": np.array([5.0, 7.0], dtype=np.float32)})[0], [10.0, 21.0])
    assert with_initializers(graph, model([node("Add", ["x", "x"], ["y"])]), "source.onnx") == graph + field(7, b"")
    assert with_initializers(source, source, "source.onnx") == source + field(7, b"")  # it lacks nothing
    with pytest.raises(BundleFormatError, match=r"source\.onnx is not an ONNX model"):
        with_initializers(graph, source[:-3], "source.onnx")
