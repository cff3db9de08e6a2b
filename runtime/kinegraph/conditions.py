"""From a semantic graph to what the denoisers attend to (GraphMotion, section 3.1).

    caption -> hidden states -> node features -> graph attention -> per level: nodes, kinds, orders, log weights

Nodes are ordered motion, actions, specifics, so that what a level sees is a prefix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinegraph.contract import NODE_KINDS, NULL_KIND, PADDING_BIAS
from kinegraph.graph import SemanticGraph
from kinegraph.text.roles import MOTION_ACTION, OTHERS, ROLE_INDEX
from kinegraph.text.tokens import TokenIds, span_mask

FloatArray = NDArray[np.float32]
IntArray = NDArray[np.int64]
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


def structure(graph: SemanticGraph) -> tuple[IntArray, FloatArray, IntArray, IntArray, FloatArray]:
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


def spans(graph: SemanticGraph) -> list[tuple[int, int]]:
    """Character spans of the nodes below the motion node, in node order."""
    of_actions = [(action.start, action.end) for action in graph.actions]
    return of_actions + [(part.start, part.end) for action in graph.actions for part in action.arguments]


def graph_arrays(graph: SemanticGraph, tokens: TokenIds, hidden: FloatArray, pooled: FloatArray) -> GraphArrays:
    """Node features by character offsets: the motion node is the sentence, the others mean over their pieces.

    Args:
        graph: of the caption that was encoded.
        tokens: its word pieces with offsets, T of them.
        hidden: (T, D) hidden states.
        pooled: (D,) their mean, the motion node. A span without a piece of its own falls back to it.
    """
    nodes = [pooled]
    for start, end in spans(graph):
        pieces = span_mask(tokens.offsets, start, end)
        nodes.append(hidden[pieces].mean(axis=0) if pieces.any() else pooled)
    relation, weight, kind, order, path = structure(graph)
    return GraphArrays(np.stack(nodes).astype(np.float32), relation, weight, kind, order, path)


def padded(arrays: Sequence[GraphArrays]) -> dict[str, NDArray[np.float32] | NDArray[np.int64]]:
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


def without_text(batch: Conditions) -> Conditions:
    """Row by row, one learned null token in place of the graph; the coarser latent stays."""
    kind = np.full_like(batch.kind, NULL_KIND)
    bias = np.full_like(batch.bias, PADDING_BIAS)
    bias[:, 0] = 0.0
    return Conditions(np.zeros_like(batch.nodes), kind, np.zeros_like(batch.order), bias, batch.coarse_bias)


def without_anything(batch: Conditions) -> Conditions:
    """GraphMotion's empty set (Eq. A), row by row: no text and no coarser latent."""
    return replace(without_text(batch), coarse_bias=np.full_like(batch.coarse_bias, PADDING_BIAS))


def repeated(batch: Conditions, count: int) -> Conditions:
    """Every row `count` times."""
    return Conditions(*(np.repeat(part, count, axis=0) for part in vars(batch).values()))


def stacked(first: Conditions, second: Conditions) -> Conditions:
    """Rows of `first`, then rows of `second`, of equal N."""
    parts = zip(vars(first).values(), vars(second).values(), strict=True)
    return Conditions(*(np.concatenate(pair) for pair in parts))
