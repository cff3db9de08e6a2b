"""From semantic graphs to the conditions of released networks (GraphMotion's code; MLD's has the sentence alone).

They have room for `released_contract.SLOTS`: one sentence, 4 actions, 8 specifics. Guidance leads away from the same
graph with the words of an empty caption, so that every graph is encoded twice:

    caption --text encoder--> features of its nodes       --graph attention--> conditional half
    ""      --table--> states at the same word pieces     --graph attention--> unconditional half

What their evaluation does differently from their training is in the family "graphmotion-released" (`contract.Family`).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinegraph.arrays import FloatArray, IntArray
from kinegraph.bundle.contract import KINDS
from kinegraph.bundle.released_contract import SLOT_COUNT, SLOTS
from kinegraph.bundle.sessions import run_model
from kinegraph.bundle.tables import EMPTY_CAPTION
from kinegraph.conditioning import (
    NO_EDGE,
    ConditionEncoder,
    Conditions,
    GraphArrays,
    make_conditions,
    node_spans,
)
from kinegraph.graph import MOTION_ACTION, OTHERS, ROLE_INDEX, ROLES, SemanticGraph
from kinegraph.text.tokenizer import TokenIds, span_mask

FIRST_ACTION = SLOTS["motion"]
FIRST_SPECIFIC = FIRST_ACTION + SLOTS["action"]
LAST_WORD = 75
"""Largest index of a word that the released code looks up."""
_WORD = re.compile(r"\S+")


@dataclass(frozen=True)
class NodeTokens:
    """Nodes of a caption by the tokens that they are read off, and the edges between actions and specifics."""

    actions: Sequence[Sequence[int]]
    """Indices into the hidden states, for each action."""
    specifics: Sequence[Sequence[int]]
    edges: Sequence[tuple[int, int, str]]
    """(action, specific, role); a specific may belong to several actions, and a pair may have several roles."""


@dataclass(frozen=True)
class SlotGraph(GraphArrays):
    """One graph in its 13 slots; `nodes` are those of the conditional half, `path_weight` is 1 on nodes that exist."""

    null_nodes: FloatArray
    """(13, D) features of the unconditional half."""
    types: FloatArray
    """(12, 13, 13) 1 where there is an edge of a type of `graph.ROLES`; every edge has one."""


@dataclass(frozen=True)
class SlotConditions(Conditions):
    """A batch of encoded graphs; `nodes` are those of the conditional half, `bias` is 0 on nodes that exist."""

    null_nodes: FloatArray
    """(A, 13, D) of the unconditional half."""


class SlotEncoder(ConditionEncoder):
    """The text encoder and the graph attention of a bundle with released networks."""

    def encode_text(self, graphs: Sequence[SemanticGraph], partial: Sequence[bool] = ()) -> list[GraphArrays]:
        """Encode the captions of graphs; these networks cannot be told which of them are `partial`."""
        return [self._encode(graph) for graph in graphs]

    def attend(self, features: Sequence[GraphArrays]) -> SlotConditions:
        """Let the nodes of both halves of each graph attend to one another; one row for each graph.

        Raises:
            ModelError, NonFiniteError: see `bundle.sessions.run_model`.
        """
        graphs = [graph for graph in features if isinstance(graph, SlotGraph)]
        null, nodes = (np.stack(part) for part in zip(*((g.null_nodes, g.nodes) for g in graphs), strict=True))
        if self.sessions.graph_encoder is not None:
            inputs = attention_inputs(graphs, is_released=self.manifest.family == "graphmotion-released")
            (both,) = run_model(self.sessions.graph_encoder, ["nodes_out"], inputs, "the graph encoder")
            null, nodes = both[: len(graphs)], both[len(graphs) :]
        encoded = make_conditions(graphs, nodes)
        return SlotConditions(**vars(encoded), null_nodes=null)

    def left_out(self, graph: SemanticGraph) -> tuple[str, ...]:
        """Tell which nodes of a graph have no slot."""
        arguments = [argument for action in graph.actions for argument in action.arguments]
        texts = [action.text for action in graph.actions[SLOTS["action"] :]]
        texts += [argument.text for argument in arguments[SLOTS["specific"] :]]
        if not texts or self.manifest.family == "mld":
            return ()
        words = ", ".join(map(repr, texts))
        room = f"{SLOTS['action']} actions and {SLOTS['specific']} details"
        return (f"this model has room for {room}; it knows {words} from the sentence as a whole alone",)

    def _encode(self, graph: SemanticGraph) -> SlotGraph:
        tokens = self.tokenizer.encode(graph.caption)
        inputs = {"input_ids": np.array([tokens.ids]), "attention_mask": np.array([tokens.mask])}
        hidden, pooled = run_model(self.sessions.text_encoder, ["hidden", "pooled"], inputs, "the text encoder")
        empty = self.tables[EMPTY_CAPTION]
        by_word = self.manifest.family == "graphmotion-released"
        nodes = tokens_by_word(graph) if by_word else tokens_by_character(graph, tokens)
        return slot_graph(nodes, (hidden[0], pooled[0]), (empty[1:], empty[0]))


def tokens_by_character(graph: SemanticGraph, tokens: TokenIds) -> NodeTokens:
    """Find the word pieces of every node by its characters."""
    pieces = [np.flatnonzero(span_mask(tokens.offsets, *span)).tolist() for span in node_spans(graph)]
    return _split(graph, pieces)


def tokens_by_word(graph: SemanticGraph) -> NodeTokens:
    """Find the tokens of every node as the released code does: word k of the caption, split at blanks, is token k + 1.

    A word of several pieces shifts all words after it.
    """
    words = [match.span() for match in _WORD.finditer(graph.caption)]
    spans = [
        [k + 1 for k, (first, last) in enumerate(words) if first < end and last > start and k <= LAST_WORD]
        for start, end in node_spans(graph)
    ]
    return _split(graph, spans)


def _split(graph: SemanticGraph, tokens: Sequence[Sequence[int]]) -> NodeTokens:
    """Divide the tokens of all nodes, in node order, between actions and specifics."""
    count = len(graph.actions)
    roles = [(index, argument.role) for index, action in enumerate(graph.actions) for argument in action.arguments]
    edges = [(action, specific, role) for specific, (action, role) in enumerate(roles)]
    return NodeTokens(tokens[:count], tokens[count:], edges)


def slot_graph(
    nodes: NodeTokens, conditional: tuple[FloatArray, FloatArray], unconditional: tuple[FloatArray, FloatArray]
) -> SlotGraph:
    """Put nodes into their slots, first come first kept.

    A node's feature is the mean of the states of its tokens; without any, and in an empty slot, it is the sentence's.

    Args:
        nodes: of a caption.
        conditional: hidden states (T, D) of the caption, and its sentence feature (D,).
        unconditional: the same of an empty caption, at as many positions or more.
    """
    kept = {FIRST_ACTION: nodes.actions[: SLOTS["action"]], FIRST_SPECIFIC: nodes.specifics[: SLOTS["specific"]]}
    slots = {first + index: tokens for first, part in kept.items() for index, tokens in enumerate(part)}
    exists = np.zeros(SLOT_COUNT, dtype=np.float32)
    exists[[0, *slots]] = 1.0
    types = _edge_types(nodes, slots)
    relation = np.where(types.any(axis=0), types.argmax(axis=0), NO_EDGE).astype(np.int64)
    order, kind = np.zeros(SLOT_COUNT, dtype=np.int64), slot_kinds()
    null, features = (_slot_features(slots, *half) for half in (unconditional, conditional))
    owner = np.arange(SLOT_COUNT)
    return SlotGraph(features, relation, np.ones_like(types[0]), kind, order, exists, owner, null, types)


def slot_kinds() -> IntArray:
    """Return the kind of each slot: (13,), see `contract.KINDS`."""
    return np.repeat([KINDS[name] for name in SLOTS], list(SLOTS.values())).astype(np.int64)


def _slot_features(slots: dict[int, Sequence[int]], hidden: FloatArray, sentence: FloatArray) -> FloatArray:
    features = np.tile(sentence, (SLOT_COUNT, 1)).astype(np.float32)
    for slot, tokens in slots.items():
        known = [token for token in tokens if token < len(hidden)]
        if known:
            features[slot] = hidden[known].mean(axis=0)
    return features


def _edge_types(nodes: NodeTokens, slots: dict[int, Sequence[int]]) -> FloatArray:
    """Draw the edges (12, 13, 13): sentence to itself and to actions, self-loops of nodes with tokens, roles."""
    types = np.zeros((len(ROLES), SLOT_COUNT, SLOT_COUNT), dtype=np.float32)
    types[ROLE_INDEX[MOTION_ACTION], 0, 0] = 1.0
    for slot, tokens in slots.items():
        if tokens:
            types[ROLE_INDEX[OTHERS], slot, slot] = 1.0
        if slot < FIRST_SPECIFIC:
            types[ROLE_INDEX[MOTION_ACTION], [0, slot], [slot, 0]] = 1.0
    for action, specific, role in nodes.edges:
        pair = (FIRST_ACTION + action, FIRST_SPECIFIC + specific)
        if action < SLOTS["action"] and specific < SLOTS["specific"]:
            types[ROLE_INDEX[role], pair, pair[::-1]] = 1.0
    return types


def attention_inputs(graphs: Sequence[SlotGraph], *, is_released: bool) -> dict[str, FloatArray]:
    """Stack the inputs of graph attention: the unconditional halves of all graphs, then the conditional ones.

    Args:
        graphs: B of them.
        is_released: take the types of the edges between actions and specifics away from the conditional halves, as the
            released evaluation does; the edges stay.

    Returns:
        nodes (2B, 13, D), adjacency (2B, 13, 13), relations (2B, 12, 13, 13).
    """
    types = np.stack([graph.types for graph in graphs])
    conditional = types.copy()
    if is_released:
        conditional[:, :, FIRST_ACTION:FIRST_SPECIFIC, FIRST_SPECIFIC:] = 0.0
        conditional[:, :, FIRST_SPECIFIC:, FIRST_ACTION:FIRST_SPECIFIC] = 0.0
    nodes = np.stack([*(graph.null_nodes for graph in graphs), *(graph.nodes for graph in graphs)])
    adjacency = types.any(axis=1).astype(np.float32)
    return {
        "nodes": nodes,
        "adjacency": np.concatenate([adjacency, adjacency]),
        "relations": np.concatenate([types, conditional]),
    }
