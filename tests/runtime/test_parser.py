"""Captions to graphs: an example of each edge type, exact offsets, and a graph or a typed error for any text."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinegraph.bundle.reader import text_files_folder
from kinegraph.errors import InvalidInputError
from kinegraph.graph import SemanticGraph
from kinegraph.limits import MAX_NODES, MAX_TEXT
from support.shared import shared_path

pytest.importorskip("spacy")

from kinegraph.errors import BundleFormatError
from kinegraph.text.parser import GraphParser

FILE = text_files_folder() / "parser.bin"


@pytest.fixture(scope="module")
def parser() -> GraphParser:
    return GraphParser(FILE.read_bytes())


def edges(graph: SemanticGraph) -> set[tuple[str, str, str]]:
    """List (action, role, words) of each argument."""
    return {(action.text, part.role, part.text) for action in graph.actions for part in action.arguments}


@pytest.mark.parametrize(
    ("caption", "action", "role", "words"),
    [
        ("a person walks forward", "walks", "ARG0", "a person"),
        ("waving both hands", "waving", "ARG1", "both hands"),
        ("a man gives a ball to the woman", "gives", "ARG2", "to the woman"),
        ("a person returns from the door to the wall", "returns", "ARG3", "from the door"),
        ("a person returns from the door to the wall", "returns", "ARG4", "to the wall"),
        ("someone walks in the park", "walks", "ARGM-LOC", "in the park"),
        ("a person walks slowly", "walks", "ARGM-MNR", "slowly"),
        ("a person turns left after a few steps", "turns", "ARGM-TMP", "after a few steps"),
        ("a person walks to the left", "walks", "ARGM-DIR", "to the left"),
        ("turn left without moving the hands", "turn", "ARGM-DIR", "left"),
        ("the man left without his bag", "left", "ARGM-MNR", "without his bag"),
        ("a person jumps if someone claps", "jumps", "ARGM-ADV", "if someone claps"),
        ("a person does not run", "run", "OTHERS", "not"),
        ("the person is pushed by a man", "pushed", "ARG1", "the person"),
        ("the person is pushed by a man", "pushed", "ARG0", "by a man"),
    ],
)
def test_each_edge_type_has_its_words(parser: GraphParser, caption: str, action: str, role: str, words: str) -> None:
    assert (action, role, words) in edges(parser.parse(caption))


@pytest.mark.parametrize(
    ("caption", "actions"),
    [
        ("walk to the left then run, jump and stop", ["walk", "run", "jump", "stop"]),
        ("a person walks forward, then turns left and runs back", ["walks", "turns", "runs"]),
        ("The person who bows walks away", ["bows", "walks"]),
        ("a person walks; another person runs", ["walks", "runs"]),
        ("a person is walking", ["walking"]),
    ],
)
def test_actions_are_found_in_the_order_of_the_sentence(parser: GraphParser, caption: str, actions: list[str]) -> None:
    graph = parser.parse(caption)
    assert [action.text for action in graph.actions] == actions
    assert [action.order for action in graph.actions] == list(range(len(actions)))


@pytest.mark.parametrize("verb", ["turn", "a person slowly turns", "he walked", "jumping"])
@pytest.mark.parametrize("rest", ["", "without waving", "like a robot", "two steps", "a bit", "twice", "into a room"])
def test_left_is_read_as_right_is(parser: GraphParser, verb: str, rest: str) -> None:
    left, right = (
        {(action, role, words.replace(side, "...")) for action, role, words in edges(parser.parse(caption))}
        for side in ("left", "right")
        for caption in [f"{verb} {side} {rest}".rstrip()]
    )
    assert left == right and any(words.startswith("...") for _, _, words in left)


def test_a_shared_subject_belongs_to_every_action(parser: GraphParser) -> None:
    graph = parser.parse("The person who bows walks away and turns around")
    for action in graph.actions:
        assert "The person" in [part.text for part in action.arguments], action.text


@pytest.mark.parametrize("caption", ["a slow walk", "jumping jacks", "left", "42", "the quick brown fox", "走"])
def test_a_caption_without_a_verb_still_has_an_action(parser: GraphParser, caption: str) -> None:
    assert parser.parse(caption).actions


@pytest.mark.parametrize(
    ("caption", "actions"),
    [
        ("a person walks and waves", ["walks", "waves"]),
        ("A human walks and turns to the right", ["walks", "turns"]),
        ("The man walks, runs, hops and skips.", ["walks", "runs", "hops", "skips"]),
        ("a person sitting on a chair waves", ["sitting", "waves"]),
        ("someone makes jumps and kicks", ["makes"]),
        ("two quick punches with the right fist", ["punches"]),
        ("A person gets pushed from the left", ["gets", "pushed"]),
        ("A kneeling person is standing up.", ["kneeling", "standing"]),
        ("a person does not move", ["move"]),
    ],
)
def test_verbs_that_look_like_nouns_are_actions(parser: GraphParser, caption: str, actions: list[str]) -> None:
    assert [action.text for action in parser.parse(caption).actions] == actions


def test_spelling_slips_are_corrected_and_keep_their_offsets(parser: GraphParser) -> None:
    caption = "a persn wlaks slowy to the rigth"
    graph = parser.parse(caption)
    check_offsets(caption, graph)
    assert edges(graph) == {
        ("wlaks", "ARG0", "a persn"), ("wlaks", "ARGM-MNR", "slowy"), ("wlaks", "ARGM-DIR", "to the rigth")
    }  # fmt: skip


def test_an_object_after_two_verbs_belongs_to_both(parser: GraphParser) -> None:
    graph = parser.parse("a person raises and lowers the left arm")
    assert {("raises", "ARG1", "the left arm"), ("lowers", "ARG1", "the left arm")} <= edges(graph)


def check_offsets(caption: str, graph: SemanticGraph) -> None:
    assert graph.caption == caption
    assert graph.actions
    for action in graph.actions:
        assert caption[action.start : action.end] == action.text != ""
        for part in action.arguments:
            assert caption[part.start : part.end] == part.text
            assert part.text == part.text.strip() != ""


def test_offsets_are_exact_in_real_captions(parser: GraphParser) -> None:
    path = shared_path("data", "bandai", "captions.jsonl")
    rows = path.read_text(encoding="utf-8").splitlines()[::13]
    captions = [json.loads(row)["captions"][0] for row in rows]
    assert len(captions) > 200
    for caption in captions:
        check_offsets(caption, parser.parse(caption))


def test_white_space_and_control_characters_shift_no_offset(parser: GraphParser) -> None:
    caption = "  a\tperson \x00 walks\u00a0 \n slowly \u200b to the  left "
    graph = parser.parse(caption)
    check_offsets(caption, graph)
    assert [action.text for action in graph.actions] == ["walks"]


@settings(max_examples=150, deadline=None)
@given(st.text(max_size=60))
def test_any_text_gives_a_graph_or_a_typed_error(parser: GraphParser, text: str) -> None:
    try:
        graph = parser.parse(text)
    except InvalidInputError:
        surrogate = any("\ud800" <= char <= "\udfff" for char in text)
        assert surrogate or not any(char.isalnum() for char in text)
    else:
        check_offsets(text, graph)


CLAUSES = (
    "a person walks", "and", "then", "who runs", "while waving", "the left hand", ",", "to jump", "because they fall",
    "that is", "slowly", "not", "if", "turning left", "people say", "with", "is seen", "starts to", "90 degrees", ";",
)  # fmt: skip


@settings(max_examples=120, deadline=None)
@given(st.lists(st.sampled_from(CLAUSES), min_size=1, max_size=25))
def test_run_on_sentences_end(parser: GraphParser, parts: list[str]) -> None:
    # Regression: the search for a subject went back and forth between two clauses without end.
    caption = " ".join(parts)[:MAX_TEXT]
    if not any(char.isalnum() for char in caption):
        return
    graph = parser.parse(caption)
    check_offsets(caption, graph)
    assert graph.node_count <= MAX_NODES
    assert parser.parse(caption) == graph


def test_the_longest_caption_has_no_more_nodes_than_the_model_takes(parser: GraphParser) -> None:
    caption = ("jump and run and walk slowly to the left " * 20)[:MAX_TEXT]
    graph = parser.parse(caption)
    check_offsets(caption, graph)
    assert graph.node_count <= MAX_NODES


@pytest.mark.parametrize("wrong", ["", "  \n", "…!?", "a" * (MAX_TEXT + 1), "\udcff walks", None, 5, b"a person walks"])
def test_invalid_captions_are_refused(parser: GraphParser, wrong: object) -> None:
    with pytest.raises(InvalidInputError):
        parser.parse(wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("wrong", [b"", b"nonsense", b"\x80" * 50])
def test_bytes_without_a_pipeline_are_refused(wrong: bytes) -> None:
    with pytest.raises(BundleFormatError):
        GraphParser(wrong)


def test_the_background_import_loads_spacy() -> None:
    # Regression: a linter once removed the import inside the thread, and nobody noticed.
    code = (
        "import sys, threading\n"
        "from kinegraph.text.dependency import import_in_background\n"
        "assert 'spacy' not in sys.modules\n"
        "import_in_background()\n"
        "[thread.join() for thread in threading.enumerate() if thread is not threading.current_thread()]\n"
        "assert 'spacy.lang.en' in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_agreement_with_the_released_graphs_does_not_fall(parser: GraphParser, tmp_path: Path) -> None:
    # Rules alone, all captions; `kinegraph_benchmarks.quality.parser_accuracy` measures the argument classifier, too.
    gold = shared_path("graphs", "kit_gold_dev.jsonl")
    captions = {json.loads(line)["caption"] for line in gold.read_text(encoding="utf-8").splitlines()}
    predicted = tmp_path / "predicted.jsonl"
    rows = [parser.parse(caption).to_json() for caption in sorted(captions)]
    predicted.write_text("\n".join(rows) + "\n", encoding="utf-8")
    scorer = [sys.executable, str(gold.with_name("score_graphs.py")), str(gold), str(predicted), "--json", "-"]
    report = json.loads(subprocess.run(scorer, capture_output=True, check=True, text=True).stdout)["all"]
    assert report["action"]["f1"] >= 0.94
    assert report["argument_exact"]["f1"] >= 0.80
    assert report["labeled_exact"]["f1"] >= 0.67
