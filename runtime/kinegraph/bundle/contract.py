"""Inputs and outputs of every ONNX graph of a bundle, declared once for export, loading and tests.

Axes are numbers where the size is fixed by the bundle and names where it is free:

    B samples     R latent rows     A attention rows     T text tokens     N graph nodes     K diffusion steps
    S context tokens (node tokens first, then the coarser latent's)     L frames     M as many as R, or 1 for all rows

Rows of a step are predictions (unconditional, a concept, ...); attention row `a` lets latent row `src[a]`
attend to its own context, and `combine` mixes attention outputs back into rows.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, Protocol

from kinegraph.errors import BundleFormatError

LEVELS: Final[tuple[str, ...]] = ("motion", "action", "specific")
"""Coarse to fine; a level sees the final latent of the one before it."""

COARSE_DECODERS: Final[Mapping[str, str]] = {level: f"decoder_{level}" for level in LEVELS[:-1]}
"""Level -> graph that shows how far a clip has come after it; a bundle need not have them."""

AGD_CONTEXTS: Final[Mapping[str, str]] = {level: f"context_{level}_agd" for level in LEVELS}
AGD_STEPS: Final[Mapping[str, str]] = {level: f"step_{level}_agd" for level in LEVELS}
"""Level -> graphs of adaptive gradient descent (EnergyMoGen, Eq. 3, 4); a bundle has all of them or none."""

NODE_KINDS: Final[tuple[str, ...]] = ("motion", "action", "specific")
"""Position is the number in a context graph's `kind` input."""

NULL_KIND: Final = 3
"""`kind` of the learned null token of unconditional rows: its node features are ignored."""

MODULATIONS: Final = 6
"""Per layer of a denoiser: scale and shift before self-attention, before cross-attention and before feed-forward."""

FLOAT: Final = "float32"
INT: Final = "int64"

TOLERANCE: Final = 1e-4
"""Largest absolute difference from the trained modules that an fp32 export may have."""

PADDING_BIAS: Final = -1e4
"""Attention bias of padding tokens; -inf would turn a row of padding into NaN."""

_ORT_TYPES: Final[Mapping[str, str]] = {FLOAT: "tensor(float)", INT: "tensor(int64)"}


class Tensor(Protocol):
    """What onnxruntime tells about one input or output (`onnxruntime.NodeArg`)."""

    @property
    def name(self) -> str: ...
    @property
    def shape(self) -> list[int | str | None]: ...
    @property
    def type(self) -> str: ...


@dataclass(frozen=True)
class LevelSpec:
    """Dimensions of one level's denoiser."""

    tokens: int
    """Latent tokens C."""
    latent_width: int
    """Channels z of one latent token."""
    width: int
    """Model width d."""
    heads: int
    layers: int
    """Layers with cross-attention: each has one key and one value."""
    nodes: tuple[str, ...]
    """Kinds of graph nodes the level attends to, out of `NODE_KINDS`."""

    @property
    def modulations(self) -> int:
        """Rows of `modulation`: scales and shifts of all layers."""
        return MODULATIONS * self.layers


@dataclass(frozen=True)
class TensorSpec:
    """One input or output."""

    name: str
    axes: tuple[str | int, ...]
    """A number is a fixed size, a name a free one."""
    dtype: str = FLOAT


@dataclass(frozen=True)
class GraphContract:
    """One ONNX graph: its file is `{name}.onnx`."""

    name: str
    inputs: tuple[TensorSpec, ...]
    outputs: tuple[TensorSpec, ...]
    tolerance: float = TOLERANCE

    @property
    def file(self) -> str:
        """Name of the graph's file in a bundle."""
        return f"{self.name}.onnx"


def text_encoder(text_width: int) -> GraphContract:
    """`pooled` is the mean of `hidden` over the unmasked tokens, special ones included, not normalised."""
    tokens = (TensorSpec("input_ids", ("B", "T"), INT), TensorSpec("attention_mask", ("B", "T"), INT))
    outputs = (TensorSpec("hidden", ("B", "T", text_width)), TensorSpec("pooled", ("B", text_width)))
    return GraphContract("text_encoder", tokens, outputs)


def graph_encoder(text_width: int) -> GraphContract:
    """Graph attention: `relation` is the role's number or -1 for no edge, `node_mask` 1 for a node.

    On padding `node_mask` and `nodes_out` are 0.
    """
    inputs = (
        TensorSpec("nodes", ("B", "N", text_width)),
        TensorSpec("relation", ("B", "N", "N"), INT),
        TensorSpec("edge_weight", ("B", "N", "N")),
        TensorSpec("node_mask", ("B", "N")),
    )
    return GraphContract("graph_encoder", inputs, (TensorSpec("nodes_out", ("B", "N", text_width)),))


def _keys_values(level: LevelSpec, rows: str) -> tuple[TensorSpec, ...]:
    axes = (rows, level.heads, "S", level.width // level.heads)
    return tuple(TensorSpec(f"{kind}_{layer}", axes) for layer in range(level.layers) for kind in ("key", "value"))


def _context_inputs(text_width: int, coarse: LevelSpec | None) -> tuple[TensorSpec, ...]:
    nodes = (
        TensorSpec("nodes", ("B", "N", text_width)),
        TensorSpec("kind", ("B", "N"), INT),
        TensorSpec("order", ("B", "N"), INT),
    )
    return nodes if coarse is None else (*nodes, TensorSpec("coarse", ("B", coarse.tokens, coarse.latent_width)))


def context(name: str, level: LevelSpec, text_width: int, coarse: LevelSpec | None) -> GraphContract:
    """Keys and values of one level, once per sample.

    Args:
        name: one of `LEVELS`.
        level: its dimensions.
        text_width: D, width of the graph encoder's nodes.
        coarse: the level above, whose latent is an input; None at the motion level.
    """
    return GraphContract(f"context_{name}", _context_inputs(text_width, coarse), _keys_values(level, "B"))


def context_agd(name: str, level: LevelSpec, text_width: int, coarse: LevelSpec | None) -> GraphContract:
    """The tokens that keys and values are made of, instead of them; arguments as for `context`."""
    tokens = (TensorSpec("context", ("B", "S", level.width)),)
    return GraphContract(AGD_CONTEXTS[name], _context_inputs(text_width, coarse), tokens)


def clock(name: str, level: LevelSpec) -> GraphContract:
    """Scale and shift of every normalisation of one level, for all diffusion steps and lengths of a run at once."""
    inputs = (TensorSpec("timestep", ("K",), INT), TensorSpec("frames", ("B",), INT))
    outputs = (TensorSpec("modulation", ("K", "B", level.modulations, level.width)),)
    return GraphContract(f"clock_{name}", inputs, outputs)


def step(name: str, level: LevelSpec) -> GraphContract:
    """The noise in R latent rows, one diffusion step.

    `bias` holds the log edge weights of the context tokens and `PADDING_BIAS` on padding.
    """
    return _step(f"step_{name}", level, _keys_values(level, "A"))


def step_agd(name: str, level: LevelSpec) -> GraphContract:
    """`step` with a context that moves from layer to layer; `gamma` holds the step sizes gamma_attn and gamma_reg."""
    moving = (TensorSpec("context", ("A", "S", level.width)), TensorSpec("gamma", ("A", 2)))
    return _step(AGD_STEPS[name], level, moving)


def _step(graph: str, level: LevelSpec, attended: tuple[TensorSpec, ...]) -> GraphContract:
    latent = ("R", level.tokens, level.latent_width)
    inputs = (
        TensorSpec("latent", latent),
        TensorSpec("modulation", ("M", level.modulations, level.width)),
        *attended,
        TensorSpec("src", ("A",), INT),
        TensorSpec("combine", ("R", "A")),
        TensorSpec("bias", ("A", 1, level.tokens, "S")),
    )
    return GraphContract(graph, inputs, (TensorSpec("noise", latent),))


def decoder(name: str, level: LevelSpec, features: int) -> GraphContract:
    """Normalised features from a level's latent; the graph `decoder` is that of the finest.

    `frame_mask` is 1 on frames, 0 on padding; L is a multiple of the bundle's frames per token.
    """
    inputs = (
        TensorSpec("latent", ("B", level.tokens, level.latent_width)),
        TensorSpec("frame_mask", ("B", "L")),
    )
    return GraphContract(name, inputs, (TensorSpec("features", ("B", "L", features)),))


def contracts(levels: Mapping[str, LevelSpec], text_width: int, features: int) -> dict[str, GraphContract]:
    """Every graph that a bundle may hold by name, in the order of running, the optional ones last.

    Args:
        levels: one spec for each of `LEVELS`.
        text_width: D, the text encoder's width.
        features: F, the width of the feature layout.
    """
    graphs = [text_encoder(text_width), graph_encoder(text_width)]
    adaptive: list[GraphContract] = []
    coarse: LevelSpec | None = None
    for name in LEVELS:
        own = levels[name]
        graphs += [context(name, own, text_width, coarse), clock(name, own), step(name, own)]
        adaptive += [context_agd(name, own, text_width, coarse), step_agd(name, own)]
        coarse = levels[name]
    graphs.append(decoder("decoder", levels[LEVELS[-1]], features))
    graphs += [decoder(graph, levels[level], features) for level, graph in COARSE_DECODERS.items()] + adaptive
    return {graph.name: graph for graph in graphs}


GRAPHS: Final[tuple[str, ...]] = (
    "text_encoder",
    "graph_encoder",
    *(f"{part}_{level}" for level in LEVELS for part in ("context", "clock", "step")),
    "decoder",
)
"""Names of all graphs that a bundle must have, in the order of running."""

OPTIONAL_GRAPHS: Final[tuple[str, ...]] = (
    *COARSE_DECODERS.values(),
    *(names[level] for level in LEVELS for names in (AGD_CONTEXTS, AGD_STEPS)),
)
"""Names of those that it may have; read at their first use."""


def check(inputs: Iterable[Tensor], outputs: Iterable[Tensor], contract: GraphContract) -> None:
    """Compare a session's inputs and outputs with the contract.

    Args:
        inputs: `session.get_inputs()`.
        outputs: `session.get_outputs()`.
        contract: what the graph has to look like. Order does not matter, names do.

    Raises:
        BundleFormatError: naming graph, tensor, what is expected and what was found.
    """
    _check_side(contract.name, "input", list(inputs), contract.inputs)
    _check_side(contract.name, "output", list(outputs), contract.outputs)


def _check_side(graph: str, side: str, found: list[Tensor], expected: tuple[TensorSpec, ...]) -> None:
    by_name = {tensor.name: tensor for tensor in found}
    names = [spec.name for spec in expected]
    for spec in expected:
        tensor = by_name.get(spec.name)
        if tensor is None:
            raise BundleFormatError(f"{graph}.onnx has no {side} {spec.name!r}; it has {sorted(by_name)}")
        where = f"{graph}.onnx: {side} {spec.name!r}"
        if tensor.type != _ORT_TYPES[spec.dtype]:
            raise BundleFormatError(f"{where} should be {_ORT_TYPES[spec.dtype]}, found {tensor.type}")
        if not _same_axes(tensor.shape, spec.axes):
            raise BundleFormatError(f"{where} should have the shape {list(spec.axes)}, found {tensor.shape}")
    for name in by_name:
        if name not in names:
            raise BundleFormatError(f"{graph}.onnx has an unknown {side} {name!r}; expected are {names}")


def _same_axes(found: list[int | str | None], expected: tuple[str | int, ...]) -> bool:
    # A number where a name is declared is an axis that the exporter froze at its sample's size.
    return len(found) == len(expected) and all(
        size == axis if isinstance(axis, int) else not isinstance(size, int)
        for size, axis in zip(found, expected, strict=True)
    )
