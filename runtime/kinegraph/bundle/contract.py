"""Inputs and outputs of every ONNX graph of a bundle, declared once for export, loading and tests.

An axis is a number where the bundle fixes its size and a name where the size is free:

    B samples     R latent rows     A attention rows     T text tokens     N graph nodes     K diffusion steps
    S context tokens (node tokens first, then the coarser latent's)     L frames     M equal to R, or 1 for all rows

A latent row is one noise prediction (unconditional, one concept, ...). In attention row `a` the latent row `src[a]`
attends to a context of its own, and `combine` mixes the attention outputs back into latent rows.

Bundles of format 3 and 2 name two files of a level by older words, `clock_*` for its modulation and `step_*` for its
denoiser, and their context encoders take no `bias`: each context token is encoded by itself.

Above 500 lines because every graph of our own networks is declared here, input by input.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal, Protocol

from kinegraph.errors import BundleFormatError

FORMAT_VERSION: Final = 5
"""Version of the format that is written; `OLDEST_VERSION` on are read. Format 4 has no graphs of constraints."""
OLDEST_VERSION: Final = 2
"""Format 2 has no coarse decoders and no graphs of adaptive gradient descent."""
CONTEXT_MIXING_VERSION: Final = 4
"""First format whose context tokens attend to one another, and that knows words and partial captions."""

LEVELS: Final[tuple[str, ...]] = ("motion", "action", "specific")
"""Coarse to fine; a level sees the final latent of the one before it."""

COARSE_DECODERS: Final[Mapping[str, str]] = {level: f"decoder_{level}" for level in LEVELS[:-1]}
"""Level -> graph that decodes its latent for a preview; optional."""

DECODER_GRADIENTS: Final[Mapping[str, str]] = {
    level: f"{COARSE_DECODERS.get(level, 'decoder')}_vjp" for level in LEVELS
}
"""Level -> vector-Jacobian product of its decoder, for constraints; a bundle has all or none.

The file holds the graph alone; see `WEIGHT_SOURCES`.
"""

ENCODER: Final = "encoder"
"""Encoder of the finest autoencoder, for edits of clips; optional."""

AGD_CONTEXTS: Final[Mapping[str, str]] = {level: f"context_{level}_agd" for level in LEVELS}
AGD_DENOISERS: Final[Mapping[str, str]] = {level: f"denoiser_{level}_agd" for level in LEVELS}
"""Level -> denoiser with adaptive gradient descent (EnergyMoGen, Eq. 3, 4); a bundle has all `*_agd` graphs or none."""

FRAMES: Final = "frames"
"""Name of the only level of skeleton space (`frames_part`), in options, progress and checkpoints."""
FRAMES_DENOISER: Final = f"{FRAMES}_denoiser"
FRAMES_CONTEXT_AGD: Final = f"{FRAMES}_context_agd"
FRAMES_DENOISER_AGD: Final = f"{FRAMES}_denoiser_agd"
FRAME_GRAPHS: Final = (
    f"{FRAMES}_context",
    f"{FRAMES}_modulation",
    FRAMES_DENOISER,
    FRAMES_CONTEXT_AGD,
    FRAMES_DENOISER_AGD,
)
"""Names of the graphs of skeleton space; a bundle has all or none. Each is read at its first use."""
FRAME_FILES: Final = frozenset(f"{graph}.onnx" for graph in FRAME_GRAPHS)

WEIGHT_SOURCES: Final[Mapping[str, str]] = {
    **{name: name.removesuffix("_vjp") for name in DECODER_GRADIENTS.values()},
    **{name: f"denoiser_{level}" for level, name in AGD_DENOISERS.items()},
    FRAMES_DENOISER_AGD: FRAMES_DENOISER,
}
"""Graph -> graph whose file has the weights that its own file lacks (`onnx_inspect.with_initializers`)."""

KINDS: Final[Mapping[str, int]] = {"motion": 0, "action": 1, "specific": 2, "null": 3, "word": 4, "partial": 5}
"""Kind of a context token -> its number in the `kind` input of a context graph.

Motion, action and specific are nodes of the graph (GraphMotion, 3.1), a word is one word piece of the caption beside
them. Null is the learned token of unconditional rows, and partial a learned token in the sentence's place, for a
caption that may name only a part of what happens; the features of both are ignored.
"""

NODE_KINDS: Final[tuple[str, ...]] = ("motion", "action", "specific", "word")
"""Kinds that a level may attend to, in the order of their numbers."""

NULL_KIND: Final = KINDS["null"]
PARTIAL_KIND: Final = KINDS["partial"]

MODULATIONS: Final = 6
"""Per layer of a denoiser: scale and shift before self-attention, before cross-attention and before feed-forward."""

FLOAT: Final = "float32"
INT: Final = "int64"

TOLERANCE: Final = 1e-4
"""Largest allowed absolute difference of an fp32 export from the trained modules."""

PADDING_BIAS: Final = -1e4
"""Attention bias of padding tokens; -inf would turn a row of padding into NaN."""

_ORT_TYPES: Final[Mapping[str, str]] = {FLOAT: "tensor(float)", INT: "tensor(int64)"}


class Tensor(Protocol):
    """Description of one input or output of a session (`onnxruntime.NodeArg`)."""

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
    """Layers, each with cross-attention to one key and one value."""
    nodes: tuple[str, ...]
    """Kinds of context tokens that the level attends to besides the learned ones, of `NODE_KINDS`."""

    @property
    def modulations(self) -> int:
        """Rows of the `modulation` tensor: scales and shifts of all layers."""
        return MODULATIONS * self.layers


@dataclass(frozen=True)
class TensorSpec:
    """Name, axes and type of one input or output."""

    name: str
    axes: tuple[str | int, ...]
    """A number for a fixed size, a name for a free one."""
    dtype: str = FLOAT


@dataclass(frozen=True)
class GraphContract:
    """Signature of one ONNX graph."""

    name: str
    inputs: tuple[TensorSpec, ...]
    outputs: tuple[TensorSpec, ...]
    tolerance: float = TOLERANCE
    version: int = FORMAT_VERSION
    """Format of the bundle."""

    @property
    def file(self) -> str:
        """Name of the graph's file in a bundle."""
        return graph_file(self.name, self.version)


_OLDER_NAMES: Final[Mapping[str, str]] = {"modulation": "clock", "denoiser": "step"}


def graph_file(name: str, version: int = FORMAT_VERSION) -> str:
    """Name the file of a graph in a bundle of a format version."""
    part, _, level = name.partition("_")
    if version < CONTEXT_MIXING_VERSION and part in _OLDER_NAMES:
        return f"{_OLDER_NAMES[part]}_{level}.onnx"
    return f"{name}.onnx"


def text_encoder(text_width: int) -> GraphContract:
    """Declare the text encoder.

    `hidden` holds the token states. `pooled` is their mean over unmasked tokens, special ones included, not normalised;
    CLIP's is the projected state of its end token.

    Args:
        text_width: D.
    """
    tokens = (TensorSpec("input_ids", ("B", "T"), INT), TensorSpec("attention_mask", ("B", "T"), INT))
    outputs = (TensorSpec("hidden", ("B", "T", text_width)), TensorSpec("pooled", ("B", text_width)))
    return GraphContract("text_encoder", tokens, outputs)


def graph_encoder(text_width: int) -> GraphContract:
    """Declare the graph attention network (GraphMotion, Eq. 1-3).

    `relation` is the number of an edge's role, or -1 where there is no edge. `node_mask` is 1 on nodes, 0 on padding;
    `nodes_out` is 0 on padding.

    Args:
        text_width: D.
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


def _context_inputs(text_width: int, coarse: LevelSpec | None, version: int) -> tuple[TensorSpec, ...]:
    inputs = [
        TensorSpec("nodes", ("B", "N", text_width)),
        TensorSpec("kind", ("B", "N"), INT),
        TensorSpec("order", ("B", "N"), INT),
    ]
    if version >= CONTEXT_MIXING_VERSION:
        # Without a coarser latent the context tokens are the nodes.
        inputs.append(TensorSpec("bias", ("B", "N" if coarse is None else "S")))
    if coarse is not None:
        inputs.append(TensorSpec("coarse", ("B", coarse.tokens, coarse.latent_width)))
    return tuple(inputs)


def context(
    name: str, level: LevelSpec, text_width: int, coarse: LevelSpec | None, version: int = FORMAT_VERSION
) -> GraphContract:
    """Declare the context encoder of one level: keys and values for cross-attention, computed once per sample.

    The context tokens attend to one another first. `bias` is added to the logits, as in `denoiser`: the log path weight
    of each token, `PADDING_BIAS` on those that are hidden.

    Args:
        name: one of `LEVELS`.
        level: dimensions of that level.
        text_width: D, width of the graph encoder's nodes.
        coarse: the coarser level, whose latent is an input; None at the motion level.
        version: format of the bundle.
    """
    inputs = _context_inputs(text_width, coarse, version)
    return GraphContract(f"context_{name}", inputs, _keys_values(level, "B"), version=version)


def context_agd(
    name: str, level: LevelSpec, text_width: int, coarse: LevelSpec | None, version: int = FORMAT_VERSION
) -> GraphContract:
    """Declare `context` for adaptive gradient descent.

    Its output is the context tokens themselves, because the denoiser updates them before it computes keys and values.
    Arguments as for `context`.
    """
    tokens = (TensorSpec("context", ("B", "S", level.width)),)
    inputs = _context_inputs(text_width, coarse, version)
    return GraphContract(AGD_CONTEXTS[name], inputs, tokens, version=version)


def modulation(name: str, level: LevelSpec) -> GraphContract:
    """Declare the AdaLN modulation of one level: scale and shift of every layer normalisation.

    It runs once per call, for all diffusion steps and clip lengths together. Arguments as for `context`.
    """
    inputs = (TensorSpec("timestep", ("K",), INT), TensorSpec("frames", ("B",), INT))
    outputs = (TensorSpec("modulation", ("K", "B", level.modulations, level.width)),)
    return GraphContract(f"modulation_{name}", inputs, outputs)


def denoiser(name: str, level: LevelSpec) -> GraphContract:
    """Declare the denoiser of one level: it predicts the noise in R latent rows at one diffusion step.

    `bias` is added to the attention logits: the log edge weight of each context token, `PADDING_BIAS` on padding.
    Arguments as for `context`.
    """
    return _denoiser(f"denoiser_{name}", level, _keys_values(level, "A"))


def denoiser_agd(name: str, level: LevelSpec) -> GraphContract:
    """Declare `denoiser` with adaptive gradient descent (EnergyMoGen, Eq. 3, 4).

    Each layer updates the context that the next one attends to. `gamma` holds the step sizes gamma_attn and
    gamma_reg. Arguments as for `context`.
    """
    attended = (TensorSpec("context", ("A", "S", level.width)), TensorSpec("gamma", ("A", 2)))
    return _denoiser(AGD_DENOISERS[name], level, attended)


def _denoiser(graph: str, level: LevelSpec, attended: tuple[TensorSpec, ...]) -> GraphContract:
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
    """Declare the decoder of one level: normalised motion features from its latent.

    `frame_mask` is 1 on frames, 0 on padding; L is a multiple of the bundle's frames per token.

    Args:
        name: of the graph: "decoder" for the finest level, else one of `COARSE_DECODERS`.
        level: dimensions of the level.
        features: F, width of the feature layout.
    """
    inputs = (
        TensorSpec("latent", ("B", level.tokens, level.latent_width)),
        TensorSpec("frame_mask", ("B", "L")),
    )
    return GraphContract(name, inputs, (TensorSpec("features", ("B", "L", features)),))


def decoder_gradient(name: str, level: LevelSpec, features: int) -> GraphContract:
    """Declare the vector-Jacobian product of one level's decoder: dE/dz from dE/dfeatures.

    `cotangent` is dE/dfeatures for the normalised features of `decoder`; `gradient` is dE/dlatent. The graph has
    the features as its tensor `features`, where it is split (`onnx_split`).

    Args:
        name: one of `LEVELS`.
        level: dimensions of the level.
        features: F, width of the feature layout.
    """
    latent = ("B", level.tokens, level.latent_width)
    inputs = (
        TensorSpec("latent", latent),
        TensorSpec("frame_mask", ("B", "L")),
        TensorSpec("cotangent", ("B", "L", features)),
    )
    return GraphContract(DECODER_GRADIENTS[name], inputs, (TensorSpec("gradient", latent),))


def encoder(level: LevelSpec, features: int) -> GraphContract:
    """Declare the encoder of the finest level: the mean latent, standardised, of normalised motion features.

    Args:
        level: dimensions of the level.
        features: F, width of the feature layout.
    """
    inputs = (TensorSpec("features", ("B", "L", features)), TensorSpec("frame_mask", ("B", "L")))
    return GraphContract(ENCODER, inputs, (TensorSpec("latent", ("B", level.tokens, level.latent_width)),))


def contracts(
    levels: Mapping[str, LevelSpec], text_width: int, features: int, version: int = FORMAT_VERSION
) -> dict[str, GraphContract]:
    """Declare every graph that a bundle may hold, by name, in order of execution; the optional ones come last.

    Args:
        levels: one spec for each of `LEVELS`.
        text_width: D, width of the text encoder.
        features: F, width of the feature layout.
        version: format of the bundle.
    """
    graphs = [text_encoder(text_width), graph_encoder(text_width)]
    agd_graphs: list[GraphContract] = []
    coarse: LevelSpec | None = None
    for name in LEVELS:
        level = levels[name]
        graphs += [context(name, level, text_width, coarse, version), modulation(name, level), denoiser(name, level)]
        agd_graphs += [context_agd(name, level, text_width, coarse, version), denoiser_agd(name, level)]
        coarse = level
    graphs.append(decoder("decoder", levels[LEVELS[-1]], features))
    graphs += [decoder(graph, levels[level], features) for level, graph in COARSE_DECODERS.items()] + agd_graphs
    graphs += [decoder_gradient(level, levels[level], features) for level in LEVELS]
    graphs.append(encoder(levels[LEVELS[-1]], features))
    return {graph.name: replace(graph, version=version) for graph in graphs}


# Families of networks

Family = Literal["kinegraph", "graphmotion", "graphmotion-released", "mld"]
"""Networks of a bundle, and how a sentence reaches them.

- "kinegraph": denoisers with cross-attention to any number of nodes; composes inside its layers.
- "graphmotion": the released GraphMotion, with slots for nodes (`released_contract.SLOTS`); word pieces are found by
  characters, and edges have their types in both halves of guidance, as in its training.
- "graphmotion-released": the same networks as its evaluation runs them, so that published figures hold: the edges of
  specifics lose their types in the conditional half, and word k of the caption reads token k + 1.
- "mld": the released MLD, one level that sees the sentence alone.
"""


def levels_of(family: Family) -> tuple[str, ...]:
    """Return the levels of a family, coarse to fine."""
    return LEVELS[-1:] if family == "mld" else LEVELS


def graphs_of(family: Family) -> tuple[str, ...]:
    """Return the names of all graphs that a bundle of a family must have, in order of execution."""
    levels = levels_of(family)
    parts = ("context", "modulation", "denoiser")
    absent = {f"{part}_{level}" for level in LEVELS if level not in levels for part in parts}
    return tuple(name for name in GRAPHS if name not in absent and (family != "mld" or name != "graph_encoder"))


def optional_graphs_of(family: Family) -> tuple[str, ...]:
    """Return the names of all graphs that a bundle of a family may have."""
    if family == "kinegraph":
        return OPTIONAL_GRAPHS
    return tuple(graph for level, graph in COARSE_DECODERS.items() if level in levels_of(family))


GRAPHS: Final[tuple[str, ...]] = (
    "text_encoder",
    "graph_encoder",
    *(f"{part}_{level}" for level in LEVELS for part in ("context", "modulation", "denoiser")),
    "decoder",
)
"""Names of all graphs that a bundle of our own networks must have, in order of execution."""

OPTIONAL_GRAPHS: Final[tuple[str, ...]] = (
    *COARSE_DECODERS.values(),
    *(names[level] for level in LEVELS for names in (AGD_CONTEXTS, AGD_DENOISERS)),
    *DECODER_GRADIENTS.values(),
    ENCODER,
)
"""Names of all graphs that a bundle may have; each is read at its first use."""


# Files

REQUIRED_TABLES: Final[frozenset[str]] = frozenset(("tokenizer.json", "tables.npz"))
"""Files that every bundle has besides its graphs."""
OPTIONAL_TABLES: Final[frozenset[str]] = frozenset(("parser.bin", "arguments.npz", "vocabulary.npz"))
"""Files besides the graphs that a bundle works without, with limits.

- Without parser.bin it takes graphs, but no plain sentences.
- Without arguments.npz its parser labels arguments by rules.
- Without vocabulary.npz it cannot tell words that it was never shown.
"""


def graph_files(version: int = FORMAT_VERSION, family: Family = "kinegraph") -> tuple[str, ...]:
    """List the files of the graphs that a bundle of a format version must have, in order of execution."""
    return tuple(graph_file(graph, version) for graph in graphs_of(family))


def optional_graph_files(version: int = FORMAT_VERSION, family: Family = "kinegraph") -> frozenset[str]:
    """List the files of the graphs that a bundle of a format version works without, with limits.

    - Without the coarse decoders it shows no clip before the last level is done.
    - Without the graphs of adaptive gradient descent it refuses to compose with `agd`.
    - Without the gradients of the decoders it refuses constraints; without the encoder, edits of clips.
    - Without the graphs of skeleton space it refuses `space="frames"`.
    """
    in_frames = FRAME_FILES if family == "kinegraph" and version == FORMAT_VERSION else frozenset()
    return in_frames.union(graph_file(graph, version) for graph in optional_graphs_of(family))


def agd_files(version: int = FORMAT_VERSION) -> frozenset[str]:
    """List the files of the graphs of adaptive gradient descent, of which a bundle has all or none."""
    return frozenset(graph_file(graph, version) for graph in (*AGD_CONTEXTS.values(), *AGD_DENOISERS.values()))


def gradient_files(version: int = FORMAT_VERSION) -> frozenset[str]:
    """List the files of the decoders' gradients, of which a bundle has all or none."""
    return frozenset(graph_file(graph, version) for graph in DECODER_GRADIENTS.values())


# Sessions


def check_signature(inputs: Iterable[Tensor], outputs: Iterable[Tensor], contract: GraphContract) -> None:
    """Compare a session's inputs and outputs with the contract, by name; their order does not matter.

    Args:
        inputs: `session.get_inputs()`.
        outputs: `session.get_outputs()`.
        contract: the expected signature.

    Raises:
        BundleFormatError: a difference; the message names graph, tensor, expected and actual value.
    """
    _check_side(contract.file, "input", list(inputs), contract.inputs)
    _check_side(contract.file, "output", list(outputs), contract.outputs)


def _check_side(file: str, side: str, tensors: list[Tensor], expected: tuple[TensorSpec, ...]) -> None:
    by_name = {tensor.name: tensor for tensor in tensors}
    names = [spec.name for spec in expected]
    for spec in expected:
        tensor = by_name.get(spec.name)
        if tensor is None:
            raise BundleFormatError(f"{file} has no {side} {spec.name!r}; it has {sorted(by_name)}")
        where = f"{file}: {side} {spec.name!r}"
        if tensor.type != _ORT_TYPES[spec.dtype]:
            raise BundleFormatError(f"{where} should be {_ORT_TYPES[spec.dtype]}, found {tensor.type}")
        if not _same_axes(tensor.shape, spec.axes):
            raise BundleFormatError(f"{where} should have the shape {list(spec.axes)}, found {tensor.shape}")
    for name in by_name:
        if name not in names:
            raise BundleFormatError(f"{file} has an unknown {side} {name!r}; expected are {names}")


def _same_axes(shape: list[int | str | None], expected: tuple[str | int, ...]) -> bool:
    # A number where a name is declared is an axis that the exporter froze at the size of its sample input.
    return len(shape) == len(expected) and all(
        size == axis if isinstance(axis, int) else not isinstance(size, int)
        for size, axis in zip(shape, expected, strict=True)
    )
