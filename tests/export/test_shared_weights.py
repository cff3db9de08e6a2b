"""Weights that two files of a bundle have are stored once, and graphs compute the same."""

from __future__ import annotations

import numpy as np
import pytest

onnx = pytest.importorskip("onnx")
import onnxruntime
from onnx import TensorProto, helper, numpy_helper

from kinegraph.bundle.contract import AGD_DENOISERS, WEIGHT_SOURCES
from kinegraph.bundle.onnx_inspect import with_initializers
from kinegraph.bundle.reader import read_bundle
from kinegraph_export.shared_weights import SMALLEST, without_shared
from support.toy import TOY_BUNDLE

RNG = np.random.default_rng(5)
WIDTH = 20
WEIGHT, OTHER = RNG.normal(size=(2, WIDTH, WIDTH)).astype(np.float32)
BIAS = RNG.normal(size=WIDTH).astype(np.float32)


def model(nodes: list[onnx.NodeProto], **weights: np.ndarray) -> bytes:
    values = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", WIDTH]) for name in ("x", "y")]
    tensors = [numpy_helper.from_array(value, name) for name, value in weights.items()]
    graph = helper.make_graph(nodes, "g", values[:1], values[1:], tensors)
    opset = helper.make_opsetid("", 18)
    return helper.make_model(graph, opset_imports=[opset], ir_version=9).SerializeToString()


def run(data: bytes) -> np.ndarray:
    x = np.linspace(-1, 1, 3 * WIDTH, dtype=np.float32).reshape(3, WIDTH)
    return onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"]).run(None, {"x": x})[0]


def test_an_equal_weight_takes_the_name_that_it_has_elsewhere() -> None:
    source = model([helper.make_node("MatMul", ["x", "w"], ["y"])], w=WEIGHT)
    # Here "w" is another weight, and "h" a tensor between: only what is equal may be shared.
    nodes = [
        helper.make_node("MatMul", ["x", "mine"], ["h"]),
        helper.make_node("MatMul", ["h", "w"], ["g"]),
        helper.make_node("Add", ["g", "b"], ["y"]),
    ]
    whole = model(nodes, mine=WEIGHT, w=OTHER, b=BIAS)
    lean = without_shared(whole, source)
    assert len(whole) - len(lean) >= WEIGHT.nbytes - 100
    kept = {tensor.name: tensor for tensor in onnx.load_model_from_string(lean).graph.initializer}
    np.testing.assert_array_equal(numpy_helper.to_array(kept["own.w"]), OTHER)
    with pytest.raises(Exception, match="w"):
        run(lean)
    np.testing.assert_array_equal(run(with_initializers(lean, source, "source")), run(whole))


def test_small_and_unequal_weights_stay() -> None:
    assert BIAS.nbytes < SMALLEST
    source = model([helper.make_node("Add", ["x", "c"], ["y"])], c=BIAS)
    whole = model(
        [helper.make_node("MatMul", ["x", "v"], ["h"]), helper.make_node("Add", ["h", "b"], ["y"])], v=OTHER, b=BIAS
    )
    np.testing.assert_array_equal(run(without_shared(whole, source)), run(whole))


@pytest.mark.parametrize("name", AGD_DENOISERS.values())
def test_the_bundle_stores_no_weight_of_a_denoiser_twice(name: str) -> None:
    bundle = read_bundle(TOY_BUNDLE)
    contracts = bundle.manifest.contracts
    data, source = (bundle.read_later(contracts[graph].file) for graph in (name, WEIGHT_SOURCES[name]))
    merged = with_initializers(data, source, "source")
    assert len(data) < 0.5 * len(merged)
    session = onnxruntime.InferenceSession(merged, providers=["CPUExecutionProvider"])
    assert {value.name for value in session.get_inputs()} == {spec.name for spec in contracts[name].inputs}
