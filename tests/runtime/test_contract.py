"""The contract: tensors equal the table of the design, and a session that differs is refused with its name."""

from __future__ import annotations

from dataclasses import dataclass, replace

import pytest

from kinegraph.bundle.contract import (
    GRAPHS,
    LEVELS,
    OPTIONAL_GRAPHS,
    GraphContract,
    LevelSpec,
    TensorSpec,
    check_signature,
    contracts,
)
from kinegraph.bundle.sessions import open_session, session_options
from kinegraph.errors import BundleFormatError
from support.synthetic_bundle import LEVEL_SPECS, filler_model

EDGE = {
    "motion": LevelSpec(2, 16, 192, 4, 3, ("motion",)),
    "action": LevelSpec(4, 16, 192, 4, 2, ("motion", "action")),
    "specific": LevelSpec(8, 16, 192, 6, 1, ("motion", "action", "specific")),
}

TABLE = {
    "text_encoder": (
        "input_ids i B,T | attention_mask i B,T",
        "hidden f B,T,384 | pooled f B,384",
    ),
    "graph_encoder": (
        "nodes f B,N,384 | relation i B,N,N | edge_weight f B,N,N | node_mask f B,N",
        "nodes_out f B,N,384",
    ),
    "context_motion": (
        "nodes f B,N,384 | kind i B,N | order i B,N | bias f B,N",
        "key_0 f B,4,S,48 | value_0 f B,4,S,48 | key_1 f B,4,S,48 | value_1 f B,4,S,48"
        " | key_2 f B,4,S,48 | value_2 f B,4,S,48",
    ),
    "modulation_motion": ("timestep i K | frames i B", "modulation f K,B,18,192"),
    "denoiser_motion": (
        "latent f R,2,16 | modulation f M,18,192 | key_0 f A,4,S,48 | value_0 f A,4,S,48 | key_1 f A,4,S,48"
        " | value_1 f A,4,S,48 | key_2 f A,4,S,48 | value_2 f A,4,S,48 | src i A | combine f R,A"
        " | bias f A,1,2,S",
        "noise f R,2,16",
    ),
    "context_action": (
        "nodes f B,N,384 | kind i B,N | order i B,N | bias f B,S | coarse f B,2,16",
        "key_0 f B,4,S,48 | value_0 f B,4,S,48 | key_1 f B,4,S,48 | value_1 f B,4,S,48",
    ),
    "modulation_action": ("timestep i K | frames i B", "modulation f K,B,12,192"),
    "denoiser_action": (
        "latent f R,4,16 | modulation f M,12,192 | key_0 f A,4,S,48 | value_0 f A,4,S,48 | key_1 f A,4,S,48"
        " | value_1 f A,4,S,48 | src i A | combine f R,A | bias f A,1,4,S",
        "noise f R,4,16",
    ),
    "context_specific": (
        "nodes f B,N,384 | kind i B,N | order i B,N | bias f B,S | coarse f B,4,16",
        "key_0 f B,6,S,32 | value_0 f B,6,S,32",
    ),
    "modulation_specific": ("timestep i K | frames i B", "modulation f K,B,6,192"),
    "denoiser_specific": (
        "latent f R,8,16 | modulation f M,6,192 | key_0 f A,6,S,32 | value_0 f A,6,S,32 | src i A | combine f R,A"
        " | bias f A,1,8,S",
        "noise f R,8,16",
    ),
    "decoder": ("latent f B,8,16 | frame_mask f B,L", "features f B,L,137"),
    "decoder_motion": ("latent f B,2,16 | frame_mask f B,L", "features f B,L,137"),
    "decoder_action": ("latent f B,4,16 | frame_mask f B,L", "features f B,L,137"),
    "context_motion_agd": ("nodes f B,N,384 | kind i B,N | order i B,N | bias f B,N", "context f B,S,192"),
    "denoiser_motion_agd": (
        "latent f R,2,16 | modulation f M,18,192 | context f A,S,192 | gamma f A,2 | src i A | combine f R,A"
        " | bias f A,1,2,S",
        "noise f R,2,16",
    ),
    "context_action_agd": (
        "nodes f B,N,384 | kind i B,N | order i B,N | bias f B,S | coarse f B,2,16",
        "context f B,S,192",
    ),
    "denoiser_action_agd": (
        "latent f R,4,16 | modulation f M,12,192 | context f A,S,192 | gamma f A,2 | src i A | combine f R,A"
        " | bias f A,1,4,S",
        "noise f R,4,16",
    ),
    "context_specific_agd": (
        "nodes f B,N,384 | kind i B,N | order i B,N | bias f B,S | coarse f B,4,16",
        "context f B,S,192",
    ),
    "denoiser_specific_agd": (
        "latent f R,8,16 | modulation f M,6,192 | context f A,S,192 | gamma f A,2 | src i A | combine f R,A"
        " | bias f A,1,8,S",
        "noise f R,8,16",
    ),
    "decoder_motion_vjp": ("latent f B,2,16 | frame_mask f B,L | cotangent f B,L,137", "gradient f B,2,16"),
    "decoder_action_vjp": ("latent f B,4,16 | frame_mask f B,L | cotangent f B,L,137", "gradient f B,4,16"),
    "decoder_vjp": ("latent f B,8,16 | frame_mask f B,L | cotangent f B,L,137", "gradient f B,8,16"),
    "encoder": ("features f B,L,137 | frame_mask f B,L", "latent f B,8,16"),
}


def read_table(line: str) -> tuple[TensorSpec, ...]:
    specs = []
    for part in line.split(" | "):
        name, kind, axes = part.split()
        sizes = tuple(int(axis) if axis.isdigit() else axis for axis in axes.split(","))
        specs.append(TensorSpec(name, sizes, {"f": "float32", "i": "int64"}[kind]))
    return tuple(specs)


def test_contracts_are_the_designs_table() -> None:
    graphs = contracts(EDGE, 384, 137)
    assert tuple(graphs) == (*GRAPHS, *OPTIONAL_GRAPHS) == tuple(TABLE)
    for name, (inputs, outputs) in TABLE.items():
        assert graphs[name].inputs == read_table(inputs), name
        assert graphs[name].outputs == read_table(outputs), name
        assert graphs[name].file == f"{name}.onnx"


@pytest.mark.parametrize("name", TABLE)
def test_a_session_that_keeps_the_contract_is_accepted(name: str) -> None:
    contract = contracts(LEVEL_SPECS, 12, 137)[name]
    session = open_session(filler_model(contract), contract, session_options(1))
    assert [tensor.name for tensor in session.get_inputs()] == [spec.name for spec in contract.inputs]


@dataclass
class FakeNodeArg:
    """Stands in for `onnxruntime.NodeArg`."""

    name: str
    shape: list[int | str | None]
    type: str


def node_args(specs: tuple[TensorSpec, ...]) -> list[FakeNodeArg]:
    types = {"float32": "tensor(float)", "int64": "tensor(int64)"}
    return [FakeNodeArg(spec.name, list(spec.axes), types[spec.dtype]) for spec in specs]


STEP = contracts(EDGE, 384, 137)["denoiser_action"]


def test_order_of_tensors_and_names_of_free_axes_do_not_matter() -> None:
    inputs = node_args(STEP.inputs)[::-1]
    for tensor in inputs:
        tensor.shape = [size if isinstance(size, int) else None for size in tensor.shape]
    check_signature(inputs, node_args(STEP.outputs), STEP)


CHANGES = [
    (index, change)
    for index, spec in enumerate(STEP.inputs)
    for change in ("missing", "type", "rank", "frozen", "loose", "size")
    if change not in ("loose", "size") or any(isinstance(axis, int) for axis in spec.axes)
]


@pytest.mark.parametrize(("index", "change"), CHANGES)
def test_any_difference_of_an_input_is_named(index: int, change: str) -> None:
    inputs = node_args(STEP.inputs)
    tensor, spec = inputs[index], STEP.inputs[index]
    free = [index for index, axis in enumerate(spec.axes) if isinstance(axis, str)]
    fixed = [index for index, axis in enumerate(spec.axes) if isinstance(axis, int)]
    if change == "missing":
        del inputs[index]
    elif change == "type":
        tensor.type = "tensor(double)"
    elif change == "rank":
        tensor.shape = [*tensor.shape, 1]
    elif change == "frozen":
        tensor.shape[free[0]] = 7
    else:
        tensor.shape[fixed[0]] = "dynamic" if change == "loose" else 1000
    with pytest.raises(BundleFormatError) as caught:
        check_signature(inputs, node_args(STEP.outputs), STEP)
    message = str(caught.value)
    assert "denoiser_action.onnx" in message
    assert repr(spec.name) in message
    if change not in ("missing", "type"):
        assert str(list(spec.axes)) in message
        assert str(tensor.shape) in message


def test_extra_tensors_are_named() -> None:
    extra = [*node_args(STEP.inputs), FakeNodeArg("gamma", ["A", 2], "tensor(float)")]
    with pytest.raises(BundleFormatError, match=r"denoiser_action\.onnx has an unknown input 'gamma'"):
        check_signature(extra, node_args(STEP.outputs), STEP)


def test_outputs_are_checked_too() -> None:
    outputs = node_args(STEP.outputs)
    outputs[0].name = "eps"
    with pytest.raises(BundleFormatError, match=r"has no output 'noise'"):
        check_signature(node_args(STEP.inputs), outputs, STEP)


def test_a_real_session_with_a_frozen_axis_is_refused() -> None:
    contract = contracts(LEVEL_SPECS, 12, 137)["decoder"]
    frozen = replace(contract.inputs[1], axes=("B", 24))
    wrong = GraphContract("decoder", (contract.inputs[0], frozen), contract.outputs)
    expected = r"decoder\.onnx: input 'frame_mask' should have .*\['B', 'L'\], found \['B', 24\]"
    with pytest.raises(BundleFormatError, match=expected):
        open_session(filler_model(wrong), contract, session_options(1))


def test_older_bundles_have_older_names_and_no_bias_among_context_tokens() -> None:
    now, before = (contracts(EDGE, 384, 137, version) for version in (4, 3))
    assert tuple(now) == tuple(before)
    files = {contract.file for contract in before.values()}
    assert {"clock_motion.onnx", "step_specific.onnx", "step_action_agd.onnx", "decoder_motion.onnx"} <= files
    assert not any(file.startswith(("modulation", "denoiser")) for file in files)
    for name in TABLE:
        expected = [spec for spec in now[name].inputs if not (name.startswith("context") and spec.name == "bias")]
        assert list(before[name].inputs) == expected and before[name].outputs == now[name].outputs


def test_levels_run_from_coarse_to_fine() -> None:
    assert LEVELS == ("motion", "action", "specific")
