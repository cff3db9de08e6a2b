"""Edits of the semantic graph: what each changes, what it leaves unchanged, and what it refuses."""

from __future__ import annotations

import dataclasses
import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph import Concept, InvalidGraphError, MotionPipeline, cli
from kinegraph.concepts import UPWEIGHT_GAIN, validate_composition, weighted_edge_terms
from kinegraph.edits import MASK, masked, remove_words, replaced, with_action, with_argument, with_weight, without
from kinegraph.formats.graph_svg import graph_svg
from kinegraph.graph import MAX_WEIGHT, Action, Argument, SemanticGraph
from kinegraph.limits import MAX_NODES
from kinegraph.options import resolve_options
from support.cli_runs import fails

CAPTION = "a person walks slowly to the left and then waves slowly"


def argument(role: str, text: str, start: int) -> Argument:
    return Argument(role, text, start, start + len(text))


WALKS = (
    argument("ARG0", "a person", 0),
    argument("ARGM-MNR", "slowly", 15),
    argument("ARGM-DIR", "to the left", 22),
)
GRAPH = SemanticGraph(
    CAPTION,
    (
        Action("walks", 9, 14, 0, 1.0, WALKS),
        Action("waves", 43, 48, 1, 1.0, (argument("ARGM-MNR", "slowly", 49),)),
    ),
)
# numbers: 1 walks, 2 waves, 3 a person, 4 slowly, 5 to the left, 6 slowly


def texts(graph: SemanticGraph) -> list[str]:
    return [node.text for node in graph.nodes]


@pytest.mark.parametrize("node", ["to the left", "  To THE  left ", 5])
def test_one_weight_changes_and_nothing_else(node: str | int) -> None:
    graph = with_weight(GRAPH, node, 2.5)
    assert [other.weight for other in graph.nodes] == [1, 1, 1, 1, 2.5, 1]
    assert with_weight(graph, node, 1.0) == GRAPH
    assert SemanticGraph.from_json(graph.to_json()) == graph


def test_without_a_node_its_words_go_and_the_order_of_other_actions_stays() -> None:
    graph = without(GRAPH, "walks")
    assert (graph.caption, texts(graph), graph.actions[0].order) == ("waves slowly", ["waves", "slowly"], 1)
    graph = without(GRAPH, "waves")
    assert (graph.caption, texts(graph)) == ("a person walks slowly to the left", texts(GRAPH)[:1] + texts(GRAPH)[2:5])
    graph = without(GRAPH, 4)
    assert graph.caption == "a person walks to the left and then waves slowly"
    assert texts(graph) == ["walks", "waves", "a person", "to the left", "slowly"]


@pytest.mark.parametrize(
    ("caption", "removed", "kept", "verb_start", "expected"),
    [
        ("he walks, jumps, and runs.", [(10, 15)], [(3, 8), (21, 25)], 10, "he walks, and runs."),
        ("he walks to the left, then waves and bows", [(27, 32)], [(3, 8), (12, 20), (22, 26)], 27,
         "he walks to the left then and bows"),
        ("he starts to walk", [(13, 17)], [(3, 9), (10, 17)], 13, "he starts to walk"),
        ("slowly he walks", [(0, 6)], [(10, 15)], None, "he walks"),
        ("he walks slowly.", [(9, 15)], [(3, 8)], None, "he walks."),
    ],
)  # fmt: skip
def test_words_are_removed_so_that_the_rest_reads_on(
    caption: str, removed: list[tuple[int, int]], kept: list[tuple[int, int]], verb_start: int | None, expected: str
) -> None:
    text, positions = remove_words(caption, removed, kept, verb_start)
    assert text == expected
    for start, end in kept:
        assert text[positions[start] : positions[end - 1] + 1] == caption[start:end]


def test_a_weight_scales_what_its_node_adds() -> None:
    assert weighted_edge_terms(GRAPH) == [(GRAPH, 1.0)]
    reduced = without(GRAPH, "to the left")
    assert weighted_edge_terms(with_weight(GRAPH, "to the left", 0)) == [(reduced, 1.0)]
    assert weighted_edge_terms(with_weight(GRAPH, "to the left", 0.25)) == [(GRAPH, 0.25), (reduced, 0.75)]
    gain = 2 * UPWEIGHT_GAIN
    assert weighted_edge_terms(with_weight(GRAPH, "to the left", 3)) == [(GRAPH, 1 + gain), (reduced, -gain)]
    both = weighted_edge_terms(with_weight(with_weight(with_weight(GRAPH, 5, 3), "waves", 0.5), 4, 0))
    assert [graph.caption for graph, _ in both] == [
        "a person walks to the left and then waves slowly",
        "a person walks to the left",
        "a person walks and then waves slowly",
    ]
    assert [weight for _, weight in both] == pytest.approx([0.5 + gain, 0.5, -gain])


@given(st.lists(st.sampled_from([0.0, 0.5, 1.0, 3.0]), min_size=6, max_size=6))
def test_any_weights_make_plain_graphs_whose_coefficients_sum_to_one(weights: list[float]) -> None:
    graph = GRAPH
    for number, weight in enumerate(weights, start=1):
        graph = with_weight(graph, number, weight)
    if weights[0] == weights[1] == 0:
        with pytest.raises(InvalidGraphError, match="only action"):
            weighted_edge_terms(graph)
        return
    terms = weighted_edge_terms(graph)
    assert all(node.weight == 1 for plain, _ in terms for node in plain.nodes)
    if 0 not in weights[:2]:
        assert sum(weight for _, weight in terms) == pytest.approx(1)
        assert len(terms) == 1 + sum(weight not in (0, 1) for weight in weights)


def test_the_only_action_counts_against_no_text() -> None:
    alone = without(GRAPH, "waves")
    assert weighted_edge_terms(with_weight(alone, "walks", 0.5)) == [(alone, 0.5)]
    with pytest.raises(InvalidGraphError, match="only action"):
        weighted_edge_terms(with_weight(alone, "walks", 0))


@pytest.mark.parametrize("text", ["runs", "strolls about", "x"])
def test_other_words_go_into_the_caption_and_every_span_follows(text: str) -> None:
    graph = replaced(GRAPH, "walks", text)
    assert graph.caption == CAPTION.replace("walks", text)
    assert texts(graph) == [text, *texts(GRAPH)[1:]]
    assert replaced(graph, text, "walks") == GRAPH
    assert texts(masked(GRAPH, "waves"))[1] == MASK


def test_a_node_around_the_words_grows_and_one_inside_is_refused() -> None:
    around = SemanticGraph("he starts to walk", (Action("starts", 3, 9, 0, 1.0, (argument("ARG1", "to walk", 10),)),
                                                 Action("walk", 13, 17, 1)))  # fmt: skip
    assert texts(replaced(around, "walk", "run fast")) == ["starts", "run fast", "to run fast"]
    with pytest.raises(InvalidGraphError, match=r"'walk' lies in the words.*2 'walk' \(action\)"):
        replaced(around, "to walk", "to run")
    alone = without(around, 2)
    assert alone.caption == around.caption
    assert texts(replaced(alone, "to walk", "to run")) == ["starts", "to run"]


def test_added_nodes_are_in_the_caption() -> None:
    extended = with_action(GRAPH, "bows ", 0.5)
    assert extended.caption == f"{CAPTION} and bows"
    assert extended.actions[-1] == Action("bows", len(CAPTION) + 5, len(CAPTION) + 9, 2, 0.5)
    limping = with_argument(extended, "walks", "ARGM-ADV", "with a limp")
    assert limping.caption == "a person walks slowly to the left with a limp and then waves slowly and bows"
    assert limping.actions[0].arguments[-1].text == "with a limp" and limping.actions[-1].text == "bows"
    assert without(limping, "with a limp") == extended


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda: with_weight(GRAPH, "to the right", 1), r"no node 'to the right'; there are 1 'walks' \(action\)"),
        (lambda: with_weight(GRAPH, "slowly", 1), r"nodes \[4, 6\]"),
        (lambda: with_weight(GRAPH, 0, 1), "no node 0"),
        (lambda: with_weight(GRAPH, 7, 1), r"6 'slowly' \(ARGM-MNR of 'waves'\)"),
        (lambda: with_weight(GRAPH, True, 1), "no node True"),
        (lambda: with_weight(GRAPH, 1, -0.1), "weight must be 0 to"),
        (lambda: with_weight(GRAPH, 1, math.nan), "finite"),
        (lambda: with_weight(GRAPH, 1, math.inf), "finite"),
        (lambda: with_weight(GRAPH, 1, MAX_WEIGHT + 1), "weight must be 0 to"),
        (lambda: without(without(GRAPH, "walks"), "waves"), "only action"),
        (lambda: replaced(GRAPH, "walks", " "), "needs words"),
        (lambda: with_action(GRAPH, ""), "needs words"),
        (lambda: with_action(GRAPH, "x" * 600), "caption must be"),
        (lambda: with_argument(GRAPH, "to the left", "ARG1", "x"), "no action"),
        (lambda: with_argument(GRAPH, "walks", "ARG9", "x"), "role must be one of"),
    ],
)
def test_an_invalid_edit_is_refused(edit: Callable[[], SemanticGraph], message: str) -> None:
    with pytest.raises(InvalidGraphError, match=message):
        edit()


def test_no_more_nodes_than_the_model_takes() -> None:
    graph = GRAPH
    for number in range(MAX_NODES - GRAPH.node_count):
        graph = with_action(graph, f"a{number}")
    with pytest.raises(InvalidGraphError, match=f"may have {MAX_NODES} nodes"):
        with_action(graph, "one more")


@given(st.integers(1, 6), st.text(min_size=1, max_size=20).filter(str.strip), st.integers(1, 6), st.floats(0, 3))
def test_any_edits_leave_a_graph_that_comes_back_from_json(node: int, text: str, other: int, weight: float) -> None:
    graph = with_weight(replaced(GRAPH, node, text), other, weight)
    assert SemanticGraph.from_json(graph.to_json()) == graph
    assert graph.nodes[node - 1].text == text.strip() and graph.node_count == GRAPH.node_count


def test_the_picture_shows_every_node_edge_and_weight() -> None:
    graph = with_weight(with_weight(replaced(GRAPH, "walks", "walks <&> runs"), "waves", 0.0), "to the left", 2.5)
    svg = graph_svg(graph)
    root = ElementTree.fromstring(svg)
    shown = ["".join(element.itertext()) for element in root.iter("{http://www.w3.org/2000/svg}text")]
    for node in graph.nodes:
        assert node.text in shown
    assert shown.count("ARGM-MA") == 1 and "ARGM-MA ×0" in shown and "ARGM-DIR ×2.5" in shown
    assert svg.count("stroke-dasharray") == 1 and svg.count("opacity") == 2
    assert len(root.findall(".//{http://www.w3.org/2000/svg}path")) == len(graph.nodes)
    assert svg == graph_svg(graph)


def test_edits_keep_what_is_negated() -> None:
    walks, waves = GRAPH.actions
    graph = dataclasses.replace(GRAPH, actions=(walks, dataclasses.replace(waves, negated=True)))
    edits = (
        with_weight(graph, "waves", 0.5),
        replaced(graph, "waves", "bows"),
        masked(graph, 6),
        without(graph, "to the left"),
        with_argument(graph, "waves", "ARG1", "both hands"),
        with_action(graph, "bows"),
    )
    for edited in edits:
        assert [action.negated for action in edited.actions[:2]] == [False, True], edited.caption
    assert not with_action(graph, "bows").actions[2].negated
    assert without(graph, "walks").actions[0].negated


def test_the_picture_dashes_a_negated_action() -> None:
    walks, waves = GRAPH.actions
    svg = graph_svg(dataclasses.replace(GRAPH, actions=(walks, dataclasses.replace(waves, negated=True))))
    assert svg.count("stroke-dasharray") == 2  # the edge to it and its box
    assert ">not ARGM-MA<" in svg and svg.count(">ARGM-MA<") == 1
    assert "stroke-dasharray" not in graph_svg(GRAPH)


@pytest.mark.usefixtures("toy_by_default")
def test_edits_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    edits = ["--weight", "to the left=2", "--drop", "slowly", "--replace", "walks=runs", "--mask", "1"]
    assert cli.main(["parse", "a person walks slowly to the left", *edits]) == 0
    graph = SemanticGraph.from_json(capsys.readouterr().out)
    assert graph.caption == f"a person {MASK} to the left"
    assert {node.text: node.weight for node in graph.nodes} == {MASK: 1, "a person": 1, "to the left": 2}
    (tmp_path / "g.json").write_text(graph.to_json())
    few = ["--steps", "2", "--seconds", "1", "--seed", "1", "--quiet"]
    assert cli.main(["generate", "--graph", str(tmp_path / "g.json"), *few, "-o", str(tmp_path / "a.npz")]) == 0
    from_sentence = ["generate", "a person walks slowly to the left", *edits, *few, "-o", str(tmp_path / "b.npz")]
    assert cli.main(from_sentence) == 0
    with np.load(tmp_path / "a.npz") as from_graph, np.load(tmp_path / "b.npz") as from_text:
        np.testing.assert_array_equal(from_graph["joints"], from_text["joints"])
    assert cli.main(["parse", "--graph", str(tmp_path / "g.json"), "--svg", str(tmp_path / "g.svg")]) == 0
    assert ElementTree.parse(tmp_path / "g.svg").getroot().tag.endswith("svg")


@pytest.mark.usefixtures("toy_by_default")
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["a person walks", "--weight", "walks"], "its new value"),
        (["a person walks", "--weight", "walks=much"], "'much' is no number"),
        (["a person walks", "--weight", "walks=-1"], "weight must be"),
        (["a person walks", "--drop", "slowly"], "no node 'slowly'; there are 1 'walks'"),
        (["a person walks", "--svg", "g.txt"], "can be saved as .svg"),
        (["--jsonl", "x.jsonl", "--drop", "slowly"], "edits one sentence"),
        (["--jsonl", "x.jsonl", "a person walks"], "either --jsonl"),
        (["--jsonl", "x.jsonl", "--svg", "g.svg"], "either --jsonl"),
    ],
)
def test_an_invalid_edit_prints_one_line(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert message in fails(capsys, "parse", *words)


def test_weight_zero_removes_a_node_and_weight_one_changes_nothing(toy: MotionPipeline) -> None:
    graph = toy.parse("a person walks slowly to the left")
    few = {"steps": (3, 3, 4), "seconds": 2, "seed": 3}
    plain = toy.generate(graph, **few).joints
    assert toy.generate(with_weight(graph, "to the left", 1.0), **few).joints.tobytes() == plain.tobytes()
    reduced = toy.generate(without(graph, "to the left"), **few).joints
    for weight, tolerance in ((0.0, 1e-5), (1e-6, 1e-3)):
        faint = toy.generate(with_weight(graph, "to the left", weight), **few).joints
        np.testing.assert_allclose(faint, reduced, atol=tolerance)
    assert not np.allclose(reduced, plain, atol=1e-3)


@pytest.mark.parametrize(("weight", "coefficient"), [(0.5, 0.5), (2.0, 1 + UPWEIGHT_GAIN)])
def test_a_weight_between_is_the_latent_aware_composition_of_with_and_without(
    toy: MotionPipeline, weight: float, coefficient: float
) -> None:
    graph = toy.parse("a person walks slowly to the left")
    few: dict[str, Any] = {"steps": (3, 3, 4), "seconds": 2, "seed": 3}
    edited = with_weight(graph, "to the left", weight)
    both = [Concept(graph, coefficient), Concept(without(graph, "to the left"), 1 - coefficient)]
    # Both are all that happens, where concepts of a composition would be parts of it.
    spec = dataclasses.replace(validate_composition(both, "latent", None, None, None), partial=(False, False))
    options = resolve_options(toy.manifest, **few)
    conditions, plan, _, _ = toy.encode_composition(spec, options, own_length=False)
    latents = toy.sampler.sample(conditions, plan.weights, [options])
    expected = toy.decoder.decode(latents, [options], [graph.caption])[0].joints
    np.testing.assert_allclose(toy.generate(edited, **few).joints, expected, atol=1e-4)
    for how in ({"method": "latent"}, {"method": "fused", "lambdas": (0.0, 0.0, 1.0)}):
        np.testing.assert_allclose(toy.compose([edited], **how, **few).joints, expected, atol=1e-4)
