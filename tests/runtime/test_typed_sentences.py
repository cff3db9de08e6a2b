"""What people type: orders, lists, steps, capitals, requests, unusual subjects, phrases without a verb, negations."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from kinegraph.bundle.reader import text_files_folder
from kinegraph.graph import SemanticGraph
from support.shared import shared_path

pytest.importorskip("spacy")

from kinegraph.text.caption_tokens import UNUSUAL, CaptionToken, caption_tokens
from kinegraph.text.dependency import clean, load_pipeline
from kinegraph.text.parser import GraphParser, read_parser

BUNDLE = text_files_folder()
DEV = Path(__file__).parents[2] / "benchmarks" / "parser" / "hard_sentences_2_dev.jsonl"


@pytest.fixture(scope="module")
def parser() -> GraphParser:
    return read_parser(BUNDLE)


def told(graph: SemanticGraph) -> list[str]:
    """List the actions; those that are negated with "not " before."""
    return [("not " if action.negated else "") + action.text for action in graph.actions]


def arguments(graph: SemanticGraph, action: int) -> dict[str, str]:
    return {argument.text: argument.role for argument in graph.actions[action].arguments}


@pytest.mark.parametrize(
    ("caption", "actions"),
    [
        ("walk to the left, then crouch", ["walk", "crouch"]),
        ("wave and walk", ["wave", "walk"]),
        ("walk, wave, bow", ["walk", "wave", "bow"]),
        ("WALK FORWARD AND WAVE THE RIGHT HAND", ["WALK", "WAVE"]),
        ("squat; stretch; run", ["squat", "stretch", "run"]),
        ("climb/crawl/dive", ["climb", "crawl", "dive"]),
        ("hop & kneel", ["hop", "kneel"]),
        ("a girl skips + bows", ["skips", "bows"]),
        ("crouch -> roll -> sprint", ["crouch", "roll", "sprint"]),
        ("Please lift the box, carry it away and applaud", ["lift", "carry", "applaud"]),
        ("go left go right", ["go", "go"]),
        ("march two steps turn and salute", ["march", "turn", "salute"]),
        ("pick up box, put box down", ["pick", "put"]),
        ("slowly turn around, then limp", ["turn", "limp"]),
        ("jogging, then stoping", ["jogging", "stoping"]),
        ("a boy grabs a rope, swings, falls", ["grabs", "swings", "falls"]),
        ("rotate the left arm & the right arm", ["rotate"]),
        ("kneels down, crawls", ["kneels", "crawls"]),
    ],
)
def test_every_verb_of_orders_and_lists_is_an_action(parser: GraphParser, caption: str, actions: list[str]) -> None:
    assert told(parser.parse(caption)) == actions


@pytest.mark.parametrize(
    "caption",
    [
        "1. squat 2. leap forward 3. clap",
        "1) squat\n2) leap forward\n3) clap",
        "(1) squat (2) leap forward (3) clap",
        "a) squat b) leap forward c) clap",
        "Step 1: squat. Step 2: leap forward. Step 3: clap.",
        "step one: squat, step two: leap forward, step three: clap",
        "1 - squat, 2 - leap forward, 3 - clap",
        "1.squat 2.leap forward 3.clap",
        "- squat\n- leap forward\n- clap",
        "• squat • leap forward • clap",
        "first: squat; second: leap forward; third: clap",
        "squat\nleap forward\nclap",
        "i) squat ii) leap forward iii) clap",
    ],
)
def test_numbers_and_bullets_of_steps_are_no_words(parser: GraphParser, caption: str) -> None:
    graph = parser.parse(caption)
    assert told(graph) == ["squat", "leap", "clap"]
    ordinals = {"first": "ARGM-TMP", "second": "ARGM-TMP", "third": "ARGM-TMP"}
    assert set(arguments(graph, 0)) <= set(ordinals)
    assert {text: role for text, role in arguments(graph, 1).items() if text not in ordinals} == {"forward": "ARGM-DIR"}


def test_a_number_that_counts_something_stays(parser: GraphParser) -> None:
    assert "2 steps" in arguments(parser.parse("walk 2 steps. turn"), 0)
    assert "3 second" in arguments(parser.parse("a 3 second walk"), 0)


def test_a_subject_is_shared_by_steps_that_lack_one(parser: GraphParser) -> None:
    graph = parser.parse("1. a woman stretches 2. kneels down")
    assert [arguments(graph, action)["a woman"] for action in (0, 1)] == ["ARG0", "ARG1"]


@pytest.mark.parametrize(
    ("caption", "action", "subject"),
    [
        ("can you make him jump?", "jump", "him"),
        ("could you please let her sit down", "sit", "her"),
        ("show me a girl skipping", "skipping", "a girl"),
        ("i want a man who kneels", "kneels", "a man"),
        ("I'd like to see somebody crawl", "crawl", "somebody"),
        ("make the robot dance", "dance", "the robot"),
        ("would the lady bow", "bow", "the lady"),
        ("how does a sick dog walk?", "walk", "a sick dog"),
        ("an animation of a wizard casting a spell", "casting", "a wizard"),
        ("generate a person doing yoga", "doing", "a person"),
        ("please have them run", "run", "them"),
        ("create a jump", "jump", None),
        ("can you spin around?", "spin", None),
        ("let's dance", "dance", None),
        ("make a step to the left", "make", None),
        ("show the left hand", "show", None),
    ],
)
def test_the_wording_of_a_request_is_left_out(
    parser: GraphParser, caption: str, action: str, subject: str | None
) -> None:
    graph = parser.parse(caption)
    assert told(graph) == [action]
    subjects = [text for text, role in arguments(graph, 0).items() if role in ("ARG0", "ARG1")]
    assert subject is None or subject in subjects


@pytest.mark.parametrize(
    ("caption", "action", "subject"),
    [
        ("a zombie walks", "walks", "a zombie"),
        ("a person's left hand waves", "waves", "a person's left hand"),
        ("the wizard's arms shake", "shake", "the wizard's arms"),
        ("my avatar limps home", "limps", "my avatar"),
        ("a vampire creeps towards the door", "creeps", "a vampire"),
        ("Santa salutes", "salutes", "Santa"),
        ("one of his legs trembles", "trembles", "one of his legs"),
        ("granny hobbles with a stick", "hobbles", "granny"),
        ("a ninja sneaking", "sneaking", "a ninja"),
    ],
)
def test_unusual_subjects(parser: GraphParser, caption: str, action: str, subject: str) -> None:
    graph = parser.parse(caption)
    assert told(graph) == [action]
    assert arguments(graph, 0)[subject] in ("ARG0", "ARG1")


@pytest.mark.parametrize(
    "word",
    [
        "counter-clockwise",
        "counterclockwise",
        "counter clockwise",
        "anti-clockwise",
        "anticlockwise",
        "Counter‑Clockwise",
    ],
)
def test_counter_clockwise_is_one_word(parser: GraphParser, word: str) -> None:
    for caption in (f"a person turns {word}", f"she runs {word} around the pole"):
        graph = parser.parse(caption)
        assert arguments(graph, 0)[word] in ("ARGM-MNR", "ARGM-DIR") and len(graph.actions) == 1


@pytest.mark.parametrize(
    ("caption", "actions", "held"),
    [
        ("left hand up", ["up"], {"left hand": "ARG1"}),
        ("arms out to the sides", ["out"], {"arms": "ARG1", "to the sides": "ARGM-DIR"}),
        ("hands behind the head", ["behind"], {"hands": "ARG1", "the head": "ARG2"}),
        ("on both knees", ["on"], {"both knees": "ARG1"}),
        ("chin up, elbows out", ["up", "out"], {"chin": "ARG1"}),
        ("left leg forward and right leg back", ["forward", "back"], {"left leg": "ARG1"}),
        ("a slow jog", ["jog"], {"slow": "ARGM-MNR"}),
        ("a hop and a skip", ["hop", "skip"], {}),
    ],
)
def test_phrases_without_a_verb(parser: GraphParser, caption: str, actions: list[str], held: dict[str, str]) -> None:
    graph = parser.parse(caption)
    assert told(graph) == actions
    assert held.items() <= arguments(graph, 0).items()


def test_how_parts_of_the_body_are_held_is_one_argument(parser: GraphParser) -> None:
    for phrase in ("with both hands up", "w/ both hands up", "with raised arms", "w one arm down"):
        assert arguments(parser.parse(f"a man walks on a line {phrase}"), 0)[phrase] == "ARGM-MNR"


@pytest.mark.parametrize(
    ("caption", "actions"),
    [
        ("a person walks forward without waving the hands", ["walks", "not waving"]),
        ("a person walks forward but does not wave the right hand", ["walks", "not wave"]),
        ("a person walks without turning left", ["walks", "not turning"]),
        ("a person does not walk", ["not walk"]),
        ("don't kneel", ["not kneel"]),
        ("the boy didn't jump", ["not jump"]),
        ("she isn't dancing", ["not dancing"]),
        ("someone crouches, not raising the head", ["crouches", "not raising"]),
        ("he leaves and never turns around", ["leaves", "not turns"]),
        ("run, no jumping", ["run", "not jumping"]),
        ("march with no arm swing", ["march", "not swing"]),
        ("walk, no jumps", ["walk", "not jumps"]),
        ("a girl dances while keeping her arms down", ["dances", "not keeping"]),
        ("hold both hands down and bow", ["not hold", "bow"]),
        ("he limps and then stops limping", ["limps", "stops", "not limping"]),
        ("quit spinning", ["quit", "not spinning"]),
        ("crawl instead of walking", ["crawl", "not walking"]),
        ("she hops rather than walks", ["hops", "not walks"]),
        ("walk without turning or waving", ["walk", "not turning", "not waving"]),
        ("he neither runs nor jumps", ["not runs", "not jumps"]),
        ("he walks without waving and then bows", ["walks", "not waving", "bows"]),
        ("don't run, walk", ["not run", "walk"]),
        ("he does not stop walking", ["not stop", "walking"]),
    ],
)
def test_what_must_not_happen_is_negated(parser: GraphParser, caption: str, actions: list[str]) -> None:
    assert told(parser.parse(caption)) == actions


@pytest.mark.parametrize(
    "caption",
    [
        "a person does not move",
        "the man stands without moving",
        "don't move",
        "a person stays still",
        "she stands still",
        "he walks, then stops",
        "the girl stops and waves",
        "they do not look confident",
        "a man waves without any particular style",
        "he keeps his head down",
        "he not only walks but also waves",
        "a man makes a 'no' gesture",
        "nobody walks without a stick",
        "he is pushed but keeps his balance",
    ],
)
def test_standing_still_endings_and_states_are_not_negated(parser: GraphParser, caption: str) -> None:
    assert not any(action.negated for action in parser.parse(caption).actions)


def test_the_negating_word_is_an_argument_of_no_other_action(parser: GraphParser) -> None:
    graph = parser.parse("a person walks but does not turn")
    assert arguments(graph, 1)["not"] == "OTHERS"
    assert "not" not in " ".join(arguments(graph, 0))


def test_captions_that_are_read_as_spacy_cuts_them_lose_nothing() -> None:
    # A quick look tells plain captions; in those, nothing may be left to split, join or leave out.
    pipeline = load_pipeline((BUNDLE / "parser.bin").read_bytes())
    known = DEV.parents[1] / "data" / "known_sentences.jsonl"
    lines = [line for path in (DEV, known) for line in path.read_text(encoding="utf-8").splitlines()]
    captions = {row.get("caption") or row["text"] for row in map(json.loads, lines)}
    plain = [caption for caption in captions if not UNUSUAL.search(caption)]
    assert len(plain) > 400
    for caption in plain:
        written = pipeline.make_doc(clean(caption))
        tokens = [CaptionToken(t.text, t.idx, t.idx + len(t), bool(t.whitespace_)) for t in written]
        assert caption_tokens(written, caption) == tokens, caption


def test_development_sentences_are_parsed_as_a_reader_does(parser: GraphParser, tmp_path: Path) -> None:
    rows = [json.loads(line) for line in DEV.read_text(encoding="utf-8").splitlines()]
    graphs = [parser.parse(row["caption"]) for row in rows]
    predicted = tmp_path / "predicted.jsonl"
    predicted.write_text("\n".join(graph.to_json() for graph in graphs) + "\n", encoding="utf-8")
    scorer = [sys.executable, str(shared_path("graphs", "score_graphs.py")), str(DEV), str(predicted), "--json", "-"]
    report = json.loads(subprocess.run(scorer, capture_output=True, check=True, text=True).stdout)["all"]
    assert report["action"]["f1"] >= 0.98
    assert report["labeled_exact"]["f1"] >= 0.97


def test_development_sentences_keep_their_actions_and_negations(parser: GraphParser) -> None:
    rows = [json.loads(line) for line in DEV.read_text(encoding="utf-8").splitlines()]
    graphs = [parser.parse(row["caption"]) for row in rows]
    pairs = [
        ({(a["start"], a["end"]) for a in row["actions"]}, {(a.start, a.end) for a in graph.actions})
        for row, graph in zip(rows, graphs, strict=True)
    ]
    hits = sum(len(gold & ours) for gold, ours in pairs)
    assert 2 * hits / sum(len(gold) + len(ours) for gold, ours in pairs) >= 0.98
    for row, graph in zip(rows, graphs, strict=True):
        negated = {(action["start"], action["end"]) for action in row["actions"] if action.get("negated")}
        assert {(action.start, action.end) for action in graph.actions if action.negated} == negated, row["caption"]
