"""From semantic graphs to the conditions that denoisers attend to (GraphMotion, section 3.1).

    caption --text encoder--> hidden states --means over spans--> node features --graph attention--> conditions

Nodes are ordered motion, actions, specifics. The words of the caption stand behind them as nodes without neighbours: a
mean over "both hands above the head" loses what its words say. The features of a sentence also tell how long its clip
should be, where the caller does not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Self, TypeVar

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from kinegraph.arrays import DoubleArray, FloatArray, IntArray
from kinegraph.bundle.contract import KINDS, NULL_KIND, PADDING_BIAS, PARTIAL_KIND
from kinegraph.bundle.manifest import Manifest
from kinegraph.bundle.sessions import Sessions, run_model
from kinegraph.bundle.tables import DURATION
from kinegraph.graph import MOTION_ACTION, OTHERS, ROLE_INDEX, SemanticGraph
from kinegraph.options import GenerateOptions
from kinegraph.text.tokenizer import CaptionTokenizer, TokenIds, span_mask

MOTION, ACTION, SPECIFIC, WORD = (KINDS[name] for name in ("motion", "action", "specific", "word"))
NO_EDGE = -1


@dataclass(frozen=True)
class GraphArrays:
    """One graph as arrays: N nodes with features of width D."""

    nodes: FloatArray
    """(N, D) features before graph attention."""
    relation: IntArray
    """(N, N) index of the edge's role, -1 where there is no edge."""
    edge_weight: FloatArray
    """(N, N) symmetric, 1 on self-loops."""
    kind: IntArray
    """(N,) see `contract.KINDS`."""
    order: IntArray
    """(N,) 0 for the motion node, else 1 + the order of the node's action; a word has that of its node."""
    path_weight: FloatArray
    """(N,) product of the edge weights from the motion node; a word has that of its node."""
    owner: IntArray
    """(N,) number of the node that a word hangs on; of a node its own."""

    @property
    def node_count(self) -> int:
        """Number of nodes of the graph, without words."""
        return int(np.count_nonzero(self.kind != WORD))


@dataclass(frozen=True)
class Conditions:
    """A batch of A encoded graphs, padded to N nodes."""

    nodes: FloatArray
    """(A, N, D) after graph attention."""
    kind: IntArray
    """(A, N) see `contract.KINDS`."""
    order: IntArray
    """(A, N) 0 for the motion node, else 1 + the order of the node's action."""
    bias: FloatArray
    """(A, N) log path weight; PADDING_BIAS on padding."""
    coarse_bias: FloatArray
    """(A, 1) 0 where the coarser latent is seen too, PADDING_BIAS where it is not."""

    def map(self, function: Callable[[NDArray[Any]], NDArray[Any]]) -> Self:
        """Apply a function to every array."""
        return type(self)(**{field.name: function(getattr(self, field.name)) for field in fields(self)})


Rows = TypeVar("Rows", bound=Conditions)


@dataclass(frozen=True)
class ConditionEncoder:
    """The text encoder and the graph attention of a bundle."""

    sessions: Sessions
    tokenizer: CaptionTokenizer
    manifest: Manifest
    tables: Mapping[str, FloatArray]
    """Arrays of `tables.npz`; the duration model is one of them."""

    def encode_text(self, graphs: Sequence[SemanticGraph], partial: Sequence[bool] = ()) -> list[GraphArrays]:
        """Encode the captions of graphs and read their node features off the hidden states.

        Args:
            graphs: of the captions.
            partial: for each graph whether its caption names only a part of what happens (`as_partial`); none by
                default. Bundles before format 4 have no token for it, and take such captions for whole ones.
        """
        words = self.manifest.attends_to_words
        arrays = [encode_caption(self.sessions.text_encoder, self.tokenizer, graph, words=words) for graph in graphs]
        if not partial or not self.manifest.knows_partial_captions:
            return arrays
        return [as_partial(graph) if is_part else graph for graph, is_part in zip(arrays, partial, strict=True)]

    def embed(self, sentences: Sequence[str]) -> FloatArray:
        """Encode sentences to (n, D), each of length 1, in one run; see `text.vocabulary.PhraseEncoder`.

        Raises:
            ModelError, NonFiniteError: see `bundle.sessions.run_model`.
        """
        tokens = [self.tokenizer.encode(sentence) for sentence in sentences]
        width = max(len(each.ids) for each in tokens)
        ids, mask = (np.zeros((len(tokens), width), dtype=np.int64) for _ in range(2))
        for row, each in enumerate(tokens):
            ids[row, : len(each.ids)], mask[row, : len(each.ids)] = each.ids, each.mask
        inputs = {"input_ids": ids, "attention_mask": mask}
        (pooled,) = run_model(self.sessions.text_encoder, ["pooled"], inputs, "the text encoder")
        lengths = np.linalg.norm(pooled, axis=1, keepdims=True).astype(np.float32)
        unit: FloatArray = pooled / np.maximum(lengths, np.float32(1e-12))
        return unit

    def is_word(self, word: str) -> bool:
        """Tell whether a lower-case word is a word piece of its own; see `text.vocabulary.PhraseEncoder`."""
        return self.tokenizer.is_word(word)

    def attend(self, features: Sequence[GraphArrays]) -> Conditions:
        """Let the nodes of each graph attend to their neighbours (GraphMotion, Eq. 1-3); one row for each graph.

        Raises:
            ModelError, NonFiniteError: see `bundle.sessions.run_model`.
        """
        (nodes,) = run_model(self.sessions.graph_encoder, ["nodes_out"], pad_graphs(features), "the graph encoder")
        return make_conditions(features, nodes)

    def left_out(self, graph: SemanticGraph) -> tuple[str, ...]:
        """Tell which nodes of a graph the networks have no room for: none, they take any number."""
        return ()

    def with_length(self, options: GenerateOptions, features: Sequence[GraphArrays]) -> GenerateOptions:
        """Replace the length by the one that the longest of some sentences asks for.

        Options come back as they are if the bundle has no duration model.
        """
        weights = self.tables.get(DURATION)
        if weights is None:
            return options
        limits = self.manifest.frames
        frames = expected_frames(weights, features, limits.min, limits.max)
        return replace(options, frames=frames, seconds=frames / self.manifest.fps)


def encode_caption(
    text_encoder: onnxruntime.InferenceSession, tokenizer: CaptionTokenizer, graph: SemanticGraph, *, words: bool
) -> GraphArrays:
    """Encode one caption and return its graph as arrays.

    Captions are encoded one a run. Among others, the sums of a caption are rounded in another order, and what the
    encoder then rounds to int8 can be a whole step off (measured: 0.03 of a hidden state, 5 mm in a clip). Sharing a
    run would save a sixth of the encoder's time.

    Args:
        text_encoder: session of the text encoder.
        tokenizer: of the same bundle.
        graph: whose caption is encoded.
        words: whether the words of the caption stand beside the nodes.
    """
    tokens = tokenizer.encode(graph.caption)
    inputs = {"input_ids": np.array([tokens.ids]), "attention_mask": np.array([tokens.mask])}
    hidden, pooled = run_model(text_encoder, ["hidden", "pooled"], inputs, "the text encoder")
    nodes = node_features(graph, tokens, hidden[0], pooled[0])
    return with_words(nodes, hidden[0], word_nodes(graph, tokens)) if words else nodes


def node_features(graph: SemanticGraph, tokens: TokenIds, hidden: FloatArray, pooled: FloatArray) -> GraphArrays:
    """Read node features off hidden states by character offsets (GraphMotion, section 3.1).

    The motion node is the sentence, every other node the mean over the word pieces of its span. A span without a word
    piece of its own falls back to the sentence.

    Args:
        graph: of the caption that was encoded.
        tokens: its T word pieces with offsets.
        hidden: (T, D) hidden states.
        pooled: (D,) their mean.
    """
    nodes = [pooled]
    for start, end in node_spans(graph):
        pieces = span_mask(tokens.offsets, start, end)
        nodes.append(hidden[pieces].mean(axis=0) if pieces.any() else pooled)
    relation, weight, kind, order, path = graph_structure(graph)
    owner = np.arange(len(kind))
    return GraphArrays(np.stack(nodes).astype(np.float32), relation, weight, kind, order, path, owner)


def word_nodes(graph: SemanticGraph, tokens: TokenIds) -> IntArray:
    """Find the node that each word piece hangs on: the one of the shortest span that holds it, else the motion node.

    Args:
        graph: of the caption.
        tokens: its T word pieces with offsets.

    Returns:
        (T,) number of the node, -1 for special pieces.
    """
    nodes = np.where(tokens.offsets[:, 1] > tokens.offsets[:, 0], 0, -1)
    spans = enumerate(node_spans(graph), start=1)
    for node, (start, end) in sorted(spans, key=lambda entry: entry[1][0] - entry[1][1]):
        nodes[span_mask(tokens.offsets, start, end)] = node
    return nodes


def with_words(graph: GraphArrays, hidden: FloatArray, nodes: IntArray) -> GraphArrays:
    """Add the words of a caption behind the nodes of its graph; in graph attention each word sees itself alone.

    Args:
        graph: of the caption.
        hidden: (T, D) hidden states of its word pieces.
        nodes: (T,) of `word_nodes`.
    """
    pieces = np.flatnonzero(nodes >= 0)
    owners = nodes[pieces]
    count = len(graph.kind) + len(pieces)
    relation = np.full((count, count), NO_EDGE, dtype=np.int64)
    edge_weight = np.ones((count, count), dtype=np.float32)
    np.fill_diagonal(relation, ROLE_INDEX[OTHERS])
    size = len(graph.kind)
    relation[:size, :size], edge_weight[:size, :size] = graph.relation, graph.edge_weight
    return GraphArrays(
        nodes=np.concatenate([graph.nodes, hidden[pieces]]).astype(np.float32),
        relation=relation,
        edge_weight=edge_weight,
        kind=np.concatenate([graph.kind, np.full(len(pieces), WORD)]),
        order=np.concatenate([graph.order, graph.order[owners]]),
        path_weight=np.concatenate([graph.path_weight, graph.path_weight[owners]]),
        owner=np.concatenate([graph.owner, owners]),
    )


def as_partial(graph: GraphArrays) -> GraphArrays:
    """Say that a caption may name only a part of what happens: a learned token takes the sentence's place.

    The concepts of a composition are told so (EnergyMoGen, Eq. 7-9): the motions of "walks" and nothing else, and of
    "waves" and nothing else, have none in common.
    """
    kind, edge_weight = graph.kind.copy(), graph.edge_weight.copy()
    kind[0] = PARTIAL_KIND
    # Nothing of the sentence's own features may reach the nodes below it.
    edge_weight[0, 1:] = edge_weight[1:, 0] = 0.0
    return replace(graph, kind=kind, edge_weight=edge_weight)


def node_spans(graph: SemanticGraph) -> list[tuple[int, int]]:
    """List the character spans of all nodes below the motion node, in node order."""
    action_spans = [(action.start, action.end) for action in graph.actions]
    return action_spans + [(part.start, part.end) for action in graph.actions for part in action.arguments]


def graph_structure(graph: SemanticGraph) -> tuple[IntArray, FloatArray, IntArray, IntArray, FloatArray]:
    """Return relation, edge weight, kind, order and path weight of a graph: all arrays but the features.

    Edges run both ways (motion-action as ARGM-MA, action-argument with its role), and every node has a self-loop of
    type OTHERS.
    """
    actions = len(graph.actions)
    count = graph.node_count
    relation = np.full((count, count), NO_EDGE, dtype=np.int64)
    edge_weight = np.ones((count, count), dtype=np.float32)
    np.fill_diagonal(relation, ROLE_INDEX[OTHERS])
    kind = np.array([MOTION] + [ACTION] * actions + [SPECIFIC] * (count - 1 - actions), dtype=np.int64)
    order = np.zeros(count, dtype=np.int64)
    path_weight = np.ones(count, dtype=np.float32)

    def connect(parent: int, child: int, role: str, weight: float, action_order: int) -> None:
        relation[parent, child] = relation[child, parent] = ROLE_INDEX[role]
        edge_weight[parent, child] = edge_weight[child, parent] = weight
        path_weight[child] = path_weight[parent] * weight
        order[child] = 1 + action_order

    specific = 1 + actions
    for node, action in enumerate(graph.actions, start=1):
        connect(0, node, MOTION_ACTION, action.weight, action.order)
        for argument in action.arguments:
            connect(node, specific, argument.role, argument.weight, action.order)
            specific += 1
    return relation, edge_weight, kind, order, path_weight


def pad_graphs(graphs: Sequence[GraphArrays]) -> dict[str, FloatArray | IntArray]:
    """Pad a batch of graphs to one size: the graph encoder's inputs nodes, relation, edge_weight and node_mask."""
    batch, count = len(graphs), max(len(graph.kind) for graph in graphs)
    width = graphs[0].nodes.shape[1]
    nodes = np.zeros((batch, count, width), dtype=np.float32)
    relation = np.full((batch, count, count), NO_EDGE, dtype=np.int64)
    edge_weight = np.ones((batch, count, count), dtype=np.float32)
    mask = np.zeros((batch, count), dtype=np.float32)
    for row, graph in enumerate(graphs):
        size = len(graph.kind)
        nodes[row, :size] = graph.nodes
        relation[row, :size, :size] = graph.relation
        edge_weight[row, :size, :size] = graph.edge_weight
        mask[row, :size] = 1.0
    return {"nodes": nodes, "relation": relation, "edge_weight": edge_weight, "node_mask": mask}


def make_conditions(graphs: Sequence[GraphArrays], encoded: FloatArray) -> Conditions:
    """Join the graph encoder's output (A, N, D) with kinds, orders and log weights of the nodes."""
    batch, count = encoded.shape[:2]
    kind = np.zeros((batch, count), dtype=np.int64)
    order = np.zeros((batch, count), dtype=np.int64)
    bias = np.full((batch, count), PADDING_BIAS, dtype=np.float32)
    for row, graph in enumerate(graphs):
        size = len(graph.kind)
        kind[row, :size] = graph.kind
        order[row, :size] = graph.order
        bias[row, :size] = log_weight(graph.path_weight)
    return Conditions(encoded, kind, order, bias, np.zeros((batch, 1), dtype=np.float32))


def log_weight(weight: FloatArray) -> FloatArray:
    """Return log w, and PADDING_BIAS for w = 0: a node of weight 0 is exactly a node that is not there."""
    return np.log(weight, out=np.full_like(weight, PADDING_BIAS), where=weight > 0).clip(min=PADDING_BIAS)


def for_level(conditions: Conditions, kinds: Sequence[str]) -> Conditions:
    """Keep the nodes and words that a level sees; learned tokens are seen at every level.

    The others are cut off, or masked where another row of the batch needs their place.

    Args:
        conditions: of all nodes.
        kinds: names of the kinds that the level sees, see `contract.NODE_KINDS`.
    """
    seen = np.isin(conditions.kind, [KINDS[name] for name in kinds] + [PARTIAL_KIND])
    seen &= conditions.bias > PADDING_BIAS / 2
    count = int(np.flatnonzero(seen.any(axis=0)).max(initial=0)) + 1
    bias = np.where(seen, conditions.bias, np.float32(PADDING_BIAS))
    nodes, kind, order = conditions.nodes[:, :count], conditions.kind[:, :count], conditions.order[:, :count]
    return Conditions(nodes, kind, order, bias[:, :count], conditions.coarse_bias)


def drop_text(conditions: Conditions) -> Conditions:
    """Replace the graph of every row by the learned null token; the coarser latent stays."""
    kind = np.full_like(conditions.kind, NULL_KIND)
    bias = np.full_like(conditions.bias, PADDING_BIAS)
    bias[:, 0] = 0.0
    order = np.zeros_like(conditions.order)
    return Conditions(np.zeros_like(conditions.nodes), kind, order, bias, conditions.coarse_bias)


def drop_all(conditions: Conditions) -> Conditions:
    """Drop text and coarser latent of every row: GraphMotion's empty set (Eq. A)."""
    return replace(drop_text(conditions), coarse_bias=np.full_like(conditions.coarse_bias, PADDING_BIAS))


def repeat_rows(conditions: Rows, count: int) -> Rows:
    """Repeat every row `count` times."""
    return conditions.map(lambda part: np.repeat(part, count, axis=0))


def stack_rows(*batches: Conditions) -> Conditions:
    """Stack the rows of several batches of equal N."""
    names = [field.name for field in fields(Conditions)]
    return Conditions(**{name: np.concatenate([getattr(batch, name) for batch in batches]) for name in names})


def duration_inputs(graph: GraphArrays) -> DoubleArray:
    """Gather the inputs of the duration model, (D + 3,): the sentence before graph attention, and three counts."""
    counts = [np.count_nonzero(graph.kind == ACTION), graph.node_count, 1]
    return np.concatenate([graph.nodes[0].astype(np.float64), counts])


def expected_frames(weights: FloatArray, graphs: Sequence[GraphArrays], shortest: int, longest: int) -> int:
    """Predict the frames of a clip: those of its longest sentence, within what the model takes.

    Args:
        weights: (1, D + 3) of the duration model, log frames = weights . inputs.
        graphs: of the sentences that the clip is for.
        shortest: fewest frames.
        longest: most frames.
    """
    logs = [float(weights[0].astype(np.float64) @ duration_inputs(graph)) for graph in graphs]
    # clipped before exp: a sentence unlike any other must not overflow
    return int(np.clip(round(np.exp(np.clip(max(logs), 0.0, 20.0))), shortest, longest))
