"""The graphs of the denoisers: which operators they are made of, and that they are still the trained networks."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxscript")

from kinegraph.bundle.contract import LevelSpec, denoiser, modulation
from kinegraph_export.graphs import export_graph, random_inputs
from kinegraph_export.modules import DenoiserGraph, ModulationGraph
from kinegraph_export.onnx_export import round_weights
from kinegraph_export.parity import ParityError, max_difference, relative_error
from kinegraph_training.models.denoiser import AdaLNModulation, DenoiserConfig, LatentShape, NoisePredictor

LAYERS, TOKENS = 3, 4
CONFIG = DenoiserConfig(width=64, layers=LAYERS, heads=2, feed_forward=128)
LEVEL = LevelSpec(TOKENS, 8, 64, 2, LAYERS, ("motion",))
CONTRACT = denoiser("motion", LEVEL)
Exported = tuple[bytes, dict[str, float]]
"""Of `export_graph`."""


@pytest.fixture(scope="module")
def network() -> DenoiserGraph:
    torch.manual_seed(0)
    module = DenoiserGraph(NoisePredictor(CONFIG, LatentShape(TOKENS, 8))).eval()
    round_weights(module)
    return module


@pytest.fixture(scope="module")
def in_float(network: DenoiserGraph) -> Exported:
    return export_graph(network, CONTRACT, 4, "fp32")


@pytest.fixture(scope="module")
def in_int8(network: DenoiserGraph) -> Exported:
    return export_graph(network, CONTRACT, 4, "int8")


def counts(data: bytes) -> Counter[str]:
    return Counter(node.op_type for node in onnx.load_model_from_string(data).graph.node)


def test_a_float_step_is_made_of_fused_operators_and_is_the_network(in_float: Exported) -> None:
    data, parity = in_float
    found = counts(data)
    assert parity == {"denoiser_motion": pytest.approx(0.0, abs=1e-5)}
    assert found["Attention"] == found["MultiHeadAttention"] == found["Gather"] == LAYERS
    assert found["LayerNormalization"] == 3 * LAYERS + 1
    assert found["Gelu"] == LAYERS
    # in and out, out of both attentions, query, feed-forward twice, combine; one join of the long skips
    assert found["MatMul"] == 2 + 6 * LAYERS + LAYERS // 2
    assert not found.keys() & {"Softmax", "Transpose", "Mul", "GatherND"}


def test_an_int8_step_multiplies_in_int8_and_nothing_else_is_added(in_int8: Exported) -> None:
    data, parity = in_int8
    found = counts(data)
    assert parity["denoiser_motion"] <= 1e-5 and 0.0 < parity["int8_denoiser_motion"] < 0.1
    assert found["QAttention"] == found["MultiHeadAttention"] == LAYERS
    assert found["DynamicQuantizeMatMul"] == 2 + 5 * LAYERS + LAYERS // 2
    assert found["MatMul"] == LAYERS  # `combine`, which has no weights
    assert not found.keys() & {"MatMulInteger", "Softmax", "Transpose"}
    assert sum(found.values()) <= 8 + 21 * LAYERS


def test_no_int8_product_overflows_on_a_cpu_that_adds_two_of_them_in_16_bits(in_int8: Exported) -> None:
    tensors = onnx.load_model_from_string(in_int8[0]).graph.initializer
    weights = [onnx.numpy_helper.to_array(tensor) for tensor in tensors if tensor.name.endswith("_quantized")]
    assert len(weights) > 5 * LAYERS
    for weight in weights:
        # activations are 0 to 255
        assert weight.dtype == np.int8 and 2 * 255 * np.abs(weight.astype(int)).max() < 2**15


def test_keys_values_and_time_are_inputs_of_a_step(in_int8: Exported) -> None:
    names = {tensor.name for tensor in onnx.load_model_from_string(in_int8[0]).graph.input}
    assert names == {spec.name for spec in CONTRACT.inputs}
    assert {"key_0", "value_0", "modulation"} <= names and not names & {"timestep", "nodes", "frames"}


def test_the_same_module_gives_the_same_int8_bytes(network: DenoiserGraph, in_int8: Exported) -> None:
    assert export_graph(network, CONTRACT, 4, "int8")[0] == in_int8[0]


def test_parity_sees_a_wrong_weight(in_float: Exported) -> None:
    data, _ = in_float
    other = DenoiserGraph(NoisePredictor(CONFIG, LatentShape(TOKENS, 8))).eval()
    draw = random_inputs(CONTRACT, 4)
    with pytest.raises(ParityError, match="denoiser_motion"):
        max_difference(data, other, CONTRACT, draw)
    with pytest.raises(ParityError, match="in int8 is off by"):
        relative_error(data, other, CONTRACT, draw)


def test_the_modulation_is_one_graph_of_all_steps() -> None:
    contract = modulation("motion", LEVEL)
    data, _ = export_graph(ModulationGraph(AdaLNModulation(CONFIG)).eval(), contract, 4, "int8")
    assert "Loop" not in {node.op_type for node in onnx.load_model_from_string(data).graph.node}
    feeds = random_inputs(contract, 4)(np.random.Generator(np.random.PCG64(0)))
    import onnxruntime

    (found,) = onnxruntime.InferenceSession(data).run(None, feeds)
    assert found.shape == (len(feeds["timestep"]), len(feeds["frames"]), 6 * LAYERS, 64)
