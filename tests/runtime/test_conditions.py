"""From a graph to what the denoisers attend to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinegraph.bundle.contract import NODE_KINDS, NULL_KIND, PADDING_BIAS, PARTIAL_KIND
from kinegraph.conditioning import (
    ACTION,
    MOTION,
    NO_EDGE,
    SPECIFIC,
    WORD,
    GraphArrays,
    as_partial,
    drop_all,
    drop_text,
    for_level,
    log_weight,
    make_conditions,
    node_features,
    pad_graphs,
    stack_rows,
    with_words,
    word_nodes,
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


def test_a_word_hangs_on_the_node_of_the_shortest_span_that_holds_it() -> None:
    # "and" belongs to no node: it hangs on the sentence. [CLS] and [SEP] are no words.
    np.testing.assert_array_equal(word_nodes(GRAPH, TOKENS), [-1, 1, 3, 3, 0, 2, -1])
    # An argument that holds a verb of its own ("starts walking slowly"): the verb's pieces are the verb's.
    inner = (Action("walks", 0, 5, 0, 1.0, (Argument("ARG1", "and waves", 13, 22),)), Action("waves", 17, 22, 1))
    np.testing.assert_array_equal(word_nodes(SemanticGraph(CAPTION, inner), TOKENS), [-1, 1, 0, 0, 3, 2, -1])


def with_its_words(graph: SemanticGraph = GRAPH) -> GraphArrays:
    return with_words(arrays(graph), HIDDEN, word_nodes(graph, TOKENS))


def test_words_have_order_and_weight_of_their_node_and_no_neighbours() -> None:
    graph = with_its_words()
    np.testing.assert_array_equal(graph.kind, [MOTION, ACTION, ACTION, SPECIFIC, *[WORD] * 5])
    np.testing.assert_array_equal(graph.owner, [0, 1, 2, 3, 1, 3, 3, 0, 2])
    np.testing.assert_array_equal(graph.nodes[4:], HIDDEN[1:6])
    np.testing.assert_array_equal(graph.nodes[:4], arrays().nodes)
    np.testing.assert_array_equal(graph.order, graph.order[graph.owner])
    np.testing.assert_array_equal(graph.path_weight, arrays().path_weight[graph.owner])
    assert graph.order[5] == 1 and graph.path_weight[4] == 0.5
    np.testing.assert_array_equal(graph.relation[:4, :4], arrays().relation)
    assert ((graph.relation >= 0).sum(axis=0)[4:] == 1).all()


def test_a_word_of_a_node_without_weight_is_seen_nowhere() -> None:
    silent = replace(GRAPH.actions[0], arguments=(replace(GRAPH.actions[0].arguments[0], weight=0.0),))
    batch = [with_its_words(SemanticGraph(CAPTION, (silent, GRAPH.actions[1])))]
    seen = for_level(make_conditions(batch, encoded(batch)), NODE_KINDS)
    hidden = seen.bias[0] <= PADDING_BIAS
    np.testing.assert_array_equal(hidden, batch[0].owner == 3)


def test_a_level_without_words_sees_what_it_saw_before() -> None:
    without, both = [arrays()], [with_its_words()]
    first, second = (for_level(make_conditions(batch, encoded(batch)), NODE_KINDS[:3]) for batch in (without, both))
    for name, part in vars(first).items():
        np.testing.assert_array_equal(part, getattr(second, name))


def test_a_caption_of_a_part_hides_its_sentence_alone() -> None:
    whole = with_its_words()
    part = as_partial(whole)
    assert part.kind[0] == PARTIAL_KIND and (part.kind[1:] == whole.kind[1:]).all()
    # The sentence reaches no node, and no node reaches it; all other edges are as they were.
    assert (part.edge_weight[0, 1:] == 0).all() and (part.edge_weight[1:, 0] == 0).all()
    np.testing.assert_array_equal(part.edge_weight[1:, 1:], whole.edge_weight[1:, 1:])
    np.testing.assert_array_equal(part.path_weight, whole.path_weight)
    assert whole.kind[0] == MOTION and whole.edge_weight[0, 1] == 0.5  # unchanged
    # Every level sees the token, also one that sees no sentence.
    seen = for_level(make_conditions([part], encoded([part])), ("action",))
    np.testing.assert_array_equal(seen.kind[0][seen.bias[0] > PADDING_BIAS], [PARTIAL_KIND, ACTION, ACTION])


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


@pytest.mark.parametrize(
    ("kinds", "left"), [(("motion",), 1), (("motion", "action"), 3), (NODE_KINDS[:3], 4), (NODE_KINDS, 4)]
)
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
