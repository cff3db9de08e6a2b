"""Graphs in the slots of released networks, against the released code's own arrays."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
import pytest

from kinegraph.graph import MOTION_ACTION, ROLE_INDEX, ROLES, Action, Argument, SemanticGraph
from kinegraph.slot_conditioning import (
    FIRST_ACTION,
    FIRST_SPECIFIC,
    NodeTokens,
    SlotGraph,
    attention_inputs,
    slot_graph,
    tokens_by_character,
    tokens_by_word,
)
from kinegraph.text.tokenizer import TokenIds
from support.shared import shared_path

Arrays = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def official() -> Arrays:
    with np.load(shared_path("fixtures", "official", "gm_small.graph.npz"), allow_pickle=False) as pack:
        return dict(pack)


def node_tokens(record: dict) -> NodeTokens:
    """The released code's JSON: word k is token k + 1, words past 75 are skipped, unlisted roles are OTHERS."""

    def tokens(spans: Sequence[Sequence[int]]) -> list[list[int]]:
        return [[word + 1 for word in words if word <= 75] for words in spans]

    edges = [(verb, entity, role if role in ROLES else "OTHERS") for verb, entity, role in record["relations"]]
    return NodeTokens(tokens(record["V"]), tokens(record["entities"]), edges)


@pytest.fixture(scope="module")
def graphs(official: Arrays) -> list[SlotGraph]:
    path = shared_path("fixtures", "official", "gm_small.graphs.json")
    records = json.loads(path.read_text())["graphs"]
    count = len(records)
    states = [(official["hidden_emb"][row], official["cond_emb"][row, 0]) for row in range(2 * count)]
    return [slot_graph(node_tokens(record), states[count + row], states[row]) for row, record in enumerate(records)]


def in_our_order(official: Arrays, typed: np.ndarray) -> np.ndarray:
    """(12, B, 13, 13) counts in the released order of types -> (B, 12, 13, 13) of 0 and 1 in ours."""
    names = [str(name).replace("MA", MOTION_ACTION) if name == "MA" else str(name) for name in official["edge_types"]]
    return (typed[[names.index(role) for role in ROLES]] > 0).swapaxes(0, 1).astype(np.float32)


def test_the_released_evaluation_s_arrays(official: Arrays, graphs: list[SlotGraph]) -> None:
    inputs = attention_inputs(graphs, is_released=True)
    np.testing.assert_allclose(inputs["nodes"], official["eval.nodes_in"], rtol=0, atol=1e-6)
    np.testing.assert_array_equal(inputs["adjacency"], official["eval.adj"] > 0)
    np.testing.assert_array_equal(inputs["relations"], in_our_order(official, official["eval.typed_adj"]))


def test_the_released_training_s_arrays(official: Arrays, graphs: list[SlotGraph]) -> None:
    inputs = attention_inputs(graphs, is_released=False)
    half = len(graphs)
    np.testing.assert_allclose(inputs["nodes"][half:], official["train.nodes_in"], rtol=0, atol=1e-6)
    np.testing.assert_array_equal(inputs["adjacency"][half:], official["train.adj"] > 0)
    np.testing.assert_array_equal(inputs["relations"][half:], in_our_order(official, official["train.typed_adj"]))


def test_masks(official: Arrays, graphs: list[SlotGraph]) -> None:
    masks = np.stack([graph.path_weight for graph in graphs])
    np.testing.assert_array_equal(masks[:, FIRST_ACTION:FIRST_SPECIFIC], official["eval.act_mask"][2:])
    np.testing.assert_array_equal(masks[:, FIRST_SPECIFIC:], official["eval.ent_mask"][2:])


def states(length: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.Generator(np.random.PCG64(seed))
    return rng.standard_normal((length, 6)).astype(np.float32), rng.standard_normal(6).astype(np.float32)


def test_further_nodes_are_dropped_with_their_edges() -> None:
    actions = [[1 + index] for index in range(5)]
    specifics = [[10 + index] for index in range(10)]
    edges = [(index % 5, index, "ARG1") for index in range(10)]
    graph = slot_graph(NodeTokens(actions, specifics, edges), states(30, 1), states(77, 2))
    assert graph.path_weight.tolist() == [1.0] * 13
    pairs = {tuple(pair) for pair in np.argwhere(graph.types[ROLE_INDEX["ARG1"]])}
    # specific 4 hangs on action 4, which has no slot: it stays without an edge but its own
    kept = {(1 + action, 5 + specific) for action, specific, _ in edges if action < 4 and specific < 8}
    assert pairs == kept | {pair[::-1] for pair in kept}
    assert graph.types[ROLE_INDEX["OTHERS"], 5 + 4, 5 + 4] == 1.0


@pytest.mark.parametrize("is_released", [False, True])
def test_halves_without_and_with_text_and_what_the_released_evaluation_takes_away(is_released: bool) -> None:
    graph = slot_graph(NodeTokens([[1]], [[2]], [(0, 0, "ARG1")]), states(4, 1), states(77, 2))
    role = ROLE_INDEX["ARG1"]
    found = attention_inputs([graph, graph], is_released=is_released)
    expected = [graph.null_nodes, graph.null_nodes, graph.nodes, graph.nodes]
    np.testing.assert_array_equal(found["nodes"], expected)
    np.testing.assert_array_equal(found["adjacency"], [graph.types.any(axis=0)] * 4)
    for half, has_type in ((0, 1.0), (2, 0.0 if is_released else 1.0)):
        assert found["relations"][half, role, 1, 5] == found["relations"][half, role, 5, 1] == has_type
    others = np.delete(found["relations"], role, axis=1)
    np.testing.assert_array_equal(others[:2], others[2:])


def test_a_node_without_tokens_is_the_sentence_and_has_no_loop() -> None:
    conditional, null = states(8, 1), states(77, 2)
    graph = slot_graph(NodeTokens([[]], [[2], []], [(0, 0, "ARG0"), (0, 1, "ARG1")]), conditional, null)
    np.testing.assert_array_equal(graph.nodes[1], conditional[1])
    np.testing.assert_array_equal(graph.null_nodes[1], null[1])
    np.testing.assert_array_equal(graph.nodes[5], conditional[0][2])
    np.testing.assert_array_equal(graph.null_nodes[5], null[0][2])
    assert [graph.types[:, slot, slot].any() for slot in (0, 1, 5, 6, 7)] == [True, False, True, False, False]
    assert graph.path_weight[[1, 5, 6, 7]].tolist() == [1.0, 1.0, 1.0, 0.0]
    # a listed node keeps its edges, with tokens or without
    assert graph.types[ROLE_INDEX["ARG1"], 1, 6] == 1.0


def test_a_graph_without_actions_has_the_sentence_alone() -> None:
    graph = slot_graph(NodeTokens([], [], []), states(4, 1), states(77, 2))
    assert graph.path_weight.tolist() == [1.0] + [0.0] * 12
    assert np.argwhere(graph.types).tolist() == [[ROLE_INDEX[MOTION_ACTION], 0, 0]]


def test_a_pair_may_have_two_roles() -> None:
    graph = slot_graph(NodeTokens([[1]], [[2]], [(0, 0, "ARG0"), (0, 0, "ARGM-DIR")]), states(4, 1), states(77, 2))
    assert graph.types[:, 1, 5].sum() == 2.0


CAPTION = "somersaulting, a man waves"
GRAPH = SemanticGraph(CAPTION, (Action("waves", 21, 26, 0, arguments=(Argument("ARG0", "a man", 15, 20),)),))


def test_words_of_several_pieces_shift_the_released_look_up_alone() -> None:
    # begin, "somer", "saulting", ",", "a", "man", "waves", end
    offsets = [(0, 0), (0, 5), (5, 13), (13, 14), (15, 16), (17, 20), (21, 26), (0, 0)]
    ids = np.arange(len(offsets))
    tokens = TokenIds(ids, np.ones_like(ids), np.array(offsets))
    by_character, by_word = tokens_by_character(GRAPH, tokens), tokens_by_word(GRAPH)
    assert (by_character.actions, by_character.specifics) == ([[6]], [[4, 5]])
    assert (by_word.actions, by_word.specifics) == ([[4]], [[2, 3]])
    assert by_character.edges == by_word.edges == [(0, 0, "ARG0")]
