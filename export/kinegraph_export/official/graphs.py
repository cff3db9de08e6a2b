"""Export the released networks to ONNX, and compare every graph with its module.

Float32 graphs hold the checkpoint's own numbers. In an int8 bundle the denoisers compute in int8, and the autoencoders,
graph attention and condition tokens in float32 on weights stored as float16.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

import numpy as np
import onnx
import torch
from torch import Tensor, nn
from torch.nn import functional

from kinegraph.bundle.contract import (
    COARSE_DECODERS,
    LEVELS,
    NODE_KINDS,
    Family,
    GraphContract,
    LevelSpec,
    TensorSpec,
)
from kinegraph.bundle.released_contract import released_contracts
from kinegraph_export.fused import MICROSOFT, emit_node, fuse_operators
from kinegraph_export.graphs import Precision, dynamic_shapes, random_inputs
from kinegraph_export.official.checkpoint import GraphMotionModels, MldModels
from kinegraph_export.official.denoiser import OfficialDenoiser
from kinegraph_export.official.transformer import PackedCrossAttention, PackedSelfAttention
from kinegraph_export.official.vae import OfficialVae
from kinegraph_export.onnx_export import serialise, store_float16, strip_metadata, to_onnx
from kinegraph_export.parity import InputGenerator, max_difference, module_arguments, relative_error
from kinegraph_export.quantise import optimise_graph, quantise_dynamic

BINARY: Final = ("mask", "adjacency", "relations")
"""Inputs that are 0 or 1."""


class FusedPackedSelfAttention(nn.Module):
    """Self-attention as one matrix product and `MultiHeadAttention` with a mask over keys."""

    def __init__(self, trained: PackedSelfAttention) -> None:
        super().__init__()
        self.heads, self.out_proj = trained.heads, trained.out_proj
        self.weight, self.bias = trained.in_proj_weight, trained.in_proj_bias

    def forward(self, x: Tensor, mask: Tensor | None) -> Tensor:
        """Emit `PackedSelfAttention.forward`."""
        query, key, value = functional.linear(x, self.weight, self.bias).chunk(3, dim=-1)
        visible = None if mask is None else mask.to(torch.int32)
        inputs: list[Tensor | None] = [query, key, value, None, visible]
        return self.out_proj(emit_node(f"{MICROSOFT}::MultiHeadAttention", inputs, x, 1, num_heads=self.heads))


class QuantisedPackedSelfAttention(nn.Module):
    """Self-attention as `Attention` with a mask over keys, which quantises to QAttention.

    In float32 it is slow: onnxruntime multiplies by the weights of each head for each row of the batch.
    """

    def __init__(self, trained: PackedSelfAttention) -> None:
        super().__init__()
        self.heads, self.out_proj = trained.heads, trained.out_proj
        self.weight = nn.Parameter(trained.in_proj_weight.t().contiguous(), requires_grad=False)
        self.bias = trained.in_proj_bias

    def forward(self, x: Tensor, mask: Tensor | None) -> Tensor:
        """Emit `PackedSelfAttention.forward`."""
        visible = None if mask is None else mask.to(torch.int32)
        inputs: list[Tensor | None] = [x, self.weight, self.bias, visible]
        return self.out_proj(emit_node(f"{MICROSOFT}::Attention", inputs, x, 1, num_heads=self.heads))


class FusedPackedCrossAttention(nn.Module):
    """Cross-attention as `MultiHeadAttention`."""

    def __init__(self, trained: PackedCrossAttention) -> None:
        super().__init__()
        self.heads, self.out_proj = trained.heads, trained.out_proj
        self.weights = nn.ParameterList(
            nn.Parameter(part.clone(), requires_grad=False) for part in trained.in_proj_weight.chunk(3)
        )
        self.biases = nn.ParameterList(
            nn.Parameter(part.clone(), requires_grad=False) for part in trained.in_proj_bias.chunk(3)
        )

    def forward(self, x: Tensor, memory: Tensor) -> Tensor:
        """Emit `PackedCrossAttention.forward`."""
        sources = (x, memory, memory)
        query, key, value = map(functional.linear, sources, self.weights, self.biases)
        inputs: list[Tensor | None] = [query, key, value]
        return self.out_proj(emit_node(f"{MICROSOFT}::MultiHeadAttention", inputs, x, 1, num_heads=self.heads))


FUSED: Final[Mapping[type[nn.Module], Callable[[Any], nn.Module]]] = {
    PackedSelfAttention: FusedPackedSelfAttention,
    PackedCrossAttention: FusedPackedCrossAttention,
}
"""For float32."""
QUANTISED: Final[Mapping[type[nn.Module], Callable[[Any], nn.Module]]] = {
    **FUSED,
    PackedSelfAttention: QuantisedPackedSelfAttention,
}
"""For graphs that are quantised."""


class ConditionGraph(nn.Module):
    """Graph context_{level}: nodes and coarser latent -> condition tokens."""

    def __init__(self, denoiser: OfficialDenoiser) -> None:
        super().__init__()
        self.denoiser = denoiser

    def forward(self, nodes: Tensor, coarse: Tensor) -> Tensor:
        return self.denoiser.conditions(nodes, coarse)


class CoarsestConditionGraph(ConditionGraph):
    """The same for a level without a coarser latent."""

    def forward(self, nodes: Tensor) -> Tensor:  # type: ignore[override]
        return self.denoiser.conditions(nodes, None)


class TimeGraph(nn.Module):
    """Graph modulation_{level}: timesteps -> time tokens."""

    def __init__(self, denoiser: OfficialDenoiser) -> None:
        super().__init__()
        self.denoiser = denoiser

    def forward(self, timestep: Tensor) -> Tensor:
        return self.denoiser.time(timestep)


class VaeDecoderGraph(nn.Module):
    """Graph decoder: latent, frame mask -> normalised features."""

    def __init__(self, vae: OfficialVae) -> None:
        super().__init__()
        self.vae = vae

    def forward(self, latent: Tensor, frame_mask: Tensor) -> Tensor:
        return self.vae.decode(latent, frame_mask)


class VaeEncoderGraph(nn.Module):
    """The encoder of an autoencoder: features, frame mask -> mean, log-variance; no graph of a bundle."""

    def __init__(self, vae: OfficialVae) -> None:
        super().__init__()
        self.vae = vae

    def forward(self, features: Tensor, frame_mask: Tensor) -> tuple[Tensor, Tensor]:
        return self.vae.encode(features, frame_mask)


def vae_encoder_contract(vae: OfficialVae) -> GraphContract:
    """Declare the encoder of an autoencoder."""
    config = vae.config
    posterior = ("B", config.tokens, config.width)
    inputs = (TensorSpec("features", ("B", "L", config.features)), TensorSpec("frame_mask", ("B", "L")))
    return GraphContract("encoder", inputs, (TensorSpec("mean", posterior), TensorSpec("log_variance", posterior)))


def level_spec(denoiser: OfficialDenoiser, kinds: int) -> LevelSpec:
    """Describe a level as the manifest does.

    Args:
        denoiser: of the level.
        kinds: how many of `NODE_KINDS` it sees.
    """
    config = denoiser.config
    size = (config.tokens, config.latent_width, config.width, config.heads, config.layers)
    return LevelSpec(*size, NODE_KINDS[:kinds])


def level_specs(models: GraphMotionModels | MldModels) -> dict[str, LevelSpec]:
    """Describe all levels of a model."""
    if isinstance(models, MldModels):
        return {LEVELS[-1]: level_spec(models.denoiser, 1)}
    return {level: level_spec(models.denoisers[level], index) for index, level in enumerate(LEVELS, start=1)}


def graph_modules(models: GraphMotionModels | MldModels) -> dict[str, nn.Module]:
    """Wrap the networks as graphs, by the graph's name."""
    if isinstance(models, MldModels):
        return {**_level_modules(LEVELS[-1], models.denoiser, True), "decoder": VaeDecoderGraph(models.vae)}
    modules: dict[str, nn.Module] = {"graph_encoder": models.graph_attention}
    for level in LEVELS:
        modules |= _level_modules(level, models.denoisers[level], level == LEVELS[0])
        modules[COARSE_DECODERS.get(level, "decoder")] = VaeDecoderGraph(models.vaes[level])
    return modules


def _level_modules(level: str, denoiser: OfficialDenoiser, is_coarsest: bool) -> dict[str, nn.Module]:
    condition = (CoarsestConditionGraph if is_coarsest else ConditionGraph)(denoiser)
    return {f"context_{level}": condition, f"modulation_{level}": TimeGraph(denoiser), f"denoiser_{level}": denoiser}


def draw_inputs(contract: GraphContract) -> InputGenerator:
    """Make a generator of random inputs; rows see at least their first condition."""
    draw_any = random_inputs(contract, frames_per_token=1, distinct=True)

    def draw(rng: np.random.Generator) -> dict[str, np.ndarray]:
        feeds = draw_any(rng)
        for name in BINARY:
            if name in feeds:
                feeds[name] = rng.integers(0, 2, feeds[name].shape).astype(np.float32)
        if "mask" in feeds:
            feeds["mask"][:, 0] = 1.0
        return feeds

    return draw


def trace(module: nn.Module, contract: GraphContract, *, quantised: bool = False) -> onnx.ModelProto:
    """Trace a module to ONNX with fused attention; `quantised` makes one that quantises."""
    sample = draw_inputs(contract)(np.random.Generator(np.random.PCG64(1)))
    names = [spec.name for spec in contract.inputs], [spec.name for spec in contract.outputs]
    arguments = tuple(module_arguments(contract, sample))
    fused = fuse_operators(module, QUANTISED if quantised else FUSED)
    return to_onnx(fused, arguments, *names, dynamic_shapes(contract, 1))


def export_graph(module: nn.Module, contract: GraphContract, precision: Precision) -> tuple[bytes, dict[str, float]]:
    """Export one graph, and measure how far it is from its module.

    Returns:
        ONNX bytes, and differences: by the graph's name the largest one in float32, and by `int8_{name}` the relative
        error where the file holds int8 or float16.

    Raises:
        ParityError: the exported graph differs from the module.
    """
    draw = draw_inputs(contract)
    if precision == "fp32":
        data = serialise(trace(module, contract))  # the model is not kept: it may be a gigabyte
        return data, {contract.name: max_difference(data, module, contract, draw)}
    quantised = contract.name.startswith("denoiser_")
    model = trace(module, contract, quantised=quantised)
    parity = {contract.name: max_difference(serialise(model), module, contract, draw)}
    if quantised:
        model = strip_metadata(optimise_graph(quantise_dynamic(model)))
    data = serialise(store_float16(model))
    return data, parity | {f"int8_{contract.name}": relative_error(data, module, contract, draw)}


def export_networks(
    models: GraphMotionModels | MldModels, family: Family, precision: Precision
) -> Iterator[tuple[str, bytes, dict[str, float]]]:
    """Export all networks but the text encoder, one at a time.

    Args:
        models: the networks.
        family: of the bundle.
        precision: of the denoisers.

    Yields:
        Name of a file, its bytes, and the differences that `export_graph` measured.
    """
    vae = models.vae if isinstance(models, MldModels) else models.vaes[LEVELS[-1]]
    denoiser = models.denoiser if isinstance(models, MldModels) else models.denoisers[LEVELS[-1]]
    levels = level_specs(models)
    declared = released_contracts(family, levels, denoiser.config.text_width, vae.config.features)
    for name, module in graph_modules(models).items():
        yield declared[name].file, *export_graph(module, declared[name], precision)
