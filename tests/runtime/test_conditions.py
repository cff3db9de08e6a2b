"""From a graph to what the denoisers attend to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinegraph.bundle.contract import NODE_KINDS, NULL_KIND, PADDING_BIAS
from kinegraph.conditioning import (
    ACTION,
    MOTION,
    NO_EDGE,
    SPECIFIC,
    GraphArrays,
    drop_all,
    drop_text,
    for_level,
    log_weight,
    make_conditions,
    node_features,
    pad_graphs,
    stack_rows,
)
from kinegraph.graph import ROLE_INDEX, Action, Argument, SemanticGraph
from kinegraph.text.tokenizer import TokenIds

CAPTION = "walks slowly and waves"
GRAPH = SemanticGraph(
    CAPTION,
    (
        Action("walks", 0, 5, 0, 0.5, (Argument("ARGM-MNR", "slowly", 6, 12, 2.0),)),
        Action("waves", 17, 22, 1),
    ),
)
# [CLS] walks slow ly and waves [SEP]
TOKENS = TokenIds(
    ids=np.arange(7),
    mask=np.ones(7, dtype=np.int64),
    offsets=np.array([[0, 0], [0, 5], [6, 10], [10, 12], [13, 16], [17, 22], [0, 0]]),
)
HIDDEN = np.random.default_rng(0).standard_normal((7, 5), dtype=np.float32)
POOLED = HIDDEN.mean(axis=0)


def arrays(graph: SemanticGraph = GRAPH) -> GraphArrays:
    return node_features(graph, TOKENS, HIDDEN, POOLED)


def test_nodes_are_the_sentence_and_means_over_their_pieces() -> None:
    nodes = arrays().nodes
    np.testing.assert_array_equal(nodes[0], POOLED)
    np.testing.assert_array_equal(nodes[1], HIDDEN[1])
    np.testing.assert_array_equal(nodes[2], HIDDEN[5])
    np.testing.assert_allclose(nodes[3], (HIDDEN[2] + HIDDEN[3]) / 2, rtol=1e-6)
    assert nodes.dtype == np.float32


def test_edges_run_both_ways_and_carry_their_type() -> None:
    graph_arrays = arrays()
    ma, mnr, loop = ROLE_INDEX["ARGM-MA"], ROLE_INDEX["ARGM-MNR"], ROLE_INDEX["OTHERS"]
    expected = np.array(
        [
            [loop, ma, ma, NO_EDGE],
            [ma, loop, NO_EDGE, mnr],
            [ma, NO_EDGE, loop, NO_EDGE],
            [NO_EDGE, mnr, NO_EDGE, loop],
        ]
    )
    np.testing.assert_array_equal(graph_arrays.relation, expected)
    np.testing.assert_array_equal(graph_arrays.kind, [MOTION, ACTION, ACTION, SPECIFIC])
    np.testing.assert_array_equal(graph_arrays.order, [0, 1, 2, 1])


def test_weights_stand_on_their_edges_and_multiply_along_the_path() -> None:
    graph_arrays = arrays()
    np.testing.assert_array_equal(graph_arrays.edge_weight, graph_arrays.edge_weight.T)
    assert graph_arrays.edge_weight[0, 1] == 0.5 and graph_arrays.edge_weight[1, 3] == 2.0
    assert (np.diag(graph_arrays.edge_weight) == 1).all()
    np.testing.assert_allclose(graph_arrays.path_weight, [1.0, 0.5, 1.0, 1.0])


def test_a_weight_is_a_log_prior_and_none_is_a_node_that_is_not_there() -> None:
    np.testing.assert_allclose(log_weight(np.array([1.0, 2.0, 0.5], dtype=np.float32)), np.log([1, 2, 0.5]), rtol=1e-6)
    assert log_weight(np.zeros(1, dtype=np.float32))[0] == PADDING_BIAS
    # softmax gives it exactly no share
    assert np.exp(np.float32(PADDING_BIAS)) == 0.0


def encoded(batch: list[GraphArrays]) -> np.ndarray:
    return np.asarray(pad_graphs(batch)["nodes"])


def test_padding_carries_no_edge_no_node_and_no_weight() -> None:
    small = arrays(SemanticGraph(CAPTION, (Action("waves", 17, 22, 0),)))
    feeds = pad_graphs([arrays(), small])
    assert feeds["nodes"].shape == (2, 4, 5)
    np.testing.assert_array_equal(feeds["node_mask"], [[1, 1, 1, 1], [1, 1, 0, 0]])
    assert (feeds["relation"][1, 2:] == NO_EDGE).all() and (feeds["relation"][1, :, 2:] == NO_EDGE).all()
    batch = make_conditions([arrays(), small], encoded([arrays(), small]))
    np.testing.assert_array_equal(batch.bias[1], [0.0, 0.0, PADDING_BIAS, PADDING_BIAS])
    np.testing.assert_allclose(batch.bias[0], np.log([1.0, 0.5, 1.0, 1.0]), rtol=1e-6)


@pytest.mark.parametrize(("kinds", "left"), [(("motion",), 1), (("motion", "action"), 3), (NODE_KINDS, 4)])
def test_a_level_sees_the_nodes_of_its_kinds(kinds: tuple[str, ...], left: int) -> None:
    seen = for_level(make_conditions([arrays()], encoded([arrays()])), kinds)
    assert seen.nodes.shape == (1, left, 5)
    assert (seen.bias > PADDING_BIAS).all()


def test_a_level_masks_what_only_a_neighbour_of_the_batch_needs() -> None:
    second = arrays(SemanticGraph(CAPTION, (Action("waves", 17, 22, 0, 1.0, (Argument("ARG1", "slowly", 6, 12),)),)))
    seen = for_level(make_conditions([arrays(), second], encoded([arrays(), second])), ("motion", "action"))
    # Its third node is a specific, which this level must not see, though the other graph has an action there.
    np.testing.assert_array_equal(seen.bias[1] > PADDING_BIAS, [True, True, False])


def test_weight_zero_leaves_what_deletion_leaves() -> None:
    silent = replace(GRAPH.actions[0], arguments=(replace(GRAPH.actions[0].arguments[0], weight=0.0),))
    zero = SemanticGraph(CAPTION, (silent, GRAPH.actions[1]))
    gone = SemanticGraph(CAPTION, (replace(GRAPH.actions[0], arguments=()), GRAPH.actions[1]))
    batch = [arrays(zero), arrays(gone)]
    seen = for_level(make_conditions(batch, encoded(batch)), NODE_KINDS)
    assert seen.nodes.shape[1] == 3
    for part in (seen.nodes, seen.kind, seen.order, seen.bias):
        np.testing.assert_array_equal(part[0], part[1])


def test_no_text_is_one_null_token() -> None:
    batch = make_conditions([arrays()], encoded([arrays()]))
    blank = drop_text(batch)
    assert (blank.kind == NULL_KIND).all() and (blank.order == 0).all() and (blank.nodes == 0).all()
    np.testing.assert_array_equal(blank.bias[0], [0.0] + [PADDING_BIAS] * 3)
    # the coarser latent is seen without the text, and not in the empty set
    nothing = drop_all(batch)
    assert [float(one.coarse_bias[0, 0]) for one in (batch, blank, nothing)] == [0.0, 0.0, PADDING_BIAS]
    assert all(
        np.array_equal(a, b) for a, b in zip(list(vars(nothing).values())[:4], vars(blank).values(), strict=False)
    )


def test_stacking_keeps_rows_apart() -> None:
    batch = make_conditions([arrays()], encoded([arrays()]))
    rows = stack_rows(drop_text(batch), batch)
    np.testing.assert_array_equal(rows.nodes[1], batch.nodes[0])
    np.testing.assert_array_equal(rows.kind[:, 0], [NULL_KIND, MOTION])
