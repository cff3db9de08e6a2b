"""The semantic graph: validation, JSON round trip, and invalid graphs refused."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.errors import InvalidGraphError, InvalidInputError
from kinegraph.graph import ARGUMENT_ROLES, MAX_WEIGHT, MOTION_ACTION, ROLES, Action, Argument, SemanticGraph
from kinegraph.limits import MAX_NODES, MAX_TEXT

CAPTION = "a person walks slowly to the left"
GRAPH = SemanticGraph(
    CAPTION,
    (
        Action(
            "walks",
            9,
            14,
            0,
            1.5,
            (Argument("ARG0", "a person", 0, 8), Argument("ARGM-MNR", "slowly", 15, 21, 0.0)),
        ),
    ),
)


def edited(**changes: Any) -> dict[str, Any]:
    """Return the graph as parsed JSON, with keys of its first action changed; None removes a key."""
    value = GRAPH.to_dict()
    for name, change in changes.items():
        value["actions"][0][name] = change
        if change is None:
            del value["actions"][0][name]
    return value


def test_the_twelve_edge_types_keep_their_numbers() -> None:
    # Trained weights depend on them.
    assert ROLES == (
        "ARG0", "ARG1", "ARG2", "ARG3", "ARG4", "ARGM-LOC", "ARGM-MNR", "ARGM-TMP", "ARGM-DIR", "ARGM-ADV", "ARGM-MA",
        "OTHERS",
    )  # fmt: skip


def test_graphs_are_immutable() -> None:
    for part in (GRAPH, GRAPH.actions[0], GRAPH.actions[0].arguments[0]):
        with pytest.raises(dataclasses.FrozenInstanceError):
            part.text = "x"  # type: ignore[misc, union-attr]


def test_json_comes_back_as_the_same_graph() -> None:
    assert SemanticGraph.from_json(GRAPH.to_json()) == GRAPH
    assert SemanticGraph.from_json(GRAPH.to_json(indent=2)) == GRAPH
    swapped = dataclasses.replace(GRAPH, actions=(dataclasses.replace(GRAPH.actions[0], order=3),))
    assert SemanticGraph.from_json(swapped.to_json()).actions[0].order == 3


@given(st.text(min_size=1, max_size=40, alphabet=st.characters(exclude_categories=["Cs"])), st.data())
def test_any_text_survives_json(caption: str, data: st.DataObject) -> None:
    start = data.draw(st.integers(0, len(caption) - 1))
    end = data.draw(st.integers(start + 1, len(caption)))
    weight = data.draw(st.floats(0, MAX_WEIGHT))
    graph = SemanticGraph(caption, (Action(caption[start:end], start, end, 0, weight),))
    assert SemanticGraph.from_json(graph.to_json()) == graph


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"start": 8}, "caption"),
        ({"start": -1}, "offsets"),
        ({"end": len(CAPTION) + 1}, "offsets"),
        ({"start": 9.0}, "offsets"),
        ({"start": True}, "offsets"),
        ({"text": "runs"}, "runs"),
        ({"text": 5}, "text"),
        ({"weight": -0.1}, "weight"),
        ({"weight": math.inf}, "weight"),
        ({"weight": math.nan}, "weight"),
        ({"weight": MAX_WEIGHT * 2}, "weight"),
        ({"weight": "1"}, "weight"),
        ({"weight": True}, "weight"),
        ({"order": -1}, "order"),
        ({"order": 1.0}, "order"),
        ({"arguments": {}}, "list"),
        ({"arguments": [{"role": MOTION_ACTION, "text": "a", "start": 0, "end": 1}]}, "role"),
        ({"arguments": [{"role": "ARG9", "text": "a", "start": 0, "end": 1}]}, "ARG9"),
        ({"arguments": [{"text": "a", "start": 0, "end": 1}]}, "role"),
        ({"arguments": ["a person"]}, "object"),
        ({"negated": 1}, "negated"),
        ({"negated": "true"}, "negated"),
        ({"text": None}, "text"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_invalid_graphs_are_refused_by_name(changes: dict[str, Any], named: str) -> None:
    with pytest.raises(InvalidGraphError, match=named):
        SemanticGraph.from_dict(edited(**changes))


@pytest.mark.parametrize(
    "text",
    [
        "", "null", "[]", "{", '{"caption": "a"}', '{"caption": "a", "actions": []}', "[" * 100_000,
        '{"caption": "", "actions": [{"text": "", "start": 0, "end": 0}]}',
        '{"caption": 5, "actions": []}', "NaN", '{"caption": "a", "actions": [], "x": 1}',
        json.dumps({"caption": "a" * (MAX_TEXT + 1), "actions": [{"text": "a", "start": 0, "end": 1}]}),
        GRAPH.to_json().replace("1.5", "NaN"), GRAPH.to_json().replace("1.5", "1e999"),
    ],
)  # fmt: skip
def test_other_json_is_refused(text: str) -> None:
    with pytest.raises(InvalidGraphError):
        SemanticGraph.from_json(text)


def test_more_nodes_than_the_model_takes_are_refused() -> None:
    def with_actions(count: int) -> SemanticGraph:
        return SemanticGraph("walks", tuple(Action("walks", 0, 5, order % MAX_NODES) for order in range(count)))

    assert with_actions(MAX_NODES - 1).node_count == MAX_NODES
    with pytest.raises(InvalidGraphError, match=str(MAX_NODES + 1)):
        with_actions(MAX_NODES)


def test_an_invalid_graph_is_invalid_input() -> None:
    # One `except` catches both.
    assert issubclass(InvalidGraphError, InvalidInputError)


def test_a_negated_action_says_so_in_json_and_any_other_says_nothing() -> None:
    negated = dataclasses.replace(GRAPH, actions=(dataclasses.replace(GRAPH.actions[0], negated=True),))
    assert json.loads(negated.to_json())["actions"][0]["negated"] is True
    assert SemanticGraph.from_json(negated.to_json()) == negated != GRAPH  # nothing but a negated action is a graph
    assert '"negated"' not in GRAPH.to_json()
    assert SemanticGraph.from_dict(edited(negated=False)) == GRAPH
    with pytest.raises(InvalidGraphError, match=r"actions\[0\]\.negated must be true or false, not None"):
        dataclasses.replace(GRAPH, actions=(dataclasses.replace(GRAPH.actions[0], negated=None),))  # type: ignore[arg-type]


@pytest.mark.parametrize("role", ARGUMENT_ROLES)
def test_every_role_except_that_of_actions_is_allowed(role: str) -> None:
    argument = Argument(role, "slowly", 15, 21)
    graph = SemanticGraph(CAPTION, (Action("walks", 9, 14, 0, arguments=(argument,)),))
    assert graph.node_count == 3


@pytest.mark.parametrize(
    "value", [10**400, -(10**5000), 1e400, float("nan"), "1", None, True, [1]], ids=lambda value: type(value).__name__
)
def test_a_weight_of_any_size_or_type_is_refused_in_few_words(value: object) -> None:
    with pytest.raises(InvalidGraphError) as caught:
        SemanticGraph("a person walks", (Action("walks", 9, 14, 0, value),))  # type: ignore[arg-type]
    assert "weight must be" in str(caught.value) and len(str(caught.value)) < 200
    text = '{"caption":"a person walks","actions":[{"text":"walks","start":9,"end":14,"weight":1%s}]}' % ("0" * 400)
    with pytest.raises(InvalidGraphError, match="weight must be a finite number"):
        SemanticGraph.from_json(text)


@pytest.mark.parametrize("field", ["text", "start", "end", "order", "negated"])
def test_numbers_of_thousands_of_digits_in_any_field_are_refused_in_few_words(field: str) -> None:
    fields = {"text": "walks", "start": 9, "end": 14, "order": 0, field: 10**5000}
    with pytest.raises(InvalidGraphError) as caught:
        SemanticGraph("a person walks", (Action(**fields),))  # type: ignore[arg-type]
    assert len(str(caught.value)) < 200
