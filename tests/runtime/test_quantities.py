"""Lengths and counts in words: their number, unit, place and action, and what is no quantity."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.bundle.reader import text_files_folder
from kinegraph.graph import Action, Argument, SemanticGraph
from kinegraph.text.quantities import MAX_NUMBER, find_quantities, read_quantities

pytest.importorskip("spacy")

from kinegraph.text.parser import GraphParser, read_parser

BUNDLE = text_files_folder()


@pytest.fixture(scope="module")
def parser() -> GraphParser:
    return read_parser(BUNDLE)


def test_a_stroke_behind_a_number_is_no_fraction() -> None:
    assert find_quantities("1/ march in place 2/ salute") == find_quantities("3 / 4 and 5 /") == []


@pytest.mark.parametrize(
    ("caption", "number", "unit", "words"),
    [
        ("a man limps for four seconds", 4, "seconds", "for four seconds"),
        ("crawl for 30 seconds, then rest", 30, "seconds", "for 30 seconds"),
        ("she kneels for half a minute", 30, "seconds", "for half a minute"),
        ("sit for a quarter of a minute", 15, "seconds", "for a quarter of a minute"),
        ("hop for one and a half seconds", 1.5, "seconds", "for one and a half seconds"),
        ("wait a minute and a half", 90, "seconds", "a minute and a half"),
        ("jog for about twenty-five seconds", 25, "seconds", "for about twenty-five seconds"),
        ("a walk, 2s long", 2, "seconds", "2s long"),
        ("a 3 second dance", 3, "seconds", "3 second"),
        ("a five-second wave", 5, "seconds", "five-second"),
        ("wave for 2.5 sec.", 2.5, "seconds", "for 2.5 sec"),
        ("stretch for 5min", 300, "seconds", "for 5min"),
        ("bow in 4 seconds", 4, "seconds", "in 4 seconds"),
        ("stand for 2-3 seconds", 2.5, "seconds", "for 2-3 seconds"),
        ("run for ninety nine seconds", 99, "seconds", "for ninety nine seconds"),
        ("walk for three-and-a-half seconds", 3.5, "seconds", "for three-and-a-half seconds"),
        ("walk for 3 1/2 seconds", 3.5, "seconds", "for 3 1/2 seconds"),
        ("walk for 3/2 seconds", 1.5, "seconds", "for 3/2 seconds"),
        ("walk for 3,5 seconds", 3.5, "seconds", "for 3,5 seconds"),
        ("wait for .5 seconds", 0.5, "seconds", "for .5 seconds"),
        ("wait for a second", 1, "seconds", "for a second"),
        ("walk three paces forward", 3, "steps", "three paces"),
        ("turn left over 4 seconds", 4, "seconds", "over 4 seconds"),
        ("a walk lasting 4 seconds", 4, "seconds", "lasting 4 seconds"),
        ("walk up to 5 seconds", 5, "seconds", "up to 5 seconds"),
        ("walk for between 2 and 3 seconds", 2.5, "seconds", "between 2 and 3 seconds"),
        ("she claps twice", 2, "times", "twice"),
        ("spin around three times", 3, "times", "three times"),
        ("nod at least 4 times", 4, "times", "at least 4 times"),
        ("jump 2x", 2, "times", "2x"),
        ("jump x3", 3, "times", "x3"),
        ("bow once more", 1, "times", "once more"),
        ("he bows once.", 1, "times", "once"),
        ("do five squats", 5, "times", "five squats"),
        ("two quick punches", 2, "times", "two quick punches"),
        ("a dozen jumps", 12, "times", "a dozen jumps"),
        ("clap a hundred times", 100, "times", "a hundred times"),
        ("walk two steps", 2, "steps", "two steps"),
        ("take 3 big steps back", 3, "steps", "3 big steps"),
        ("walk a couple of steps", 2, "steps", "a couple of steps"),
        ("one step to the left", 1, "steps", "one step"),
    ],
)
def test_quantities_are_read(caption: str, number: float, unit: str, words: str) -> None:
    (found,) = find_quantities(caption)
    assert (found.number, found.unit, caption[found.start : found.end]) == (number, unit, words)


@pytest.mark.parametrize(
    "caption",
    [
        "a person walks", "walk a few steps", "take a step", "sit for a while", "wait a moment", "turn 90 degrees",
        "walk ten meters", "the second step", "a second time", "a second later he bows", "after two seconds she waves",
        "wave every 3 seconds", "once he arrives he bows", "two or three times", "jump 3x faster", "0 seconds",
        "for zero seconds", "-3 seconds", "for 9" + "9" * 400 + " seconds", "1e5 seconds", "for 99999999 seconds",
        "for ٣ seconds", "½ second", "", "two people dance", "raise both hands", "a man with two sticks",
        "a person makes 90 degree turns", "two 180 degree jumps", "walk in 2 s-curves",
    ],
)  # fmt: skip
def test_what_is_vague_or_nonsense_is_not_read(caption: str) -> None:
    assert find_quantities(caption) == []


@given(st.text(max_size=80))
def test_any_text_is_read(text: str) -> None:
    check_any(text)


WORDS = [
    "for", "a", "an", "one", "two", "half", "quarter", "and", "-", ".", "0", "7", "12", "99999", "1.5", "second",
    "seconds", "minute", "step", "steps", "times", "x", "twice", "once", "more", "of", "about", "at", "least", "jump",
    "jumps", "hundred", "dozen", "couple", "to", "or", "long",
]  # fmt: skip


@given(st.lists(st.sampled_from(WORDS), max_size=12), st.sampled_from([" ", ""]))
def test_any_words_of_quantities_are_read(words: list[str], joiner: str) -> None:
    check_any(joiner.join(words))


def check_any(text: str) -> None:
    end = 0
    for found in find_quantities(text):
        assert end <= found.start < found.end <= len(text)
        assert 0 < found.number <= MAX_NUMBER
        end = found.end


def test_a_quantity_belongs_to_its_action(parser: GraphParser) -> None:
    graph = parser.parse("a person walks two steps, waves for three seconds and bows twice")
    assert [(graph.actions[found.action].text, found.number) for found in read_quantities(graph)] == [
        ("walks", 2), ("waves", 3), ("bows", 2)
    ]  # fmt: skip
    title = parser.parse("a 4 second walk")
    assert title.actions[read_quantities(title)[0].action].text == "walk"


def test_a_quantity_of_no_node_belongs_to_the_action_before_it() -> None:
    caption = "twice he bows and runs for two seconds"
    graph = SemanticGraph(
        caption,
        (Action("bows", 9, 13, 0, arguments=(Argument("ARG0", "he", 6, 8),)), Action("runs", 18, 22, 1)),
    )
    assert [found.action for found in read_quantities(graph)] == [0, 1]


def test_what_says_how_long_or_how_often_is_an_argument_of_its_own(parser: GraphParser) -> None:
    for caption, words in [
        ("spin around three times slowly", "three times"),
        ("clap your hands four times", "four times"),
        ("a man hops on one leg for two seconds and falls", "for two seconds"),
    ]:
        graph = parser.parse(caption)
        assert ("ARGM-TMP", words) in [(part.role, part.text) for part in graph.actions[0].arguments]
