"""Export every trained graph of a bundle to ONNX, and validate it against its module."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import onnx
import torch
from torch import nn

from kinegraph.bundle.contract import (
    AGD_CONTEXTS,
    AGD_DENOISERS,
    COARSE_DECODERS,
    DECODER_GRADIENTS,
    ENCODER,
    FRAMES_CONTEXT_AGD,
    FRAMES_DENOISER_AGD,
    KINDS,
    LEVELS,
    WEIGHT_SOURCES,
    GraphContract,
    LevelSpec,
    contracts,
)
from kinegraph.errors import InvalidInputError
from kinegraph_export.fused import fuse_operators
from kinegraph_export.modules import (
    AgdContextGraph,
    AgdDenoiserGraph,
    CoarseDecoderGraph,
    ContextGraph,
    DecoderGraph,
    DecoderVjp,
    DenoiserGraph,
    EncoderGraph,
    ModulationGraph,
    MotionAgdContextGraph,
    MotionContextGraph,
)
from kinegraph_export.onnx_export import serialise, store_float16, store_int8, strip_metadata, to_onnx
from kinegraph_export.parity import InputGenerator, max_difference, module_arguments, relative_error
from kinegraph_export.quantise import optimise_graph, quantise_dynamic
from kinegraph_export.reverse_mode import derive_gradient
from kinegraph_export.shared_weights import without_namesakes, without_shared
from kinegraph_training.models.agd import AgdNoisePredictor
from kinegraph_training.models.hierarchy import Hierarchy
from kinegraph_training.models.vae import MotionVae

Precision = Literal["fp32", "int8"]

FLOAT32_GRAPHS = ("graph_encoder", "decoder", *AGD_CONTEXTS.values(), FRAMES_CONTEXT_AGD)
"""Graphs that compute in float32 on float16 weights in an int8 bundle too."""
INT8_WEIGHT_GRAPHS = (*COARSE_DECODERS.values(), ENCODER)
"""Graphs that compute in float32 on int8 weights in an int8 bundle."""


@dataclass(frozen=True)
class CoarseDecoder:
    """Autoencoder of a coarser level, with the map from its features to those of the specific level."""

    vae: MotionVae
    centre: torch.Tensor
    scale: torch.Tensor
    """(c, z) mean and standard deviation of the level's latent."""
    gain: torch.Tensor
    shift: torch.Tensor
    """(features,): `decoded * gain + shift` is normalised as the specific level's features are."""


@dataclass(frozen=True)
class TrainedModels:
    """All trained models of a run, in evaluation mode, with weights rounded to what the bundle stores."""

    hierarchy: Hierarchy
    vae: MotionVae
    """Autoencoder of the specific level."""
    centre: torch.Tensor
    scale: torch.Tensor
    """(c, z) mean and standard deviation of the specific level's latent."""
    coarse: Mapping[str, CoarseDecoder] = field(default_factory=dict)
    """By level, for the levels whose latent statistics the run has."""


def check_exportable(trained: TrainedModels) -> None:
    """Check that a model can be exported.

    Raises:
        InvalidInputError: it is for comparison only.
    """
    config = trained.hierarchy.config
    if (config.kind, config.condition, config.reasoning, config.levels) != ("cross", "graph", True, LEVELS):
        raise InvalidInputError(
            f"only cross-attention over the reasoned graph at all levels can be exported, not kind {config.kind!r}, "
            f"condition {config.condition!r}, reasoning {config.reasoning}, levels {', '.join(config.levels)}"
        )


def level_specs(trained: TrainedModels) -> dict[str, LevelSpec]:
    """Describe the levels as the manifest does."""
    config = trained.hierarchy.config
    return {
        level: LevelSpec(
            tokens=shape.tokens,
            latent_width=shape.width,
            width=config.width,
            heads=config.heads,
            layers=config.layers,
            nodes=config.kinds_seen(level),
        )
        for level, shape in trained.hierarchy.latents.items()
    }


def graph_modules(trained: TrainedModels) -> dict[str, nn.Module]:
    """Wrap the trained modules as graphs, by the graph's name."""
    modules: dict[str, nn.Module] = {"graph_encoder": trained.hierarchy.graph_encoder}
    for level in LEVELS:
        denoiser = trained.hierarchy.levels[level]
        top = level == LEVELS[0]
        modules[f"context_{level}"] = (MotionContextGraph if top else ContextGraph)(denoiser.context)
        modules[f"modulation_{level}"] = ModulationGraph(denoiser.clock)
        modules[f"denoiser_{level}"] = DenoiserGraph(denoiser.step)
        modules[AGD_CONTEXTS[level]] = (MotionAgdContextGraph if top else AgdContextGraph)(denoiser.context)
        modules[AGD_DENOISERS[level]] = AgdDenoiserGraph(AgdNoisePredictor(denoiser))
    modules["decoder"] = DecoderGraph(trained.vae, trained.centre, trained.scale)
    for level, coarse in trained.coarse.items():
        modules[COARSE_DECODERS[level]] = CoarseDecoderGraph(
            coarse.vae, coarse.centre, coarse.scale, coarse.gain, coarse.shift
        )
    modules[ENCODER] = EncoderGraph(trained.vae, trained.centre, trained.scale)
    return {name: module.eval() for name, module in modules.items()}


def random_inputs(contract: GraphContract, frames_per_token: int, *, distinct: bool = False) -> InputGenerator:
    """Make a generator of random inputs of a contract, with new sizes at every call and meaningful ids and masks.

    Args:
        contract: names, axes and types.
        frames_per_token: which the number of frames is a multiple of.
        distinct: give every row its own modulation, because tracing takes a size of 1 for a constant.
    """

    def draw(rng: np.random.Generator) -> dict[str, np.ndarray]:
        free = sorted({axis for spec in contract.inputs for axis in spec.axes if isinstance(axis, str)})
        size = {axis: int(rng.integers(2, 12)) for axis in free}
        if "M" in size:
            size["M"] = size["R"] if distinct else int(rng.choice([1, size["R"]]))
        coarse = [spec.axes[1] for spec in contract.inputs if spec.name == "coarse"]
        if coarse and "N" in size:
            # The context tokens are the nodes, then those of the coarser latent.
            size["S"] = size["N"] + int(coarse[0])
        if "L" in size:
            size["L"] = frames_per_token * int(rng.integers(4, 49))
        feeds = {}
        for spec in contract.inputs:
            shape = tuple(size[axis] if isinstance(axis, str) else axis for axis in spec.axes)
            feeds[spec.name] = _random_values(spec.name, shape, size, rng)
        return feeds

    return draw


def _random_values(name: str, shape: tuple[int, ...], size: dict[str, int], rng: np.random.Generator) -> np.ndarray:
    """Draw meaningful values of one input: ids in range, masks with a tail of zeros, biases that hide some nodes."""
    if name == "relation":
        relation = rng.integers(-1, 12, shape)
        relation[:, np.arange(shape[1]), np.arange(shape[1])] = 11
        return relation
    if name == "kind":
        return rng.integers(0, len(KINDS), shape)
    if name == "order":
        return rng.integers(0, 20, shape)
    if name == "timestep":
        return rng.integers(0, 1000, shape)
    if name == "frames":
        return rng.integers(16, 197, shape)
    if name == "src":
        return rng.integers(0, size["R"], shape)
    if name == "edge_weight":
        return rng.choice([0.0, 0.5, 1.0, 2.0], shape).astype(np.float32)
    if name in ("node_mask", "frame_mask"):
        length = rng.integers(shape[1] // 2 + 1, shape[1] + 1, shape[0])
        return (np.arange(shape[1]) < length[:, None]).astype(np.float32)
    if name == "gamma":
        return rng.choice([0.0, 1e-3, 1e-2], shape).astype(np.float32)
    if name == "cotangent":
        return (0.01 * rng.standard_normal(shape)).astype(np.float32)
    if name == "bias":
        return rng.choice([0.0, 0.0, -0.7, -1e4], shape).astype(np.float32)
    return rng.standard_normal(shape).astype(np.float32)


def trace_to_onnx(module: nn.Module, contract: GraphContract, frames_per_token: int) -> onnx.ModelProto:
    """Trace a module to ONNX with fused operators."""
    sample = random_inputs(contract, frames_per_token, distinct=True)(np.random.Generator(np.random.PCG64(1)))
    return to_onnx(
        fuse_operators(module),
        tuple(module_arguments(contract, sample)),
        [spec.name for spec in contract.inputs],
        [spec.name for spec in contract.outputs],
        dynamic_shapes(contract, frames_per_token),
    )


def export_graph(
    module: nn.Module,
    contract: GraphContract,
    frames_per_token: int,
    precision: Precision,
    traced: onnx.ModelProto | None = None,
) -> tuple[bytes, dict[str, float]]:
    """Export one graph, and measure how far it is from its module.

    Args:
        module: with the inputs and outputs of the contract.
        contract: of the graph.
        frames_per_token: which the number of frames is a multiple of.
        precision: of the bundle.
        traced: what `trace_to_onnx` made of the module, where it is at hand; it is changed.

    Returns:
        ONNX bytes, and differences: by the graph's name the largest one in float32, and by `int8_{name}` the relative
        error where the file holds int8.

    Raises:
        ParityError: the exported graph differs from the module.
    """
    draw = random_inputs(contract, frames_per_token)
    model = trace_to_onnx(module, contract, frames_per_token) if traced is None else traced
    data = serialise(store_float16(copy.deepcopy(model)))
    parity = {contract.name: max_difference(data, module, contract, draw)}
    if precision == "int8" and contract.name not in FLOAT32_GRAPHS:
        data = serialise(store_float16(strip_metadata(_quantise_graph(model, contract.name))))
        parity[f"int8_{contract.name}"] = relative_error(data, module, contract, draw)
    return data, parity


def export_gradient(
    module: nn.Module,
    contract: GraphContract,
    frames_per_token: int,
    stored: bytes,
    exact: onnx.ModelProto | None = None,
) -> tuple[bytes, dict[str, float]]:
    """Derive the gradient of an exported decoder, and measure how far it is from autograd.

    Args:
        module: the trained decoder, a `DecoderGraph`.
        contract: of the gradient.
        frames_per_token: which the number of frames is a multiple of.
        stored: ONNX bytes of the decoder, as the bundle holds them.
        exact: the decoder in float16, where the bundle holds its weights as int8.

    Returns:
        ONNX bytes without weights, and differences as in `export_graph`.

    Raises:
        ParityError: the derived graph differs from autograd.
    """
    draw = random_inputs(contract, frames_per_token)
    oracle = DecoderVjp(module)
    decoder = onnx.load_model_from_string(stored)
    gradient = derive_gradient(decoder)
    parity = {contract.name: max_difference(serialise(derive_gradient(exact or decoder)), oracle, contract, draw)}
    if exact is not None:
        parity[f"int8_{contract.name}"] = relative_error(serialise(gradient), oracle, contract, draw)
    return without_namesakes(gradient, decoder), parity


def _quantise_graph(model: onnx.ModelProto, name: str) -> onnx.ModelProto:
    """Quantise a graph in the way of its kind: weights alone, or weights and activations."""
    if name in INT8_WEIGHT_GRAPHS:
        return store_int8(model)
    if name in (*AGD_DENOISERS.values(), FRAMES_DENOISER_AGD):
        # Adaptive gradient descent moves a context by thousandths, which int8 activations would round away. So the
        # weights that read and move the context are only stored as int8: they reach the products transposed, which the
        # quantiser skips. `optimise_graph` would fold them into two copies each.
        return store_int8(quantise_dynamic(model))
    return optimise_graph(quantise_dynamic(model))


def dynamic_shapes(contract: GraphContract, frames_per_token: int) -> tuple[object, ...]:
    """Describe the free axes for torch.export, nested like the module's arguments."""
    dims: dict[str, object] = {}
    for spec in contract.inputs:
        for axis in spec.axes:
            if isinstance(axis, str) and axis not in dims:
                dims[axis] = torch.export.Dim.DYNAMIC
    shapes: list[object] = []
    context: list[object] = []
    for spec in contract.inputs:
        free = {index: dims[axis] for index, axis in enumerate(spec.axes) if isinstance(axis, str)}
        if spec.name.startswith(("key_", "value_")):
            if not context:
                shapes.append(context)
            context.append(free)
        else:
            shapes.append(free)
    return tuple(shapes)


def export_graphs(
    trained: TrainedModels, text_width: int, features: int, precision: Precision
) -> tuple[dict[str, bytes], dict[str, float]]:
    """Export all trained graphs.

    Args:
        trained: the models.
        text_width: width of the text encoder's states.
        features: number of motion features.
        precision: of the denoisers.

    Returns:
        Bytes by file name, and the differences that `export_graph` measured.
    """
    check_exportable(trained)
    declared = contracts(level_specs(trained), text_width, features)
    group = trained.vae.config.frames_per_token
    files: dict[str, bytes] = {}
    parity: dict[str, float] = {}
    modules = graph_modules(trained)
    exact: dict[str, onnx.ModelProto] = {}
    for name, module in modules.items():
        contract, traced = declared[name], trace_to_onnx(module, declared[name], group)
        if precision == "int8" and name in COARSE_DECODERS.values():
            exact[name] = store_float16(copy.deepcopy(traced))
        files[contract.file], differences = export_graph(module, contract, group, precision, traced)
        parity |= differences
    if set(trained.coarse) == set(COARSE_DECODERS):
        for level, name in DECODER_GRADIENTS.items():
            decoder = COARSE_DECODERS.get(level, "decoder")
            stored = files[declared[decoder].file]
            files[declared[name].file], differences = export_gradient(
                modules[decoder], declared[name], group, stored, exact.get(decoder)
            )
            parity |= differences
    for name in AGD_DENOISERS.values():
        file, source = declared[name].file, declared[WEIGHT_SOURCES[name]].file
        files[file] = without_shared(files[file], files[source])
    return files, parity
