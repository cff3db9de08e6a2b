"""What a sentence asks of the model: lengths in words, negations, orders, and what it does not get."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from kinegraph import InvalidInputError, MotionPipeline, Waypoint
from kinegraph.bundle.manifest import Manifest
from kinegraph.bundle.reader import read_bundle
from kinegraph.concepts import SPOKEN_NEGATION_WEIGHT, validate_composition
from kinegraph.graph import Action, SemanticGraph
from kinegraph.options import part_seed, resolve_options
from kinegraph.request import (
    AT_ONCE,
    STANDING,
    TOO_SHORT_IN_ORDER,
    interpret,
    interpret_composition,
    share_frames,
    split_in_order,
)

pytest.importorskip("spacy")

FEW: dict[str, Any] = {"steps": (2, 2, 3), "seed": 3}


@pytest.fixture
def manifest(toy: MotionPipeline) -> Manifest:
    return toy.manifest


@pytest.mark.parametrize(
    ("sentence", "seconds", "told"),
    [
        ("a person walks for four seconds", 4.0, ()),
        ("a person walks for 3.5 seconds", 3.5, ()),
        ("a person walks for a minute", 9.8, ("for a minute",)),
        ("a person walks for half a second", 0.8, ("for half a second",)),
        ("a person walks four steps", 2.75, ()),
        ("a person bows twice", None, ("twice",)),
        ("a person walks", None, ()),
    ],
)
def test_lengths_and_counts_in_words(
    toy: MotionPipeline, manifest: Manifest, sentence: str, seconds: float | None, told: tuple[str, ...]
) -> None:
    request = interpret(toy.parse(sentence), manifest)
    assert request.seconds == (None if seconds is None else pytest.approx(seconds))
    assert len(request.notes) == len(told)
    for words, note in zip(told, request.notes, strict=True):
        assert repr(words) in note
    assert "second" not in request.wanted.caption and "minute" not in request.wanted.caption
    assert request.graph.caption == sentence  # what the user wrote stays


def test_the_length_that_the_caller_gives_goes_first(toy: MotionPipeline) -> None:
    spoken = toy.generate("a person walks for two seconds", **FEW)
    assert spoken.duration == 2.0 and spoken.text == "a person walks for two seconds"
    assert toy.generate("a person walks for two seconds", seconds=3, **FEW).duration == 3.0
    assert interpret(toy.parse("a person walks for 20 seconds"), toy.manifest, seconds=4.0).notes == ()
    assert len(interpret(toy.parse("a person bows twice"), toy.manifest, seconds=4.0).notes) == 1
    plain = toy.generate("a person walks", seconds=2, **FEW)
    np.testing.assert_array_equal(spoken.joints, plain.joints)  # the model is not told of seconds


def test_who_is_unknown_is_a_person_to_the_model_alone(toy: MotionPipeline) -> None:
    for sentence in ("he walks forward", "she walks forward"):
        clip = toy.generate(sentence, seconds=2, **FEW)
        assert clip.text == sentence and clip.graph is not None and clip.graph.caption == sentence
        np.testing.assert_array_equal(clip.joints, toy.generate("a person walks forward", seconds=2, **FEW).joints)


ORDERED = "a person walks forward, then bows"


def test_actions_in_order_are_parts_in_a_shared_run_too(toy: MotionPipeline) -> None:
    few = {**FEW, "seconds": [3, 2], "foot_fix": False, "seed": 5}
    shared, alone = (
        toy.batch([ORDERED, "a person waves"], takes=2, shared_run=shared, **few) for shared in (True, False)
    )
    for clip, own in zip(shared, alone, strict=True):
        assert (clip.text, clip.seed, clip.graph, clip.notes) == (own.text, own.seed, own.graph, own.notes)
        np.testing.assert_allclose(clip.joints, own.joints, atol=1e-3)
    parts = toy.sequence(["a person walks forward", "a person bows"], **{**FEW, "seconds": 1.5, "seed": 5})
    assert parts.frames == shared[0].frames == 60


@pytest.mark.parametrize("method", ["latent", "semantic", "fused"])
def test_concepts_are_read_as_sentences_are(toy: MotionPipeline, method: str) -> None:
    text = "a person walks for two seconds without waving the hands"
    composed = toy.compose([text], method=method, **FEW)
    assert composed.text == text and composed.duration == 2.0
    np.testing.assert_allclose(composed.joints, toy.generate(text, **FEW).joints, atol=1e-4)
    two = toy.compose(["he walks for two seconds", "a person nods for 30 seconds"], method=method, **FEW)
    assert two.duration == 9.8 and any("for 30 seconds" in note for note in two.notes)


def test_what_several_concepts_negate_counts_once(toy: MotionPipeline) -> None:
    texts = ["a person walks without waving", "a person nods without waving"]
    spec = validate_composition(texts, "fused", None, None, None)
    asked = interpret_composition(spec, [toy.parse(text) for text in map(str, spec.texts)], toy.manifest)
    assert [(each.caption, each.weight) for each in asked.spec.negated] == [("a person waves", SPOKEN_NEGATION_WEIGHT)]
    assert [graph.caption for graph in asked.graphs[:2]] == ["a person walks", "a person nods"]
    assert len(asked.graphs) == len(asked.spec.texts) == len(asked.spec.partial) == 4
    toy.compose(texts, seconds=1, **FEW)


def test_constraints_that_weigh_nothing_change_nothing(toy: MotionPipeline) -> None:
    held = [Waypoint(1.0, (0.0, 0.5))]
    for text in (ORDERED, "a person raises the left hand while waving the right hand"):
        plain = toy.generate(text, seconds=3, **FEW)
        for how in ({"constraint_weight": 0.0}, {"constraints": [replace(held[0], weight=0.0)]}):
            clip = toy.generate(text, seconds=3, **{"constraints": held, **how}, **FEW)
            np.testing.assert_array_equal(clip.joints, plain.joints)
            assert clip.notes == plain.notes and len(clip.misses) == 1 and clip.misses[0].metres > 0


def test_actions_in_order_that_are_made_at_once_are_told(toy: MotionPipeline) -> None:
    held = [Waypoint(1.0, (0.0, 0.5))]
    assert AT_ONCE in toy.generate(ORDERED, seconds=3, constraints=held, **FEW).notes
    assert AT_ONCE not in toy.generate("a person walks", seconds=3, constraints=held, **FEW).notes
    assert AT_ONCE not in toy.generate(ORDERED, seconds=3, **FEW).notes


def test_a_negated_action_is_a_concept_of_negative_weight(toy: MotionPipeline, manifest: Manifest) -> None:
    request = interpret(toy.parse("a person walks forward without waving the hands"), manifest)
    assert request.wanted.caption == "a person walks forward"
    assert [graph.caption for graph in request.negated] == ["a person waves the hands"]
    assert request.plan.weights.concepts == (1.0,) and request.plan.weights.negated == (SPOKEN_NEGATION_WEIGHT,)
    assert not request.plan.is_plain
    walk = toy.generate("a person walks forward", seconds=1.5, **FEW)
    without = toy.generate("a person walks forward without waving the hands", seconds=1.5, **FEW)
    assert np.abs(walk.joints - without.joints).max() > 1e-4
    assert without.graph is not None and [action.negated for action in without.graph.actions] == [False, True]


@pytest.mark.parametrize(
    ("sentence", "wanted", "negated"),
    [
        ("a person runs with no waving of the left hand", "a person runs", "waves"),
        ("a person runs with no raised arms", "a person runs", "raises"),
        ("a person bows with no walking", "a person bows", "walks"),
        ("someone walks backward with no jump", "someone walks backward", "jumps"),
    ],
)
def test_no_before_a_noun_of_motion_is_a_negation(
    toy: MotionPipeline, manifest: Manifest, sentence: str, wanted: str, negated: str
) -> None:
    request = interpret(toy.parse(sentence), manifest)
    assert request.wanted.caption == wanted
    assert [graph.actions[0].text for graph in request.negated] == [negated]


def test_nothing_but_a_negation_is_to_stand_still(toy: MotionPipeline, manifest: Manifest) -> None:
    request = interpret(toy.parse("a person does not walk"), manifest)
    assert request.wanted == STANDING and [graph.caption for graph in request.negated] == ["a person walks"]
    assert "stand still" in request.notes[0]
    assert "stand still" in toy.generate("a person does not walk", seconds=1, **FEW).notes[0]


def test_a_shared_run_refuses_negations(toy: MotionPipeline) -> None:
    with pytest.raises(InvalidInputError, match="negate actions; leave out shared_run"):
        toy.takes("a person walks without waving", 2, shared_run=True, **FEW)
    assert len(toy.takes("a person walks without waving", 2, seconds=1, **FEW)) == 2


@pytest.mark.parametrize(("seconds", "parts"), [(4.0, 2), (8.0, 2), (1.2, 1)], ids=["short", "long", "too short"])
def test_actions_in_order_are_parts_where_there_is_room(toy: MotionPipeline, seconds: float, parts: int) -> None:
    graph = toy.parse("a person walks forward, then bows")
    assert len(split_in_order(graph)) == 2
    totals: list[int] = []
    clip = toy.generate(graph, seconds=seconds, on_step=lambda info: totals.append(info.total), **FEW)
    assert totals[0] == (14 if parts == 2 else 7)
    assert (TOO_SHORT_IN_ORDER in clip.notes) == (parts == 1)
    at_once = toy.parse("a person walks while waving")
    assert split_in_order(at_once) == [at_once]


@pytest.mark.parametrize(
    ("sentence", "seconds"),
    [
        ("a person takes one step forward, then bows", None),
        ("a person walks, stops for 0.5 seconds, and walks again", None),
    ],
)
def test_the_length_of_one_action_is_not_that_of_the_whole(
    toy: MotionPipeline, sentence: str, seconds: float | None
) -> None:
    parts = split_in_order(toy.parse(sentence))
    assert len(parts) > 1
    totals: list[int] = []
    clip = toy.generate(sentence, seconds=seconds, on_step=lambda info: totals.append(info.total), **FEW)
    assert totals[0] == 7 * len(parts) and clip.duration > 1.5 and TOO_SHORT_IN_ORDER not in clip.notes


@pytest.mark.parametrize(
    ("sentence", "seconds"),
    [
        ("a person walks for 4 seconds while waving for 4 seconds", 4.0),
        ("a person walks five steps in 3 seconds", 3.0),
        ("a person walks for 2 seconds, then bows for 3 seconds", 5.0),
    ],
)
def test_lengths_at_once_and_in_order(toy: MotionPipeline, manifest: Manifest, sentence: str, seconds: float) -> None:
    assert interpret(toy.parse(sentence), manifest).seconds == pytest.approx(seconds)


@pytest.mark.parametrize(
    ("sentence", "wanted"),
    [
        ("don’t move", "a person doesn't move"),
        ("you're walking slowly", "a person is walking slowly"),
        ("I'm walking forward", "a person is walking forward"),
        ("your left arm goes up", "the left arm goes up"),
        ("my character waves", "the character waves"),
        ("walk until your hand touches the wall", "a person walks until the hand touches the wall"),
        ("walks for three-and-a-half seconds", "a person walks"),
        ("waits for a second", "a person waits"),
        ("walk ➡ wave ➜ bow", "a person walks, then waves, then bows"),
        ("turn left, then right", "a person turns left, then turns right"),
        ("Kate walks forward", "Kate walks forward"),
        ("make a 5 second clip of a person walking", "a person walking"),
        ("a realistic animation of a man jumping", "a man jumping"),
        ("an animation with a man jumping", "a man jumping"),
        ("can I see a man walking", "a man walking"),
        ("give me a man walking", "a man walking"),
        ("i would like a person who jumps", "a person who jumps"),
        ("a slow motion of the arms", "a slow motion of the arms"),
        ("it waves", "a person waves"),
    ],
)
def test_what_people_type_is_told_as_captions_are(
    toy: MotionPipeline, manifest: Manifest, sentence: str, wanted: str
) -> None:
    assert interpret(toy.parse(sentence), manifest).wanted.caption == wanted


@pytest.mark.parametrize(
    ("sentence", "distance"),
    [
        ("a person walks 10 meters", "10 meters"),
        ("walk 5m forward", "5m"),
        ("a person runs a mile", "a mile"),
        ("a person hops on two feet", None),
        ("a person walks for 5 minutes", None),
        ("a person looks at something 3 meters away", None),
        ("a person walks at 3 m/s", None),
        ("a person runs 2 meters per second", None),
    ],
)
def test_distances_are_told_not_to_be_held(
    toy: MotionPipeline, manifest: Manifest, sentence: str, distance: str | None
) -> None:
    told = [note for note in interpret(toy.parse(sentence), manifest).notes if "how far somebody goes" in note]
    assert [note.split(":")[0] for note in told] == ([] if distance is None else [repr(distance)])


@pytest.mark.parametrize(
    ("sentence", "told"),
    [
        ("a person walks at 3 m/s", ["'3 m/s': how fast"]),
        ("a person runs at 12 km/h", ["'12 km/h': how fast"]),
        ("a person walks to (1, -2.5)", ["'(1, -2.5)': places in words"]),
        ("a person walks while smiling", ["'smiling': a clip has no face"]),
        ("a person walks up the stairs", ["'up the stairs': a clip has no stairs"]),
        ("a person climbs a ladder", ["'climbs a ladder': a clip has no stairs"]),
        ("a person turns left by 1000 degrees", ["'1000 degrees': turns of more than 720"]),
        ("a person turns left by 720 degrees", []),
        ("a person takes two steps up to the line and waves", []),
        ("a person steps up and bows", []),
    ],
)
def test_what_a_body_does_not_show_is_told(
    toy: MotionPipeline, manifest: Manifest, sentence: str, told: list[str]
) -> None:
    notes = interpret(toy.parse(sentence), manifest).notes
    assert [note[: len(start)] for note, start in zip(notes, told, strict=True)] == told


def test_parts_that_a_graph_has_no_room_for_are_told(toy: MotionPipeline, manifest: Manifest) -> None:
    told = "more parts than the 31 that are read"
    each = [f"{verb} slowly with the {side} hand" for verb in ("waves", "claps") for side in ("left", "right")]
    for count in (1, 2, 12):
        caption = "a person " + ", then ".join((each * 3)[:count])
        notes = [note for note in interpret(toy.parse(caption), manifest).notes if told in note]
        assert len(notes) == (count == 12)
    # It says where they begin: nothing behind that is a part, but for actions.
    graph = toy.parse(caption)
    place = int(re.search(r"at character (\d+)", notes[0])[1]) - 1
    assert all(node.end <= place for action in graph.actions for node in action.arguments)
    assert repr(caption[place:].split()[0].rstrip(",")) in notes[0]


def test_a_curly_apostrophe_negates_as_a_straight_one_does(toy: MotionPipeline, manifest: Manifest) -> None:
    request = interpret(toy.parse("a person walks but doesn’t wave"), manifest)
    assert request.wanted.caption == "a person walks" and [g.caption for g in request.negated] == ["a person waves"]


@pytest.mark.parametrize(
    ("sentence", "parts"),
    [
        ("turn left, then right", ["a person turns left", "a person turns right"]),
        (
            "a person raises the left hand, then the right hand and then bows",
            ["a person raises the left hand", "a person raises the right hand", "a person bows"],
        ),
        (
            "a person kicks with the right leg, then with the left leg",
            ["a person kicks with the right leg", "a person kicks with the left leg"],
        ),
        ("a person walks and eventually falls", ["a person walks", "a person falls"]),
        (
            "raise your right hand, then lower it",
            ["a person raises the right hand", "a person lowers the right hand"],
        ),
        (
            "a person lifts both arms and then lowers them slowly",
            ["a person lifts both arms", "a person lowers both arms slowly"],
        ),
        ("a person walks slowly", ["a person walks slowly"]),
    ],
)
def test_a_verb_that_is_said_once_may_be_of_two_parts(toy: MotionPipeline, sentence: str, parts: list[str]) -> None:
    assert [part.caption for part in split_in_order(toy.parse(sentence))] == parts


@pytest.mark.parametrize(
    ("sentence", "wanted"),
    [
        ("an angry wizard walks", "an angry person walks"),
        ("an orc with a limp walks", "a person with a limp walks"),
        ("a girl in a red dress walks", "a girl in a red dress walks"),
        ("the zombies walk", "the zombies walk"),
    ],
)
def test_the_noun_of_who_moves_is_made_known_and_no_other(
    toy: MotionPipeline, manifest: Manifest, sentence: str, wanted: str
) -> None:
    vocabulary = read_bundle().vocabulary
    assert interpret(toy.parse(sentence), manifest, vocabulary).wanted.caption == wanted


def test_parts_make_a_clip_of_the_length_asked_for(toy: MotionPipeline) -> None:
    seen: list[tuple[int, int]] = []
    clip = toy.generate(
        "a person walks forward, then bows", seconds=4, on_step=lambda info: seen.append((info.done, info.total)), **FEW
    )
    assert clip.duration == pytest.approx(4.0, abs=0.4) and clip.text == "a person walks forward, then bows"
    assert clip.graph is not None and len(clip.graph.actions) == 2 and clip.seed == 3
    assert seen == [(step, 14) for step in range(1, 15)]
    again = toy.takes("a person walks forward, then bows", 1, seconds=4, **FEW)[0]
    np.testing.assert_array_equal(clip.joints, again.joints)


def test_lengths_of_parts_are_kept(toy: MotionPipeline) -> None:
    clip = toy.generate("a person walks for three seconds, then bows for two seconds", **FEW)
    assert clip.duration == pytest.approx(5.0, abs=0.4) and clip.notes == ()


def test_frames_are_shared_by_the_lengths_that_parts_ask_for(manifest: Manifest) -> None:
    own = [resolve_options(manifest, seconds=seconds) for seconds in (6, 2, 2)]
    shares = [part.frames for part in share_frames(100, own, manifest)]
    assert sum(shares) == 100 and shares[0] > shares[1] == shares[2] >= manifest.frames.min
    assert [part.frames for part in share_frames(200, own, manifest)] == [120, 40, 40]
    least = share_frames(3 * manifest.frames.min, own, manifest)
    assert [part.frames for part in least] == [manifest.frames.min] * 3


def test_seeds_of_parts_are_those_of_no_other_take() -> None:
    assert part_seed(7, 0) == 7
    seeds = {part_seed(seed, index) for seed in range(64) for index in range(32)}
    assert len(seeds) == 64 * 32
    assert 0 <= part_seed(2**63 - 1, 31) < 2**63


def test_graphs_without_words_of_the_parser_work_too(toy: MotionPipeline) -> None:
    graph = SemanticGraph(
        "a person walks but never waves",
        (Action("walks", 9, 14, 0), Action("waves", 25, 30, 1, negated=True)),
    )
    clip = toy.generate(graph, seconds=1, **FEW)
    assert clip.graph == graph
