"""Graphs for the model: negations and sequences split, the third person, known wording, and no lengths."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinegraph.bundle.reader import text_files_folder
from kinegraph.edits import with_weight, without
from kinegraph.errors import InvalidGraphError
from kinegraph.graph import ARGUMENT_ROLES, Action, Argument, SemanticGraph
from kinegraph.interpretation import (
    in_third_person,
    known_subject,
    known_wording,
    split_negations,
    split_sequence,
    without_quantity,
)
from kinegraph.limits import MAX_TEXT
from kinegraph.text.narration import third_person
from kinegraph.text.quantities import Quantity, read_quantities
from support.shared import shared_path

pytest.importorskip("spacy")

from kinegraph.text.parser import GraphParser, read_parser

BUNDLE = text_files_folder()
SENTENCES = Path(__file__).parents[2] / "benchmarks" / "parser"


@pytest.fixture(scope="module")
def parser() -> GraphParser:
    return read_parser(BUNDLE)


def captions(graphs: list[SemanticGraph]) -> list[str]:
    return [graph.caption for graph in graphs]


# Negations


@pytest.mark.parametrize(
    ("caption", "positive", "negated"),
    [
        ("a person walks forward without waving the hands", "a person walks forward", ["a person waves the hands"]),
        ("a girl crouches but does not turn left", "a girl crouches", ["a girl turns left"]),
        ("he doesn't walk but runs", "he runs", ["he walks"]),
        ("a person does not walk", None, ["a person walks"]),
        ("he neither runs nor hops", None, ["he runs", "he hops"]),
        ("a man kneels, without waving, and bows", "a man kneels, and bows", ["a man waves"]),
        ("a man limps and then stops limping", "a man limps and then stops", ["a man limps"]),
        ("a woman jogs and stops running", "a woman jogs and stops", ["a woman runs"]),
        ("a person runs forward and stops turning left", "a person runs forward", ["a person turns left"]),
        ("she stops waving the hands and walks on", "she walks on", ["she waves the hands"]),
        ("a boy hops, avoids turning", "a boy hops", ["a boy turns"]),
        ("a boy jogs keeping the arms down", "a boy jogs", ["a boy raises the arms"]),
        ("she bows and holds her left hand down", "she bows", ["she raises her left hand"]),
        ("a woman skips, no hopping, no turning", "a woman skips", ["a woman hops", "a woman turns"]),
        ("crawl instead of walking", "crawl", ["a person walks"]),
        ("not waving, the man leaves", "the man leaves", ["the man waves"]),
        ("she doesn't look back while she limps away.", "she limps away.", ["she looks back"]),
        ("walk without turning or jumping", "walk", ["a person turns", "a person jumps"]),
        ("the boxer is not pushed and sits", "the boxer sits", ["the boxer is pushed"]),
        ("march, no jumps", "march", ["a person jumps"]),
    ],
)
def test_negations_are_split_off(parser: GraphParser, caption: str, positive: str | None, negated: list[str]) -> None:
    wanted, unwanted = split_negations(parser.parse(caption))
    assert (None if wanted is None else wanted.caption) == positive
    assert captions(unwanted) == negated
    for graph in unwanted:
        assert len(graph.actions) == 1 and not graph.actions[0].negated
    if wanted is not None:
        assert not any(action.negated for action in wanted.actions)


def test_a_negated_action_keeps_its_roles_weights_and_order(parser: GraphParser) -> None:
    graph = parser.parse("a person walks slowly without waving the left hand")
    graph = with_weight(with_weight(graph, "waving", 0.5), "slowly", 2.0)
    wanted, (unwanted,) = split_negations(graph)
    assert wanted is not None
    assert [(part.role, part.text, part.weight) for part in wanted.actions[0].arguments] == [
        ("ARG0", "a person", 1.0), ("ARGM-MNR", "slowly", 2.0)
    ]  # fmt: skip
    (action,) = unwanted.actions
    assert (action.text, action.weight, action.order) == ("waves", 0.5, 1)
    assert {part.role: part.text for part in action.arguments} == {"ARG0": "a person", "ARG1": "the left hand"}


def test_a_graph_without_negations_is_left_alone(parser: GraphParser) -> None:
    graph = parser.parse("a person walks and waves")
    assert split_negations(graph) == (graph, [])


def test_dropping_a_negated_action_drops_what_negates_it(parser: GraphParser) -> None:
    for caption, node, rest in [
        ("a person walks forward without waving the hands", "waving", "a person walks forward"),
        ("a girl kneels but does not turn", "turn", "a girl kneels"),
        ("she doesn't clap and bows", "clap", "she bows"),
        ("hop forward, no spinning", "spinning", "hop forward"),
    ]:
        graph = without(parser.parse(caption), node)
        assert graph.caption == rest and len(graph.actions) == 1 and not graph.actions[0].negated


# Sequences


@pytest.mark.parametrize(
    ("caption", "parts"),
    [
        ("a person walks forward, then bows", ["a person walks forward", "a person bows"]),
        ("first he kneels and after that he crawls", ["he kneels", "he crawls"]),
        ("walk, turn, bow", ["a person walks", "a person turns", "a person bows"]),
        ("1. open the door 2. walk through it", ["a person opens the door", "a person walks through it"]),
        ("1. a man limps\n2. he falls", ["a man limps", "he falls"]),
        ("The dancer spins twice before she bows.", ["The dancer spins twice", "she bows"]),
        ("After turning left, the figure jogs ahead.", ["the figure turns left", "the figure jogs ahead"]),
        ("before jumping, bend your knees", ["a person bends the knees", "a person jumps"]),
        ("march and wave, then sit down and clap", ["a person marches and waves", "a person sits down and claps"]),
        ("a man runs, turns left while waving, then bows",
         ["a man runs", "a man turns left while waving", "a man bows"]),
        ("running then stopping", ["a person runs", "a person stops"]),
        ("A girl runs; she stops; she looks around.", ["A girl runs", "she stops", "she looks around"]),
        ("he stands and is then pushed from behind", ["he stands", "he is pushed from behind"]),
        ("can you make him jump and then bow?", ["he jumps", "he bows"]),
        ("go left go right", ["a person goes left", "a person goes right"]),
        ("chin up, arms out", ["chin up", "arms out"]),
        ("don't wave, then walk", ["a person doesn't wave", "a person walks"]),
        ("crouch -> roll -> sprint", ["a person crouches", "a person rolls", "a person sprints"]),
    ],
)  # fmt: skip
def test_parts_follow_one_another(parser: GraphParser, caption: str, parts: list[str]) -> None:
    graph = parser.parse(caption)
    split = split_sequence(graph)
    assert captions(split) == parts
    orders = [action.order for part in split for action in part.actions]
    assert sorted(orders) == sorted(action.order for action in graph.actions)


@pytest.mark.parametrize(
    "caption",
    [
        "a person walks and waves",
        "a person raises the right arm while limping slowly",
        "someone jogs with both hands up",
        "a person walks. the style is masculine.",
        "a man waves both hands. they move like an old person.",
        "moving slowly, a woman kneels",
        "The person who waves walks to the right.",
        "a person starts walking",
        "left hand up",
        "a slow jog",
    ],
)
def test_what_happens_at_once_is_one_part(parser: GraphParser, caption: str) -> None:
    graph = parser.parse(caption)
    assert split_sequence(graph) == [graph]
    assert in_third_person(graph) is graph


@pytest.mark.parametrize(
    ("caption", "sentence"),
    [
        ("walk forward and clap", "a person walks forward and claps"),
        ("walk forward, then bow", "a person walks forward, then bows"),
        ("run while they cheer", "a person runs while they cheer"),
        ("jog ahead with both arms held high", "a person jogs ahead with both arms held high"),
        ("1. squat 2. leap 3. clap", "a person squats, then leaps, then claps"),
        ("jumping on the spot", "a person jumps on the spot"),
        ("kneels down", "a person kneels down"),
        ("Raise your left hand.", "a person raises the left hand"),
        ("walk until you reach the wall", "a person walks until they reach the wall"),
        ("make the robot dance, then bow", "the robot dances, then bows"),
        ("skip but don't turn", "a person skips but doesn't turn"),
    ],
)
def test_orders_and_titles_are_told_in_the_third_person(parser: GraphParser, caption: str, sentence: str) -> None:
    graph = in_third_person(parser.parse(caption))
    assert graph.caption == sentence
    assert in_third_person(graph).caption == sentence
    assert [action.text for action in parser.parse(sentence).actions] == [action.text for action in graph.actions]


@pytest.mark.parametrize(
    ("verb", "told"),
    [
        ("walk", "walks"), ("walking", "walks"), ("walked", "walks"), ("walks", "walks"), ("Carry", "carries"),
        ("carried", "carries"), ("stopping", "stops"), ("stepped", "steps"), ("diving", "dives"), ("lying", "lies"),
        ("ran", "runs"), ("knelt", "kneels"), ("go", "goes"), ("punch", "punches"), ("pass", "passes"), ("be", "is"),
        ("have", "has"), ("dribbling", "dribbles"), ("moonwalk", "moonwalks"), ("galumphing", "galumphs"),
        ("speed", "speeds"), ("up", "up"), ("on", "on"), ("走", "走"), ("x", "x"), ("2", "2"),
    ],
)  # fmt: skip
def test_verbs_in_the_third_person(verb: str, told: str) -> None:
    assert third_person(verb) == told


# Other words


@pytest.mark.parametrize(
    ("caption", "known"),
    [
        ("a person turns clockwise", "a person turns right"),
        ("a girl spins counter-clockwise", "a girl spins left"),
        ("rotating anti clockwise", "rotating left"),
        ("a person walks in a circle clockwise", "a person walks in a circle to the right"),
        ("the dog runs in an anti-clockwise circle", "the dog runs in a circle to the left"),
        ("he turns 90 degrees counterclockwise", "he turns 90 degrees to the left"),
        ("she jogs clockwise around a pole", "she jogs to the right around a pole"),
        ("a clockwise turn", "a right turn"),
        ("walk fwd w/ both arms up", "walk forward with both arms up"),
        ("a person walks backwards", "a person walks backward"),
        ("hop & kneel w/o waving", "hop and kneel without waving"),
        ("CCW", "to the left"),
    ],
)
def test_unknown_wording_is_said_in_known_words(parser: GraphParser, caption: str, known: str) -> None:
    graph = parser.parse(caption)
    told = known_wording(graph)
    assert told.caption == known
    assert len(told.actions) == len(graph.actions)
    assert known_wording(told) is told


def test_a_side_in_place_of_a_rotation_is_a_direction(parser: GraphParser) -> None:
    for caption in ("a person turns clockwise", "a man walks in a clockwise circle", "she hops clockwise"):
        sides = [part for part in known_wording(parser.parse(caption)).actions[0].arguments if "right" in part.text]
        assert [part.role for part in sides] == ["ARGM-DIR"]


@pytest.mark.parametrize(
    ("caption", "known"),
    [
        ("he waves", "a person waves"),
        ("at the corner she turns right", "at the corner a person turns right"),
        ("he walks where he stood", "a person walks where he stood"),
        ("the robot waves the right hand", "the person waves the right hand"),
        ("an exhausted robot walks, then it bows", "an exhausted person walks, then it bows"),
        ("an ogre walks slowly", "a person walks slowly"),
        ("a man walks and he waves", "a man walks and he waves"),
        ("the old woman walks", "the old woman walks"),
        ("the left hand waves", "the left hand waves"),
        ("walk to the robot", "walk to the robot"),
        ("a person walks to the robot", "a person walks to the robot"),
    ],
)
def test_who_is_unknown_is_a_person(parser: GraphParser, caption: str, known: str) -> None:
    graph = parser.parse(caption)
    told = known_subject(graph, lambda word: word not in ("robot", "ogre"))
    assert told.caption == known
    roles, before = (
        [[argument.role for argument in action.arguments] for action in made.actions] for made in (told, graph)
    )
    assert roles == before
    assert all(told.caption[node.start : node.end] == node.text for node in told.nodes)


@pytest.mark.parametrize(
    ("caption", "rest"),
    [
        ("a man limps for four seconds", "a man limps"),
        ("crawl for 30 seconds, then rest", "crawl, then rest"),
        ("a 3 second dance", "a dance"),
        ("a five-second wave", "a wave"),
        ("for two seconds, the girl kneels", "the girl kneels"),
        ("she hops, for two seconds, and bows", "she hops, and bows"),
        ("spin around three times slowly", "spin around slowly"),
    ],
)
def test_lengths_are_taken_away(parser: GraphParser, caption: str, rest: str) -> None:
    graph = parser.parse(caption)
    (quantity,) = read_quantities(graph)
    assert without_quantity(graph, quantity).caption == rest


def test_a_quantity_that_cannot_be_taken_away_is_refused(parser: GraphParser) -> None:
    graph = parser.parse("three jumps")
    with pytest.raises(InvalidGraphError, match="'jumps' is a part of 'three jumps'"):
        without_quantity(graph, read_quantities(graph)[0])
    with pytest.raises(InvalidGraphError, match="is not at 0"):
        without_quantity(graph, Quantity(2.0, "times", "twice", 0, 5, 0))


# Any graph


def rewritings(graph: SemanticGraph) -> Iterator[SemanticGraph]:
    """Yield every graph that the functions make of one."""
    for part in split_sequence(graph):
        yield part
        wanted, unwanted = split_negations(part)
        yield from unwanted
        if wanted is not None:
            yield wanted
    yield in_third_person(graph)
    yield known_wording(graph)
    yield known_subject(graph, lambda word: False)
    for quantity in read_quantities(graph):
        if quantity.unit == "seconds":
            yield without_quantity(graph, quantity)


def typed() -> list[str]:
    rows = [SENTENCES / "hard_sentences_dev.jsonl", SENTENCES / "hard_sentences_2_dev.jsonl"]
    lines = [line for path in rows for line in path.read_text(encoding="utf-8").splitlines()]
    return [json.loads(line)["caption"] for line in lines]


def gold() -> list[str]:
    lines = shared_path("graphs", "kit_gold_dev.jsonl").read_text(encoding="utf-8").splitlines()
    return sorted({json.loads(line)["caption"] for line in lines})[::3]


@pytest.mark.parametrize("sentences", [typed, gold])
def test_a_caption_that_is_made_parses_to_its_own_graph(
    parser: GraphParser, sentences: Callable[[], list[str]]
) -> None:
    same = total = 0
    for caption in sentences():
        graph = parser.parse(caption)
        for made in rewritings(graph):
            assert made.caption.strip() == made.caption != ""
            if made is not graph:
                total += 1
                own = [(action.text.lower(), action.negated) for action in made.actions]
                same += [(a.text.lower(), a.negated) for a in parser.parse(made.caption).actions] == own
    assert total > 50 and same >= 0.95 * total


WORDS = [
    "a", "person", "walks", ",", "then", "bows", ".", "without", "waving", "not", "don't", "the", "left", "hand", "and",
    "while", "before", "after", "turning", "clockwise", "counter", "-", "you", "your", "2", "twice", "for", "four",
    "seconds", "\n", ";", "1", "w/", "up", "on", "leg", "is", "pushed", "!", "é", "走", "three", "jumps", "to", "who",
]  # fmt: skip


@st.composite
def graphs(draw: st.DrawFn) -> SemanticGraph:
    caption = " ".join(draw(st.lists(st.sampled_from(WORDS), min_size=1, max_size=14)))

    def span() -> tuple[int, int]:
        start = draw(st.integers(0, len(caption) - 1))
        return start, draw(st.integers(start + 1, len(caption)))

    actions = []
    for order in range(draw(st.integers(1, 4))):
        start, end = span()
        arguments = [
            Argument(draw(st.sampled_from(ARGUMENT_ROLES)), caption[first:last], first, last)
            for first, last in (span() for _ in range(draw(st.integers(0, 3))))
        ]
        negated = draw(st.booleans())
        actions.append(Action(caption[start:end], start, end, order, 1.0, tuple(arguments), negated))
    return SemanticGraph(caption, tuple(actions))


@settings(max_examples=300, deadline=None)
@given(graphs())
def test_any_graph_is_interpreted_or_refused(graph: SemanticGraph) -> None:
    for function in (split_sequence, in_third_person, split_negations, known_wording):
        with suppress(InvalidGraphError):
            function(graph)
    for quantity in read_quantities(graph):
        with suppress(InvalidGraphError):
            assert len(without_quantity(graph, quantity).caption) < len(graph.caption)
    for number in range(1, len(graph.nodes) + 1):
        with suppress(InvalidGraphError):
            without(graph, number)


def test_a_caption_that_becomes_too_long_is_refused() -> None:
    caption = "walk" + " far" * ((MAX_TEXT - 4) // 4)
    far = Argument("ARGM-DIR", caption[5:], 5, len(caption))
    with pytest.raises(InvalidGraphError, match="caption must be"):
        split_sequence(SemanticGraph(caption, (Action("walk", 0, 4, 0, arguments=(far,)),)))
