"""Captions that name a part, words beside nodes, and nodes of weight 0, through the graphs of the toy bundle."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from kinegraph import Concept, MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph.bench import GRAPH
from kinegraph.bundle.contract import LEVELS, PADDING_BIAS
from kinegraph.concepts import SamplingPlan, validate_composition
from kinegraph.conditioning import SPECIFIC, WORD, GraphArrays, for_level
from kinegraph.edits import with_weight
from kinegraph.graph import Action, SemanticGraph

WALK, WAVE, RUN = (
    SemanticGraph(caption, (Action(verb, 9, 9 + len(verb), 0),))
    for caption, verb in (("a person walks", "walks"), ("a person waves", "waves"), ("a person runs", "runs"))
)
FEW: dict[str, Any] = {"seconds": 1, "seed": 1, "steps": 2, "foot_fix": False}


def flags(*concepts: Concept, **how: Any) -> tuple[bool, ...]:
    spec = validate_composition(list(concepts), how.pop("method", "fused"), None, how.get("lambdas"), None)
    graphs = [text if isinstance(text, SemanticGraph) else WALK for text in spec.texts]
    plan = SamplingPlan.for_composition(spec, graphs)
    assert len(plan.partial) == len(plan.graphs)
    return plan.partial


def test_which_captions_of_a_composition_name_a_part() -> None:
    walk, wave, not_run = Concept(WALK), Concept(WAVE, 0.5), Concept(RUN, -0.5)
    # Concepts, the joint text, negated concepts.
    assert flags(walk, wave) == (True, True, False)
    assert flags(walk, wave, not_run) == (True, True, False, True)
    assert flags(walk, wave, not_run, method="latent") == (True, True, True)
    assert flags(walk, wave, not_run, method="semantic") == (True, True, True)
    # One positive concept is all that happens, however often it is said.
    assert flags(walk) == flags(walk, Concept(WALK, 0.5))[1:] == (False, False)
    assert flags(walk, not_run) == (False, False, True)
    assert flags(walk, not_run, method="semantic") == (False, True)


def test_terms_of_weighted_edges_follow_their_graph() -> None:
    weighted = with_weight(GRAPH, "forward", 0.5)
    assert flags(Concept(weighted), Concept(WAVE), method="latent") == (True, True, True)
    plan = SamplingPlan.for_graph(weighted, [WAVE])
    assert plan.partial == (False, False, True)


def attended(pipe: MotionPipeline, graph: GraphArrays) -> dict[str, list[FloatArray]]:
    """Keys and values (1, h, s, d/h) of the tokens that each level sees, with a coarser latent of zeros."""
    found, conditions = {}, pipe.encoder.attend([graph])
    for number, level in enumerate(LEVELS):
        seen = for_level(conditions, pipe.manifest.levels[level].nodes)
        inputs: dict[str, Any] = {"nodes": seen.nodes, "kind": seen.kind, "order": seen.order, "bias": seen.bias}
        visible = seen.bias[0] > PADDING_BIAS
        if number:
            above = pipe.manifest.levels[LEVELS[number - 1]]
            inputs["coarse"] = np.zeros((1, above.tokens, above.latent_width), dtype=np.float32)
            inputs["bias"] = np.concatenate([seen.bias, np.zeros((1, above.tokens), dtype=np.float32)], axis=1)
            visible = np.concatenate([visible, np.ones(above.tokens, dtype=bool)])
        outputs = pipe.sampler.sessions.context[level].run(None, inputs)
        found[level] = [output[:, :, visible] for output in outputs]
    return found


def largest_difference(first: dict[str, list[FloatArray]], second: dict[str, list[FloatArray]]) -> float:
    return max(
        float(np.abs(one - other).max())
        for level in LEVELS
        for one, other in zip(first[level], second[level], strict=True)
    )


def test_the_sentence_of_a_part_is_seen_nowhere(toy: MotionPipeline) -> None:
    whole, part = (toy.encoder.encode_text([GRAPH], [is_part])[0] for is_part in (False, True))

    def with_another_sentence(graph: GraphArrays) -> GraphArrays:
        nodes = graph.nodes.copy()
        nodes[0] += 1.0
        return replace(graph, nodes=nodes)

    assert largest_difference(attended(toy, part), attended(toy, with_another_sentence(part))) == 0.0
    assert largest_difference(attended(toy, whole), attended(toy, with_another_sentence(whole))) > 1e-3
    assert largest_difference(attended(toy, whole), attended(toy, part)) > 1e-3


@pytest.mark.parametrize("partial", [False, True])
def test_a_weight_of_zero_is_exactly_no_node_and_no_words_of_it(toy: MotionPipeline, partial: bool) -> None:
    graph = toy.encoder.encode_text([GRAPH], [partial])[0]
    assert WORD in graph.kind
    node = int(np.flatnonzero(graph.kind == SPECIFIC)[0])
    weight, path = graph.edge_weight.copy(), graph.path_weight.copy()
    weight[node, :] = weight[:, node] = 0.0
    weight[node, node] = 1.0
    path[graph.owner == node] = 0.0
    left = np.flatnonzero(graph.owner != node)
    assert len(left) < len(path) - 1  # the node and a word at least
    renumbered = np.searchsorted(left, graph.owner[left])
    deleted = GraphArrays(
        graph.nodes[left],
        graph.relation[np.ix_(left, left)],
        graph.edge_weight[np.ix_(left, left)],
        graph.kind[left],
        graph.order[left],
        graph.path_weight[left],
        renumbered,
    )
    silent = replace(graph, edge_weight=weight, path_weight=path)
    assert largest_difference(attended(toy, silent), attended(toy, deleted)) < 1e-5
    assert any(
        one.shape != other.shape
        for one, other in zip(attended(toy, graph)["specific"], attended(toy, silent)["specific"], strict=True)
    )


def test_changing_a_word_changes_what_is_seen(toy: MotionPipeline) -> None:
    graph = toy.encoder.encode_text([GRAPH])[0]
    nodes = graph.nodes.copy()
    nodes[-1] += 1.0
    assert largest_difference(attended(toy, graph), attended(toy, replace(graph, nodes=nodes))) > 1e-3


def test_one_concept_is_what_generate_makes_and_two_are_parts(toy: MotionPipeline) -> None:
    plain = toy.generate(WALK, **FEW).joints
    np.testing.assert_allclose(toy.compose([WALK], **FEW).joints, plain, atol=1e-4)
    spec = validate_composition([WALK, WAVE], "latent", None, None, None)
    whole = replace(spec, partial=(False, False))
    options = {"own_length": False}
    from kinegraph.options import resolve_options

    chosen = resolve_options(toy.manifest, seconds=1, seed=1, steps=2)
    first, second = (toy.encode_composition(each, chosen, **options)[0] for each in (spec, whole))
    assert (first.kind[:, 0] != second.kind[:, 0]).all()
