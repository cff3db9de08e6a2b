"""Words that a bundle was never shown: which spans are told, with what is near, and what is taken for known."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinegraph.bundle.vocabulary import Phrase, Vocabulary, sentences_to_embed
from kinegraph.errors import InvalidInputError
from kinegraph.graph import Action, Argument, SemanticGraph
from kinegraph.text.vocabulary import find_seldom, find_unknown
from kinegraph.text.words import edits_of, split_words, stem
from kinegraph.unknown import MAX_NEAREST, Unknown, describe_unknown
from support.vocabularies import BagEncoder, graph_of, small_facts, small_vocabulary

ENCODER = BagEncoder()
KNOWN = small_vocabulary(ENCODER)
WALK_TO_GIANT = small_facts().phrases


def told(caption: str, *verbs: str) -> list[tuple[str, str]]:
    """Find what is told of a caption with some verbs, as text and reason."""
    found = find_unknown(graph_of(caption, *verbs), KNOWN, ENCODER)
    assert all(caption[span.start : span.end] == span.text for span in found)
    return [(span.text, span.reason) for span in found]


@pytest.mark.parametrize(
    ("caption", "verbs"),
    [
        ("a person walks", ["walks"]),
        ("A Person WALKS forward!", ["WALKS"]),
        ("she's walking", ["walking"]),
        ("walk", ["walk"]),
        ("he walked for 3 seconds, then walks twice", ["walked", "walks"]),
        ("please make the woman walk", ["make", "walk"]),
        ("a man doesn't walk", ["walk"]),
        ("a girl stops walking", ["walking"]),
        ("a girl walks and stops raising the left arm", ["walks", "stops", "raising"]),
        ("she raises the left arm", ["raises"]),
        ("a person raises a hand", ["raises"]),
        ("a person walks and raises both arms", ["walks", "raises"]),
        ("a person wlaks", ["wlaks"]),
        ("a person walsk forward", ["walsk"]),
        ("someone walks with the right hand", ["walks"]),
        ("a person strolls", ["strolls"]),
        ("a person takes a stroll", ["takes"]),
        ("a person [MASK] slowly", ["[MASK]"]),
        ("a person walks a couple of times", ["walks"]),
    ],
)
def test_known_words_are_not_told(caption: str, verbs: list[str]) -> None:
    assert told(caption, *verbs) == []


@pytest.mark.parametrize(
    ("caption", "verbs", "expected"),
    [
        ("a person juggles", ["juggles"], [("juggles", "word")]),
        ("a person walks and juggles", ["walks", "juggles"], [("juggles", "word")]),
        ("juggles, walks, juggles", ["juggles", "walks"], [("juggles", "word"), ("juggles", "word")]),
        ("a person walks with a suitcase", ["walks"], [("with a suitcase", "word")]),
        ("a person walks like a robot", ["walks"], [("like a robot", "word")]),
        ("juggling three of the hats", ["juggling"], [("juggling three of the hats", "word")]),
        ("un homme marche", ["marche"], [("un homme marche", "word")]),
        ("一个人向前走", ["一个人向前走"], [("一个人向前走", "word")]),
        ("asdf", ["asdf"], [("asdf", "word")]),
        ("12345", ["12345"], [("12345", "word")]),
        ("a person", ["person"], [("a person", "word")]),
        ("a person hops", ["hops"], [("hops", "word")]),
        ("two women walk", ["walk"], [("two women", "people")]),
        ("people walk", ["walk"], [("people", "people")]),
        ("a person walks like old people", ["walks"], [("like old people", "word")]),
        ("a person walks and another man walks", ["walks"], [("another man", "people")]),
        ("they raise each other", ["raise"], [("each other", "people")]),
        ("a woman and a man walk", ["walk"], [("woman and a man", "people")]),
        ("a person raises the head", ["raises"], [("raises the head", "combination")]),
        ("a person waves the left foot", ["waves"], [("waves the left foot", "combination")]),
        ("a person raises", ["raises"], [("raises", "combination")]),
    ],
)
def test_what_was_never_shown_is_told(caption: str, verbs: list[str], expected: list[tuple[str, str]]) -> None:
    assert told(caption, *verbs) == expected


def test_a_paraphrase_must_be_nearer_to_the_known_than_to_anything_else() -> None:
    # the encoder takes "strolls" for "walks" and "hops" for "jumps", which training did not show
    assert told("a person strolls forward", "strolls") == []
    assert told("a person hops", "hops") == [("hops", "word")]
    # and nothing is a paraphrase in a clause that holds another unknown word
    assert ("strolls", "word") in told("a person strolls, a robot walks", "strolls", "walks") or told(
        "a person strolls to a robot", "strolls"
    ) == [("strolls to a robot", "word")]


def test_the_nearest_phrases_are_named_by_their_wording_left_and_right_as_one() -> None:
    (span,) = find_unknown(graph_of("a robot raises the left hand", "raises"), KNOWN, ENCODER)
    assert span.text == "robot" and span.nearest[0] == "raises the left hand"
    assert "raises the right hand" not in span.nearest and len(span.nearest) <= 3


def test_a_style_is_compared_with_styles() -> None:
    caption = "a person walks like a robot"
    argument = Argument("ARGM-MNR", "like a robot", 15, 27)
    graph = SemanticGraph(caption, (Action("walks", 9, 14, 0, arguments=(argument,)),))
    (span,) = find_unknown(graph, KNOWN, ENCODER)
    assert span.nearest == ("like a giant",) and ENCODER.asked[-1] == ["a person walks like a robot"]


def test_the_text_encoder_runs_only_where_something_is_unknown_and_once() -> None:
    before = len(ENCODER.asked)
    assert told("a person walks forward and raises the left hand", "walks", "raises") == []
    assert len(ENCODER.asked) == before
    told("a person juggles, kneels and walks with a hat", "juggles", "kneels", "walks")
    assert len(ENCODER.asked) == before + 1
    assert ENCODER.asked[-1] == ["a person juggles", "a person kneels", "a person walks with a hat"]


@settings(max_examples=300, deadline=None)
@given(st.text(min_size=1, max_size=60), st.data())
def test_any_text_gives_spans_of_itself(caption: str, data: st.DataObject) -> None:
    starts = sorted(data.draw(st.sets(st.integers(0, len(caption) - 1), min_size=1, max_size=3)))
    actions = tuple(Action(caption[start : start + 1], start, start + 1, order) for order, start in enumerate(starts))
    spans = find_unknown(SemanticGraph(caption, actions), KNOWN, ENCODER)
    for span in spans:
        assert caption[span.start : span.end] == span.text
    assert [span.start for span in spans] == sorted(span.start for span in spans)


def test_a_long_list_of_unknown_words_stays_within_limits() -> None:
    caption = ", ".join(f"q{number}x" for number in range(80))
    spans = find_unknown(graph_of(caption, "q0x"), KNOWN, ENCODER)
    assert 1 <= len(spans) <= 64
    giant = "z" * 500
    (span,) = find_unknown(graph_of(giant, giant), KNOWN, ENCODER)
    assert span.text == giant and max(map(len, ENCODER.asked[-1])) <= 220


@pytest.mark.parametrize(
    ("words", "base"),
    [
        ("raise raises raising raised", "rais"),
        ("walk walks walking walked walk's", "walk"),
        ("run runs running ran", "run"),
        ("carry carries carrying carried", "carri"),
        ("happy happily", "happi"),
        ("energetic energetically", "energetic"),
        ("go goes going went", "go"),
        ("foot feet", "foot"),
        ("backward backwards", "backward"),
        ("dash dashes dashing", "dash"),
    ],
)
def test_inflections_share_a_stem(words: str, base: str) -> None:
    assert {stem(word) for word in words.split()} == {base}


def test_a_slip_of_spelling_is_an_exchange_a_gap_an_addition_or_another_letter() -> None:
    slips = set(edits_of("walk"))
    assert {"wlak", "wak", "walkk", "awalk", "walks", "wale"} <= slips and "walking" not in slips


def test_words_know_where_punctuation_opens_a_part() -> None:
    words = split_words("He’s walking, then: bows!")
    assert [(word.text, word.opens) for word in words] == [
        ("he's", True), ("walking", False), ("then", True), ("bows", True),
    ]  # fmt: skip


def test_unknown_words_survive_json() -> None:
    span = Unknown("jüggles", 3, 10, ("bows", "runs"), "word")
    assert Unknown.from_dict(json.loads(json.dumps(span.to_dict()))) == span
    assert describe_unknown([span]) == "'jüggles'; nearest: 'bows', 'runs'"
    people = Unknown("two men", 0, 7, (), "people")
    assert describe_unknown([span, people]).endswith(" | 'two men' (more than one person)")


@pytest.mark.parametrize(
    "changes",
    [
        {"text": ""}, {"text": 5}, {"text": "a\ud800"}, {"start": -1, "end": 0}, {"end": 3}, {"start": True},
        {"start": "0"}, {"nearest": "bows"}, {"nearest": [1]}, {"nearest": ["x"] * (MAX_NEAREST + 1)},
        {"reason": "mood"}, {"more": 1},
    ],
)  # fmt: skip
def test_what_is_no_unknown_word_is_refused(changes: dict[str, object]) -> None:
    record = {"text": "x", "start": 0, "end": 1, "nearest": [], "reason": "word", **changes}
    with pytest.raises(InvalidInputError):
        Unknown.from_dict(record)
    with pytest.raises(InvalidInputError, match="keys"):
        Unknown.from_dict({key: value for key, value in record.items() if key != "reason"})


# What is known, and yet seldom comes out


def vocabulary_of(*phrases: Phrase) -> Vocabulary:
    """Build a vocabulary of some phrases."""
    facts = small_facts(phrases=phrases)
    return Vocabulary(facts, ENCODER.rows(sentences_to_embed(facts)))


def seldom(caption: str, *verbs: str, **shares: float) -> list[str]:
    """Find what is told of a caption if actions (`raise_left` is "raise-left") are recognised in some shares."""
    by_name = {name.replace("_", "-"): share for name, share in shares.items()}
    phrases = [replace(phrase, recognised=by_name.get(phrase.name)) for phrase in WALK_TO_GIANT]
    return [note.split(" seldom")[0] for note in find_seldom(graph_of(caption, *verbs), vocabulary_of(*phrases))]


def test_an_action_that_seldom_comes_out_is_told_in_any_inflection() -> None:
    known = vocabulary_of(replace(WALK_TO_GIANT[3], recognised=0.11))
    assert find_seldom(graph_of("she is waving with the right hand", "waving"), known) == (
        "'waves with the right hand' seldom comes out as asked: it is recognised in 11% of its clips",
    )
    assert seldom("a man raised the left hand", "raised", raise_left=0.0) == ["'raises the left hand'"]


@pytest.mark.parametrize(
    ("caption", "verbs", "shares"),
    [
        ("a person raises the left hand", ["raises"], {"raise_left": 0.2}),
        ("a person raises the left hand", ["raises"], {"raise_right": 0.0}),
        ("a person raises the left hand", ["raises"], {}),
        ("a person walks", ["walks"], {"wave": 0.0}),
    ],
)
def test_nothing_is_told_of_what_comes_out_or_was_not_measured(
    caption: str, verbs: list[str], shares: dict[str, float]
) -> None:
    assert seldom(caption, *verbs, **shares) == []


def test_each_clause_is_looked_at_and_what_is_negated_is_not_wanted() -> None:
    caption = "a person walks and raises the left hand"
    shares = {"walk": 0.1, "raise_left": 0.0}
    assert seldom(caption, "walks", "raises", **shares) == ["'walks'", "'raises the left hand'"]
    graph = graph_of(caption, "walks", "raises")
    never = replace(graph, actions=(graph.actions[0], replace(graph.actions[1], negated=True)))
    assert find_seldom(never, vocabulary_of(replace(WALK_TO_GIANT[1], recognised=0.0))) == ()


def test_the_longest_wording_decides() -> None:
    assert seldom("a person walks forward", "walks", walk=0.1) == ["'walks forward'"]
    walk = replace(WALK_TO_GIANT[0], wordings=("walks",), recognised=0.9)
    forward = replace(walk, name="walk-forward", wordings=("walks forward",), recognised=0.1)
    known = vocabulary_of(walk, forward)
    assert find_seldom(graph_of("a person walks", "walks"), known) == ()
    assert len(find_seldom(graph_of("a person walks forward", "walks"), known)) == 1
