"""torch modules as ONNX: free axes, the same bytes every time, nothing of this machine in them."""

from __future__ import annotations

import getpass
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")

import onnxruntime
from onnx import TensorProto, numpy_helper
from torch import nn

from kinegraph.bundle.onnx_inspect import summarise
from kinegraph_export.onnx_export import MIN_COMPRESSED_SIZE, round_weights, serialise, store_float16, to_onnx

FREE = {0: torch.export.Dim.DYNAMIC, 1: torch.export.Dim.DYNAMIC}


class Toy(nn.Module):
    """Two inputs that share no axis but the batch."""

    def __init__(self) -> None:
        super().__init__()
        self.linear = nn.Linear(48, 48)
        self.norm = nn.LayerNorm(48)

    def forward(self, x: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        return self.norm(self.linear(x)) * mask[..., None] + torch.softmax(x, dim=1)


@pytest.fixture(scope="module")
def toy() -> Toy:
    torch.manual_seed(0)
    return Toy().eval()


def exported(toy: Toy) -> onnx.ModelProto:
    example = (torch.zeros(2, 5, 48), torch.ones(2, 5))
    return to_onnx(toy, example, ["x", "mask"], ["y"], (FREE, FREE))


@pytest.fixture(scope="module")
def model(toy: Toy) -> onnx.ModelProto:
    return exported(toy)


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (3, 2), (2, 17), (7, 64)])
def test_shapes_the_exporter_has_not_seen(toy: Toy, model: onnx.ModelProto, shape: tuple[int, int]) -> None:
    session = onnxruntime.InferenceSession(serialise(model), providers=["CPUExecutionProvider"])
    generator = torch.Generator().manual_seed(1)
    x, mask = torch.randn(*shape, 48, generator=generator), torch.rand(*shape, generator=generator)
    with torch.no_grad():
        expected = toy(x, mask).numpy()
    (found,) = session.run(["y"], {"x": x.numpy(), "mask": mask.numpy()})
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_the_same_module_gives_the_same_bytes(toy: Toy, model: onnx.ModelProto) -> None:
    assert serialise(exported(toy)) == serialise(model)


def test_nothing_in_the_file_tells_of_this_machine(model: onnx.ModelProto) -> None:
    data = serialise(model)
    for trace in (str(Path.home()), str(Path(__file__).parent), "site-packages", f"/{getpass.getuser()}/", ".py"):
        assert trace.encode() not in data, trace
    assert not model.metadata_props and not any(node.metadata_props for node in model.graph.node)


def test_listed_operators_are_those_of_the_graph(model: onnx.ModelProto) -> None:
    used = {f"{node.domain or 'ai.onnx'}::{node.op_type}" for node in model.graph.node}
    assert set(summarise(serialise(model), "toy.onnx").operators) == used


def test_halved_weights_compute_in_float32_on_the_rounded_numbers(toy: Toy) -> None:
    module = Toy().eval()
    module.load_state_dict(toy.state_dict())
    round_weights(module)
    assert torch.equal(module.linear.weight, toy.linear.weight.half().float())
    # Small tensors stay as they are.
    assert module.linear.bias.numel() <= MIN_COMPRESSED_SIZE and torch.equal(module.linear.bias, toy.linear.bias)
    full, half = exported(module), store_float16(exported(module))
    size = {name: len(serialise(graph)) for name, graph in (("full", full), ("half", half))}
    assert size["half"] < 0.65 * size["full"]
    stored = {tensor.name: tensor for tensor in half.graph.initializer}
    assert any(tensor.data_type == TensorProto.FLOAT16 for tensor in stored.values())
    assert all(
        numpy_helper.to_array(tensor).size <= MIN_COMPRESSED_SIZE
        for tensor in stored.values()
        if tensor.data_type == TensorProto.FLOAT
    )
    feeds = {"x": np.ones((1, 3, 48), dtype=np.float32), "mask": np.ones((1, 3), dtype=np.float32)}
    outputs = [
        onnxruntime.InferenceSession(serialise(graph), providers=["CPUExecutionProvider"]).run(["y"], feeds)[0]
        for graph in (full, half)
    ]
    np.testing.assert_allclose(outputs[0], outputs[1], atol=1e-6)
