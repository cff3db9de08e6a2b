"""GraphMotion's Eq. 1-3 against loops over nodes, on random graphs."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from kinegraph.graph import ROLES
from kinegraph_training.models.graph_encoder import GraphEncoder

WIDTH = 8


def leaky(x: float) -> float:
    return x if x > 0 else 0.2 * x


def oracle(encoder: GraphEncoder, nodes: np.ndarray, relation: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Eq. 1: e_ij = sigma(M [h_i, h_j]) + sigma(M_r [h_i, h_j]); Eq. 2: softmax over neighbours; Eq. 3: sum, ELU."""
    matrix, common, relational = (
        part.detach().double().numpy() for part in (encoder.transform.weight, encoder.common, encoder.relational)
    )
    h = nodes.astype(np.float64) @ matrix.T
    out = np.zeros_like(h)
    for i in range(len(h)):
        share = {}
        for j in range(len(h)):
            kind = relation[i, j]
            if kind >= 0 and weight[i, j] > 0:
                score = leaky(common[0] @ h[i] + common[1] @ h[j])
                score += leaky(relational[0, :, kind] @ h[i] + relational[1, :, kind] @ h[j])
                share[j] = weight[i, j] * np.exp(score)
        mean = sum(value * h[j] for j, value in share.items()) / sum(share.values())
        out[i] = np.where(mean > 0, mean, np.exp(mean) - 1) + nodes[i]
    return out


def random_graph(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Any sparse symmetric graph with self-loops, not only trees."""
    nodes = rng.standard_normal((count, WIDTH)).astype(np.float32)
    relation = rng.integers(0, len(ROLES), (count, count))
    relation = np.where(rng.random((count, count)) < 0.5, -1, relation)
    relation = np.triu(relation, 1) + np.triu(relation, 1).T
    np.fill_diagonal(relation, len(ROLES) - 1)
    weight = rng.uniform(0.1, 3.0, (count, count)).astype(np.float32)
    weight = np.sqrt(weight * weight.T)
    np.fill_diagonal(weight, 1.0)
    return nodes, relation, weight


def run(encoder: GraphEncoder, *graph: np.ndarray, mask: np.ndarray | None = None) -> np.ndarray:
    mask = np.ones(len(graph[0]), dtype=np.float32) if mask is None else mask
    with torch.no_grad():
        return encoder(*(torch.from_numpy(part)[None] for part in (*graph, mask)))[0].numpy()


@pytest.fixture
def encoder() -> GraphEncoder:
    torch.manual_seed(0)
    return GraphEncoder(WIDTH)


@pytest.mark.parametrize("seed", range(8))
def test_random_graphs_equal_the_loops(encoder: GraphEncoder, seed: int) -> None:
    graph = random_graph(np.random.default_rng(seed), 2 + seed)
    np.testing.assert_allclose(run(encoder, *graph), oracle(encoder, *graph), atol=2e-5)


def test_weight_zero_is_an_edge_that_is_not_there(encoder: GraphEncoder) -> None:
    nodes, relation, weight = random_graph(np.random.default_rng(1), 6)
    relation[0, 3] = relation[3, 0] = 4
    without, silent = relation.copy(), weight.copy()
    without[0, 3] = without[3, 0] = -1
    silent[0, 3] = silent[3, 0] = 0.0
    np.testing.assert_array_equal(run(encoder, nodes, relation, silent), run(encoder, nodes, without, weight))
    assert not np.allclose(run(encoder, nodes, relation, weight), run(encoder, nodes, without, weight), atol=1e-4)


def test_towards_weight_zero_nothing_jumps(encoder: GraphEncoder) -> None:
    nodes, relation, weight = random_graph(np.random.default_rng(1), 6)
    relation[0, 3] = relation[3, 0] = 4
    outputs = []
    for value in (0.0, 1e-30, 1e-6):
        weight[0, 3] = weight[3, 0] = value
        outputs.append(run(encoder, nodes, relation, weight))
    np.testing.assert_allclose(outputs[1:], [outputs[0]] * 2, atol=1e-4)


def test_a_heavy_edge_takes_the_attention(encoder: GraphEncoder) -> None:
    nodes, relation, weight = random_graph(np.random.default_rng(2), 4)
    relation[0, 2] = relation[2, 0] = 1
    weight[0, 2] = weight[2, 0] = 1e6
    h = nodes @ encoder.transform.weight.detach().numpy().T
    expected = np.where(h[2] > 0, h[2], np.exp(h[2]) - 1) + nodes[0]
    np.testing.assert_allclose(run(encoder, nodes, relation, weight)[0], expected, atol=1e-3)


def test_the_order_of_nodes_does_not_matter(encoder: GraphEncoder) -> None:
    rng = np.random.default_rng(3)
    nodes, relation, weight = random_graph(rng, 7)
    order = rng.permutation(7)
    mixed = run(encoder, nodes[order], relation[np.ix_(order, order)], weight[np.ix_(order, order)])
    np.testing.assert_allclose(mixed, run(encoder, nodes, relation, weight)[order], atol=1e-6)


def test_the_type_of_an_edge_matters(encoder: GraphEncoder) -> None:
    # Three nodes: with a single neighbour next to the self-loop the type still moves the share of either.
    nodes, relation, weight = random_graph(np.random.default_rng(4), 3)
    relation[0, 1] = relation[1, 0] = 2
    other = relation.copy()
    other[0, 1] = other[1, 0] = 8
    assert not np.allclose(run(encoder, nodes, relation, weight)[0], run(encoder, nodes, other, weight)[0], atol=1e-4)


def test_padding_is_nothing_and_changes_nothing(encoder: GraphEncoder) -> None:
    nodes, relation, weight = random_graph(np.random.default_rng(5), 4)
    wide = (
        np.concatenate([nodes, np.full((2, WIDTH), 7.0, dtype=np.float32)]),
        np.pad(relation, (0, 2), constant_values=-1),
        np.pad(weight, (0, 2), constant_values=1.0),
    )
    output = run(encoder, *wide, mask=np.array([1, 1, 1, 1, 0, 0], dtype=np.float32))
    np.testing.assert_array_equal(output[:4], run(encoder, nodes, relation, weight))
    assert (output[4:] == 0).all()
