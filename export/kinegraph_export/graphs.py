"""Every trained graph of a bundle as ONNX, validated against its module."""

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
    LEVELS,
    NODE_KINDS,
    GraphContract,
    LevelSpec,
    contracts,
)
from kinegraph.errors import InvalidInputError
from kinegraph_export.fused import fused
from kinegraph_export.modules import (
    AgdContextGraph,
    AgdDenoiserGraph,
    CoarseDecoderGraph,
    ContextGraph,
    DecoderGraph,
    DenoiserGraph,
    ModulationGraph,
    MotionAgdContextGraph,
    MotionContextGraph,
)
from kinegraph_export.onnx_export import int8_weights, serialised, store_float16, strip_metadata, to_onnx
from kinegraph_export.parity import Draw, max_difference, module_arguments, relative_error
from kinegraph_export.quantise import dynamic_int8, optimised
from kinegraph_training.models.agd import AgdNoisePredictor
from kinegraph_training.models.hierarchy import Hierarchy
from kinegraph_training.models.vae import MotionVae

Precision = Literal["fp32", "int8"]

KEPT_IN_FLOAT = ("graph_encoder", "decoder", *AGD_CONTEXTS.values())
"""Graphs whose numbers stay float32 in an int8 bundle."""
STORED_INT8 = tuple(COARSE_DECODERS.values())
"""Graphs that an int8 bundle stores as int8 and computes in float32."""


@dataclass(frozen=True)
class CoarseDecoder:
    """The autoencoder of a coarser level, in the terms of the specific level's features."""

    vae: MotionVae
    centre: torch.Tensor
    scale: torch.Tensor
    """(c, z) standardisation of the level's latent."""
    gain: torch.Tensor
    shift: torch.Tensor
    """(features,) `decoded * gain + shift` is normalised as the specific level's features are."""


@dataclass(frozen=True)
class Trained:
    """Everything that was trained, in evaluation mode, weights rounded to what the bundle stores."""

    hierarchy: Hierarchy
    vae: MotionVae
    """Of the specific level."""
    centre: torch.Tensor
    scale: torch.Tensor
    """(c, z) standardisation of the specific level's latent."""
    coarse: Mapping[str, CoarseDecoder] = field(default_factory=dict)
    """By level, as far as the run tells how their latents were standardised."""


def check_exportable(trained: Trained) -> None:
    """Raises InvalidInputError for a model that is for comparison only."""
    config = trained.hierarchy.config
    if (config.kind, config.condition, config.reasoning, config.levels) != ("cross", "graph", True, LEVELS):
        raise InvalidInputError(
            f"only cross-attention over the reasoned graph at all levels can be exported, not kind {config.kind!r}, "
            f"condition {config.condition!r}, reasoning {config.reasoning}, levels {', '.join(config.levels)}"
        )


def level_specs(trained: Trained) -> dict[str, LevelSpec]:
    """The manifest's levels."""
    config = trained.hierarchy.config
    return {
        level: LevelSpec(
            tokens=shape.tokens,
            latent_width=shape.width,
            width=config.width,
            heads=config.heads,
            layers=config.layers,
            nodes=NODE_KINDS[: config.kinds_seen(level)],
        )
        for level, shape in trained.hierarchy.latents.items()
    }


def graph_modules(trained: Trained) -> dict[str, nn.Module]:
    """Module of every trained graph by the graph's name."""
    modules: dict[str, nn.Module] = {"graph_encoder": trained.hierarchy.graph_encoder}
    for level in LEVELS:
        denoiser = trained.hierarchy.levels[level]
        top = level == LEVELS[0]
        modules[f"context_{level}"] = (MotionContextGraph if top else ContextGraph)(denoiser.context)
        modules[f"clock_{level}"] = ModulationGraph(denoiser.clock)
        modules[f"step_{level}"] = DenoiserGraph(denoiser.step)
        modules[AGD_CONTEXTS[level]] = (MotionAgdContextGraph if top else AgdContextGraph)(denoiser.context)
        modules[AGD_DENOISERS[level]] = AgdDenoiserGraph(AgdNoisePredictor(denoiser))
    modules["decoder"] = DecoderGraph(trained.vae, trained.centre, trained.scale)
    for level, own in trained.coarse.items():
        modules[COARSE_DECODERS[level]] = CoarseDecoderGraph(own.vae, own.centre, own.scale, own.gain, own.shift)
    return {name: module.eval() for name, module in modules.items()}


def drawn_inputs(contract: GraphContract, frames_per_token: int, *, distinct: bool = False) -> Draw:
    """Random inputs of a contract, with new sizes at every call; ids and masks are meaningful ones. `distinct`: every
    row has its own modulation, for tracing takes a size of 1 for a constant."""

    def draw(rng: np.random.Generator) -> dict[str, np.ndarray]:
        free = sorted({axis for spec in contract.inputs for axis in spec.axes if isinstance(axis, str)})
        size = {axis: int(rng.integers(2, 12)) for axis in free}
        if "M" in size:
            size["M"] = size["R"] if distinct else int(rng.choice([1, size["R"]]))
        if "L" in size:
            size["L"] = frames_per_token * int(rng.integers(4, 49))
        feeds = {}
        for spec in contract.inputs:
            shape = tuple(size[axis] if isinstance(axis, str) else axis for axis in spec.axes)
            feeds[spec.name] = _values(spec.name, shape, size, rng)
        return feeds

    return draw


def _values(name: str, shape: tuple[int, ...], size: dict[str, int], rng: np.random.Generator) -> np.ndarray:
    if name == "relation":
        relation = rng.integers(-1, 12, shape)
        relation[:, np.arange(shape[1]), np.arange(shape[1])] = 11
        return relation
    if name == "kind":
        return rng.integers(0, 4, shape)
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
    if name == "bias":
        return rng.choice([0.0, 0.0, -0.7, -1e4], shape).astype(np.float32)
    return rng.standard_normal(shape).astype(np.float32)


def traced(module: nn.Module, contract: GraphContract, frames_per_token: int) -> onnx.ModelProto:
    """A module as ONNX with fused operators."""
    sample = drawn_inputs(contract, frames_per_token, distinct=True)(np.random.Generator(np.random.PCG64(1)))
    return to_onnx(
        fused(module),
        tuple(module_arguments(contract, sample)),
        [spec.name for spec in contract.inputs],
        [spec.name for spec in contract.outputs],
        dynamic_shapes(contract, frames_per_token),
    )


def export_graph(
    module: nn.Module, contract: GraphContract, frames_per_token: int, precision: Precision
) -> tuple[bytes, dict[str, float]]:
    """One graph as ONNX bytes, and how far it is from its module: by the graph's name the largest difference in
    float32, and by `int8_{name}` the relative error where the file holds int8.

    Raises:
        ParityError: the exported graph is not the module.
    """
    draw = drawn_inputs(contract, frames_per_token)
    model = traced(module, contract, frames_per_token)
    data = serialised(store_float16(copy.deepcopy(model)))
    parity = {contract.name: max_difference(data, module, contract, draw)}
    if precision == "int8" and contract.name not in KEPT_IN_FLOAT:
        data = serialised(store_float16(strip_metadata(_in_int8(model, contract.name))))
        parity[f"int8_{contract.name}"] = relative_error(data, module, contract, draw)
    return data, parity


def _in_int8(model: onnx.ModelProto, name: str) -> onnx.ModelProto:
    if name in STORED_INT8:
        return int8_weights(model)
    if name in AGD_DENOISERS.values():
        # Adaptive gradient descent moves a context by thousandths, which int8 activations would round away: what reads
        # and moves the context is only stored as int8 (its weights reach the products transposed, so the quantiser
        # passes them by). `optimised` would fold them into two copies each.
        return int8_weights(dynamic_int8(model))
    return optimised(dynamic_int8(model))


def dynamic_shapes(contract: GraphContract, frames_per_token: int) -> tuple[object, ...]:
    """torch.export's description of the free axes, nested like the module's arguments."""
    dims: dict[str, object] = {}
    for spec in contract.inputs:
        for axis in spec.axes:
            if isinstance(axis, str) and axis not in dims:
                dims[axis] = torch.export.Dim.DYNAMIC
    shapes: list[object] = []
    context: list[object] = []
    for spec in contract.inputs:
        free = {place: dims[axis] for place, axis in enumerate(spec.axes) if isinstance(axis, str)}
        if spec.name.startswith(("key_", "value_")):
            if not context:
                shapes.append(context)
            context.append(free)
        else:
            shapes.append(free)
    return tuple(shapes)


def export_graphs(
    trained: Trained, text_width: int, features: int, precision: Precision
) -> tuple[dict[str, bytes], dict[str, float]]:
    """All trained graphs: file name -> bytes, and what `export_graph` measured."""
    check_exportable(trained)
    declared = contracts(level_specs(trained), text_width, features)
    files: dict[str, bytes] = {}
    parity: dict[str, float] = {}
    for name, module in graph_modules(trained).items():
        contract = declared[name]
        files[contract.file], measured = export_graph(module, contract, trained.vae.config.frames_per_token, precision)
        parity |= measured
    return files, parity
