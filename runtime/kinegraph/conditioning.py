"""From a semantic graph to what the denoisers attend to (GraphMotion, section 3.1).

    caption -> hidden states -> node features -> graph attention -> per level: nodes, kinds, orders, log weights

Nodes are ordered motion, actions, specifics, so that what a level sees is a prefix.

Captions -> node features: tokens, text encoder, means over character spans (GraphMotion, section 3.1).

How long a clip should be when nobody says: a linear model of the logarithm of its frames, learnt from the data.

The text encoder and graph attention (GraphMotion, section 3.1): from graphs to what the denoisers attend to, and to
how long a clip of them should be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from kinegraph.arrays import FloatArray, IntArray, require_finite
from kinegraph.bundle.contract import NODE_KINDS, NULL_KIND, PADDING_BIAS
from kinegraph.bundle.manifest import Manifest
from kinegraph.bundle.sessions import Sessions
from kinegraph.bundle.tables import DURATION
from kinegraph.concepts import CompositionSpec, weighted_edge_terms
from kinegraph.diffusion.composition import CompositionWeights
from kinegraph.errors import InvalidInputError
from kinegraph.graph import MOTION_ACTION, OTHERS, ROLE_INDEX, SemanticGraph
from kinegraph.options import GenerateOptions
from kinegraph.text.tokenizer import CaptionTokenizer, TokenIds, span_mask

MOTION, ACTION, SPECIFIC = range(len(NODE_KINDS))
NO_EDGE = -1


@dataclass(frozen=True)
class GraphArrays:
    """One graph as arrays; N nodes of width D."""

    nodes: FloatArray
    """(N, D) features before graph attention."""
    relation: IntArray
    """(N, N) role numbers, -1 where there is no edge."""
    edge_weight: FloatArray
    """(N, N), symmetric, 1 on self-loops."""
    kind: IntArray
    """(N,) index into `contract.NODE_KINDS`."""
    order: IntArray
    """(N,) 0 for the motion node, else 1 + the order of the node's action."""
    path_weight: FloatArray
    """(N,) product of edge weights from the motion node."""


@dataclass(frozen=True)
class Conditions:
    """A batch of encoded graphs, padded to N nodes."""

    nodes: FloatArray
    """(A, N, D) after graph attention."""
    kind: IntArray
    """(A, N)."""
    order: IntArray
    """(A, N)."""
    bias: FloatArray
    """(A, N) log path weight; PADDING_BIAS on padding."""
    coarse_bias: FloatArray
    """(A, 1) 0 where the coarser latent is seen too, PADDING_BIAS where it is not."""


def graph_structure(graph: SemanticGraph) -> tuple[IntArray, FloatArray, IntArray, IntArray, FloatArray]:
    """Relation, edge weight, kind, order and path weight of a graph: everything but features.

    Edges run both ways (motion-action as ARGM-MA, action-argument with its role) and every node has a self-loop
    of type OTHERS.
    """
    actions = len(graph.actions)
    count = graph.node_count
    relation = np.full((count, count), NO_EDGE, dtype=np.int64)
    weight = np.ones((count, count), dtype=np.float32)
    np.fill_diagonal(relation, ROLE_INDEX[OTHERS])
    kind = np.array([MOTION] + [ACTION] * actions + [SPECIFIC] * (count - 1 - actions), dtype=np.int64)
    order = np.zeros(count, dtype=np.int64)
    path = np.ones(count, dtype=np.float32)

    def connect(parent: int, child: int, role: str, value: float, place: int) -> None:
        relation[parent, child] = relation[child, parent] = ROLE_INDEX[role]
        weight[parent, child] = weight[child, parent] = value
        path[child] = path[parent] * value
        order[child] = 1 + place

    specific = 1 + actions
    for node, action in enumerate(graph.actions, start=1):
        connect(0, node, MOTION_ACTION, action.weight, action.order)
        for argument in action.arguments:
            connect(node, specific, argument.role, argument.weight, action.order)
            specific += 1
    return relation, weight, kind, order, path


def node_spans(graph: SemanticGraph) -> list[tuple[int, int]]:
    """Character spans of the nodes below the motion node, in node order."""
    of_actions = [(action.start, action.end) for action in graph.actions]
    return of_actions + [(part.start, part.end) for action in graph.actions for part in action.arguments]


def node_features(graph: SemanticGraph, tokens: TokenIds, hidden: FloatArray, pooled: FloatArray) -> GraphArrays:
    """Node features by character offsets: the motion node is the sentence, the others mean over their pieces.

    Args:
        graph: of the caption that was encoded.
        tokens: its word pieces with offsets, T of them.
        hidden: (T, D) hidden states.
        pooled: (D,) their mean, the motion node. A span without a piece of its own falls back to it.
    """
    nodes = [pooled]
    for start, end in node_spans(graph):
        pieces = span_mask(tokens.offsets, start, end)
        nodes.append(hidden[pieces].mean(axis=0) if pieces.any() else pooled)
    relation, weight, kind, order, path = graph_structure(graph)
    return GraphArrays(np.stack(nodes).astype(np.float32), relation, weight, kind, order, path)


def pad_graphs(arrays: Sequence[GraphArrays]) -> dict[str, NDArray[np.float32] | NDArray[np.int64]]:
    """Inputs of the graph encoder for a batch: nodes, relation, edge_weight, node_mask."""
    batch, count = len(arrays), max(len(graph.kind) for graph in arrays)
    width = arrays[0].nodes.shape[1]
    nodes = np.zeros((batch, count, width), dtype=np.float32)
    relation = np.full((batch, count, count), NO_EDGE, dtype=np.int64)
    weight = np.ones((batch, count, count), dtype=np.float32)
    mask = np.zeros((batch, count), dtype=np.float32)
    for row, graph in enumerate(arrays):
        size = len(graph.kind)
        nodes[row, :size] = graph.nodes
        relation[row, :size, :size] = graph.relation
        weight[row, :size, :size] = graph.edge_weight
        mask[row, :size] = 1.0
    return {"nodes": nodes, "relation": relation, "edge_weight": weight, "node_mask": mask}


def conditions(arrays: Sequence[GraphArrays], encoded: FloatArray) -> Conditions:
    """What the denoisers attend to, given the graph encoder's output (A, N, D)."""
    batch, count = encoded.shape[:2]
    kind = np.zeros((batch, count), dtype=np.int64)
    order = np.zeros((batch, count), dtype=np.int64)
    bias = np.full((batch, count), PADDING_BIAS, dtype=np.float32)
    for row, graph in enumerate(arrays):
        size = len(graph.kind)
        kind[row, :size] = graph.kind
        order[row, :size] = graph.order
        bias[row, :size] = log_weight(graph.path_weight)
    return Conditions(encoded, kind, order, bias, np.zeros((batch, 1), dtype=np.float32))


def log_weight(weight: FloatArray) -> FloatArray:
    """log w, with PADDING_BIAS for w = 0: a node of no weight is exactly a node that is not there."""
    return np.log(weight, out=np.full_like(weight, PADDING_BIAS), where=weight > 0).clip(min=PADDING_BIAS)


def for_level(batch: Conditions, kinds: Sequence[str]) -> Conditions:
    """The nodes a level sees; the rest is cut off, or masked where another row of the batch needs the place."""
    seen = np.isin(batch.kind, [NODE_KINDS.index(name) for name in kinds]) & (batch.bias > PADDING_BIAS / 2)
    count = int(np.flatnonzero(seen.any(axis=0)).max(initial=0)) + 1
    bias = np.where(seen, batch.bias, np.float32(PADDING_BIAS))
    nodes, kind, order = batch.nodes[:, :count], batch.kind[:, :count], batch.order[:, :count]
    return Conditions(nodes, kind, order, bias[:, :count], batch.coarse_bias)


def drop_text(batch: Conditions) -> Conditions:
    """Row by row, one learned null token in place of the graph; the coarser latent stays."""
    kind = np.full_like(batch.kind, NULL_KIND)
    bias = np.full_like(batch.bias, PADDING_BIAS)
    bias[:, 0] = 0.0
    return Conditions(np.zeros_like(batch.nodes), kind, np.zeros_like(batch.order), bias, batch.coarse_bias)


def drop_all(batch: Conditions) -> Conditions:
    """GraphMotion's empty set (Eq. A), row by row: no text and no coarser latent."""
    return replace(drop_text(batch), coarse_bias=np.full_like(batch.coarse_bias, PADDING_BIAS))


def repeated(batch: Conditions, count: int) -> Conditions:
    """Every row `count` times."""
    return Conditions(*(np.repeat(part, count, axis=0) for part in vars(batch).values()))


def stacked(first: Conditions, second: Conditions) -> Conditions:
    """Rows of `first`, then rows of `second`, of equal N."""
    parts = zip(vars(first).values(), vars(second).values(), strict=True)
    return Conditions(*(np.concatenate(pair) for pair in parts))


def caption_arrays(
    encoder: onnxruntime.InferenceSession, tokenizer: CaptionTokenizer, graph: SemanticGraph
) -> GraphArrays:
    """A graph with the features of its caption.

    One caption a run: among others its sums are rounded in another order, and what the encoder then rounds to int8 can
    be a whole step off (measured: .03 of a state, 5 mm in a clip). A shared run would save a sixth of the encoder.

    Args:
        encoder: session of the text encoder.
        tokenizer: of the same bundle.
    """
    tokens = tokenizer.encode(graph.caption)
    feeds = {"input_ids": np.array([tokens.ids]), "attention_mask": np.array([tokens.mask])}
    hidden, pooled = encoder.run(["hidden", "pooled"], feeds)
    return node_features(graph, tokens, hidden[0], pooled[0])


def duration_inputs(graph: GraphArrays) -> NDArray[np.float64]:
    """What the length is read off: (D + 3,); the sentence is the motion node before graph attention."""
    counts = [np.count_nonzero(graph.kind == ACTION), len(graph.kind), 1]
    return np.concatenate([graph.nodes[0].astype(np.float64), counts])


def expected_frames(weights: FloatArray, graphs: Sequence[GraphArrays], shortest: int, longest: int) -> int:
    """Frames for the longest of some sentences, within what the model takes.

    Args:
        weights: (1, D + 3), log frames = weights . inputs.
        graphs: of the sentences that the clip is for.
        shortest: fewest frames.
        longest: most frames.
    """
    logs = [float(weights[0].astype(np.float64) @ duration_inputs(graph)) for graph in graphs]
    # clipped before exp: a sentence unlike any other must not overflow
    return int(np.clip(round(np.exp(np.clip(max(logs), 0.0, 20.0))), shortest, longest))


def with_own_length(
    options: GenerateOptions, weights: FloatArray | None, manifest: Manifest, arrays: Sequence[GraphArrays]
) -> GenerateOptions:
    """The length that the longest of some sentences asks for; as it is, where the bundle cannot tell."""
    if weights is None:
        return options
    frames = expected_frames(weights, arrays, manifest.frames.min, manifest.frames.max)
    return replace(options, frames=frames, seconds=frames / manifest.fps)


@dataclass(frozen=True)
class Encoders:
    """From graphs to conditions. Where the caller gave no length (`own_length`), options come back with the sentences'
    own, as far as the bundle can tell."""

    sessions: Sessions
    tokenizer: CaptionTokenizer
    manifest: Manifest
    tables: Mapping[str, FloatArray]

    def arrays(self, graph: SemanticGraph) -> GraphArrays:
        """A graph with the features of its caption."""
        return caption_arrays(self.sessions.text_encoder, self.tokenizer, graph)

    def conditions(self, arrays: Sequence[GraphArrays]) -> Conditions:
        """Graph attention over a batch of graphs."""
        (nodes,) = self.sessions.graph_encoder.run(["nodes_out"], pad_graphs(arrays))
        return conditions(arrays, require_finite(nodes, "the graph encoder"))

    def weighted(
        self, graph: SemanticGraph, options: GenerateOptions, own_length: bool
    ) -> tuple[Conditions, CompositionWeights, GenerateOptions]:
        """One graph: a row and a weight for each of the graphs that its weights stand for
        (`edits.weighted_edge_terms`)."""
        terms = weighted_edge_terms(graph)
        arrays = [self.arrays(term) for term, _ in terms]
        options = self._own_length(options, arrays[:1]) if own_length else options
        return self.conditions(arrays), CompositionWeights(tuple(weight for _, weight in terms)), options

    def side_by_side(
        self, graphs: Sequence[SemanticGraph], options: Sequence[GenerateOptions], own_length: Sequence[bool]
    ) -> tuple[Conditions, list[GenerateOptions]]:
        """A row for each graph.

        Raises:
            InvalidInputError: a graph weighs its edges, for which it would need several rows.
        """
        if any(node.weight != 1 for graph in graphs for node in graph.nodes):
            raise InvalidInputError("clips that share one run cannot weigh edges; make weighted clips one by one")
        arrays = [self.arrays(graph) for graph in graphs]
        own = [
            self._own_length(each, [known]) if unsaid else each
            for each, known, unsaid in zip(options, arrays, own_length, strict=True)
        ]
        return self.conditions(arrays), own

    def mixed(
        self, what: CompositionSpec, graphs: Sequence[SemanticGraph], options: GenerateOptions, own_length: bool
    ) -> tuple[Conditions, CompositionWeights, GenerateOptions]:
        """What is composed: rows in the order of the mixture, for the `graphs` of its parts. The concepts that should
        happen tell the length."""
        terms = [weighted_edge_terms(graph) for graph in graphs]
        arrays = [[self.arrays(term) for term, _ in own] for own in terms]
        if own_length:
            wanted = [own[0] for own, concept in zip(arrays, what.concepts, strict=False) if concept.weight > 0]
            options = self._own_length(options, wanted)
        encoded = self.conditions([each for own in arrays for each in own])
        return encoded, what.mixture([[part for _, part in own] for own in terms]), options

    def _own_length(self, options: GenerateOptions, arrays: Sequence[GraphArrays]) -> GenerateOptions:
        return with_own_length(options, self.tables.get(DURATION), self.manifest, arrays)
