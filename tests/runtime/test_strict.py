"""What a bundle was never shown, by what its user can see: clips that say so, `strict`, and the command line."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph import Concept, MotionPipeline, UnknownWordsError, cli
from kinegraph.bundle.reader import read_bundle
from kinegraph.bundle.vocabulary import FILE, pack_vocabulary, read_vocabulary, sentences_to_embed
from kinegraph.cli.arguments import SHOWN_ACTIONS
from kinegraph.cli.inspect import words_record, words_text
from kinegraph.clip import Clip
from kinegraph.denoising import LatentSampler
from kinegraph.errors import InvalidInputError
from kinegraph.formats import read
from kinegraph.unknown import Unknown
from support.cli_runs import fails
from support.motions import walk
from support.toy import TOY_BUNDLE, with_parser
from support.vocabularies import BagEncoder, graph_of, small_facts, small_vocabulary, vocabulary_file

FEW: dict[str, Any] = {"seconds": 2, "seed": 3, "steps": 2}
JUGGLES = "a person walks and juggles"


@pytest.fixture(scope="module")
def words_bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The toy bundle with a parser and a small vocabulary; its encoder has random weights and finds no paraphrases."""
    facts = small_facts(paraphrase=1.0, near=0.0)
    encoder = MotionPipeline.load(TOY_BUNDLE, threads=1).encoder
    data = pack_vocabulary(facts, encoder.embed(sentences_to_embed(facts)))
    return with_parser(tmp_path_factory.mktemp("words") / "bundle", {FILE: data})


@pytest.fixture(scope="module")
def words(words_bundle: Path) -> MotionPipeline:
    pytest.importorskip("spacy")
    return MotionPipeline.load(words_bundle, threads=1)


def texts(clip: Clip) -> list[str]:
    return [span.text for span in clip.unknown]


def test_a_clip_says_what_of_its_sentence_is_unknown(words: MotionPipeline) -> None:
    clip = words.generate(JUGGLES, **FEW)
    assert clip.unknown == words.find_unknown(JUGGLES) and texts(clip) == ["juggles"]
    assert clip.text[clip.unknown[0].start : clip.unknown[0].end] == "juggles"
    assert texts(words.generate("a person walks", **FEW)) == []
    assert texts(clip.in_place().resampled(30)) == ["juggles"]


def test_every_call_says_so(words: MotionPipeline) -> None:
    assert [texts(clip) for clip in words.takes(JUGGLES, 2, **FEW)] == [["juggles"]] * 2
    for shared in (False, True):
        clips = words.batch(["a person walks", JUGGLES], takes=2, shared_run=shared, **FEW)
        assert [texts(clip) for clip in clips] == [[], [], ["juggles"], ["juggles"]]
    clip = words.sequence(["a person walks", "she juggles", "he Juggles with a hat"], **FEW)
    assert texts(clip) == ["juggles", "Juggles with a hat"]
    assert texts(words.sequence(["she juggles", "he juggles"], **FEW)) == ["juggles"]
    concepts = [Concept("a person walks"), Concept("a person juggles"), Concept("a person sleeps", -1.0)]
    assert texts(words.compose(concepts, **FEW)) == ["juggles", "sleeps"]
    assert texts(words.compose(["a person walks"], text="a person snores", **FEW)) == ["snores"]


CALLS: dict[str, Callable[[MotionPipeline, str], object]] = {
    "generate": lambda pipe, text: pipe.generate(text, strict=True, **FEW),
    "takes": lambda pipe, text: pipe.takes(text, 2, strict=True, **FEW),
    "batch": lambda pipe, text: pipe.batch(["a person walks", text], strict=True, **FEW),
    "shared": lambda pipe, text: pipe.batch(["a person walks", text], shared_run=True, strict=True, **FEW),
    "sequence": lambda pipe, text: pipe.sequence(["a person walks", text], strict=True, **FEW),
    "compose": lambda pipe, text: pipe.compose(["a person walks", text], strict=True, **FEW),
    "negated": lambda pipe, text: pipe.compose([Concept("a person walks"), Concept(text, -1.0)], strict=True, **FEW),
}


@pytest.mark.parametrize("call", CALLS)
def test_strict_refuses_before_anything_is_sampled(
    words: MotionPipeline, call: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("sampled")

    monkeypatch.setattr(LatentSampler, "sample", refuse)
    with pytest.raises(UnknownWordsError, match=r"not known: 'juggles'.*info --words.*strict") as caught:
        CALLS[call](words, "a person juggles")
    assert isinstance(caught.value, InvalidInputError)
    assert [span.text for span in caught.value.unknown] == ["juggles"]


def test_strict_changes_nothing_of_what_is_known(words: MotionPipeline) -> None:
    free, strict = (words.generate("a person walks", strict=flag, **FEW) for flag in (False, True))
    assert free.joints.tobytes() == strict.joints.tobytes()


def test_strict_names_all_words_of_several_sentences(words: MotionPipeline) -> None:
    with pytest.raises(UnknownWordsError) as caught:
        words.batch(["a person juggles", "a person walks", "a person sneezes"], strict=True)
    assert [span.text for span in caught.value.unknown] == ["juggles", "sneezes"]


def test_a_graph_of_the_caller_needs_no_parser(words: MotionPipeline) -> None:
    width = words.manifest.text.width
    plain = MotionPipeline.load(TOY_BUNDLE, threads=1)
    encoder, vocabulary = plain.encoder, read_vocabulary(vocabulary_file(width), width)
    pipe = MotionPipeline(plain.manifest, encoder.sessions, encoder.tokenizer, encoder.tables, plain.parser, vocabulary)
    with pytest.raises(UnknownWordsError, match="juggles"):
        pipe.generate(graph_of(JUGGLES, "walks", "juggles"), strict=True, **FEW)
    assert pipe.generate(graph_of("a person walks", "walks"), strict=True, **FEW).unknown == ()


def test_without_a_vocabulary_nothing_is_told_and_strict_says_why(toy: MotionPipeline) -> None:
    graph = graph_of(JUGGLES, "walks", "juggles")
    assert toy.generate(graph, **FEW).unknown == ()
    with pytest.raises(InvalidInputError, match=r"no vocabulary\.npz.*leave out strict") as caught:
        toy.generate(graph, strict=True, **FEW)
    assert not isinstance(caught.value, UnknownWordsError)


# Clips and files


@pytest.mark.parametrize("suffix", [".npz", ".json"])
def test_files_keep_unknown_words_and_notes(here: Path, suffix: str) -> None:
    unknown = (Unknown("jüggles", 9, 16, ("bows", "runs")), Unknown("two men", 0, 7, (), "people"))
    clip = Clip(walk(4), 20.0, 1, "x", "toy 1", unknown=unknown, notes=("“twice” is not counted", "二"))
    clip.save(f"told{suffix}")
    found = read(f"told{suffix}")
    assert (found.unknown, found.notes) == (unknown, clip.notes)
    Clip(walk(4), 20.0, 1, "x", "toy 1").save(f"plain{suffix}")
    assert (read(f"plain{suffix}").unknown, read(f"plain{suffix}").notes) == ((), ())


def test_json_of_older_versions_has_neither(here: Path) -> None:
    Clip(walk(4), 20.0, 1, "x", "toy 1").save("clip.json")
    record = json.loads(Path("clip.json").read_text(encoding="utf-8"))
    for name in ("unknown", "notes"):
        assert record.pop(name) == []
    Path("old.json").write_text(json.dumps(record), encoding="utf-8")
    assert (read("old.json").unknown, read("old.json").notes) == ((), ())
    for broken in ({"unknown": 5}, {"unknown": [{}]}, {"notes": "x"}, {"notes": [1]}):
        Path("bad.json").write_text(json.dumps({**record, **broken}), encoding="utf-8")
        with pytest.raises(InvalidInputError, match=r"bad\.json"):
            read("bad.json")


@pytest.mark.parametrize(
    "fields",
    [{"unknown": ["juggles"]}, {"unknown": ("juggles",)}, {"notes": "x"}, {"notes": ["x"]}, {"notes": ("\ud800",)},
     {"notes": (1,)}],
)  # fmt: skip
def test_a_clip_refuses_what_is_no_unknown_word_or_note(fields: dict[str, Any]) -> None:
    with pytest.raises(InvalidInputError, match=r"unknown is|notes"):
        Clip(walk(3), 20.0, 1, "x", "b", **fields)


# The command line

FLAGS = ("--seconds", "2", "--seed", "3", "--steps", "2", "--threads", "1")


@pytest.mark.parametrize(
    "command", [["generate", JUGGLES], ["compose", "--and", "a person walks", "--not", "a person juggles"],
                ["sequence", "a person walks", "she juggles"]],
)  # fmt: skip
def test_the_command_line_tells_in_one_line_or_refuses(
    here: Path, words_bundle: Path, capsys: pytest.CaptureFixture[str], command: list[str]
) -> None:
    pytest.importorskip("spacy")
    arguments = [*command, *FLAGS, "--bundle", str(words_bundle), "-o", "clip.npz"]
    assert "not known: 'juggles'; nearest: '" in fails(capsys, *arguments, "--strict")
    assert list(here.iterdir()) == []
    assert cli.main(arguments) == 0
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and told.startswith("kinegraph: not known: 'juggles'; nearest: '")
    assert cli.main([*arguments, "--force", "--json", "--takes", "2"]) == 0
    captured = capsys.readouterr()
    assert captured.err == told
    for line in captured.out.splitlines():
        record = json.loads(line)
        assert [span["text"] for span in record["unknown"]] == ["juggles"] and isinstance(record["notes"], list)
    assert cli.main([*arguments, "--force", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert texts(read("clip.npz")) == ["juggles"]


def test_known_sentences_print_nothing_on_stderr(
    here: Path, words_bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("spacy")
    arguments = ["generate", "a person walks", *FLAGS, "--bundle", str(words_bundle), "-o", "clip.npz", "--strict"]
    assert cli.main(arguments) == 0
    assert capsys.readouterr().err == ""


def test_a_clip_tells_what_is_known_and_seldom_comes_out(tmp_path: Path, here: Path, capsys: Any) -> None:
    pytest.importorskip("spacy")
    facts = small_facts(paraphrase=1.0, near=0.0)
    phrases = [replace(phrase, recognised=0.1 if phrase.name == "wave" else 0.9) for phrase in facts.phrases]
    facts = replace(facts, phrases=tuple(phrases))
    embedded = MotionPipeline.load(TOY_BUNDLE, threads=1).encoder.embed(sentences_to_embed(facts))
    folder = with_parser(tmp_path / "bundle", {FILE: pack_vocabulary(facts, embedded)})
    pipe = MotionPipeline.load(folder, threads=1)
    waving, walking = "a person waves with the right hand", "a person walks"
    (note,) = pipe.generate(waving, **FEW).notes
    assert note == "'waves with the right hand' seldom comes out as asked: it is recognised in 10% of its clips"
    assert pipe.generate(walking, **FEW).notes == ()
    assert pipe.sequence([walking, waving], **FEW).notes == (note,)
    assert note in pipe.compose([waving, walking], **FEW).notes
    assert [clip.notes for clip in pipe.batch([walking, waving], **FEW)] == [(), (note,)]
    assert cli.main(["generate", waving, *FLAGS, "--bundle", str(folder), "-o", "clip.npz"]) == 0
    assert "seldom comes out as asked" in capsys.readouterr().err


def test_info_lists_what_is_known(words_bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["info", "--words", "--bundle", str(words_bundle)]) == 0
    text = capsys.readouterr().out
    assert text.startswith("toy 1 was shown these") and re.search(r"wave +4  a person waves\n", text)
    assert text.index("actions:") < text.index("a person walks\n") < text.index("styles:") < text.index("like a giant")
    assert cli.main(["info", "--words", "--json", "--bundle", str(words_bundle)]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["styles"] == [
        {
            "name": "giant",
            "example": "a person walks like a giant",
            "clips": 3,
            "recognised": None,
            "wordings": ["like a giant"],
        }
    ]
    assert [phrase["name"] for phrase in record["actions"]] == ["walk", "raise-left", "raise-right", "wave"]


def test_info_lists_how_often_actions_are_recognised_where_that_was_measured() -> None:
    facts = small_facts()
    phrases = [replace(phrase, recognised=0.25 if phrase.name == "wave" else None) for phrase in facts.phrases]
    known = replace(small_vocabulary(BagEncoder()), facts=replace(facts, phrases=tuple(phrases)))
    text = words_text(words_record(replace(read_bundle(), vocabulary=known)))
    assert "share of its own clips in which it is recognised among 32 actions" in text
    assert re.search(r"wave +4  0\.25  a person waves\n", text) and re.search(
        r"walk +\d+     -  a person walks\n", text
    )


def test_info_of_a_bundle_without_a_vocabulary_says_so(bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["info", "--words", "--bundle", str(bundle)]) == 0
    assert "does not know what it was shown" in capsys.readouterr().out
    assert cli.main(["info", "--words", "--json", "--bundle", str(bundle)]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["actions"] is None and record["styles"] is None


def test_the_help_of_generate_lists_what_the_default_bundle_knows(capsys: pytest.CaptureFixture[str]) -> None:
    known = read_bundle().vocabulary
    assert known is not None
    start = time.process_time()
    with pytest.raises(SystemExit):
        cli.main(["generate", "--help"])
    assert time.process_time() - start < 1.0  # no model is opened
    shown = " ".join(capsys.readouterr().out.split())
    actions, styles = (
        [phrase.wordings[0] for phrase in known.facts.phrases if phrase.kind == kind] for kind in ("action", "style")
    )
    assert f"knows {len(actions)} actions" in shown
    assert f" {', '.join(actions[:SHOWN_ACTIONS])}" in shown
    assert f" {', '.join(styles)}" in shown


@pytest.mark.parametrize(
    ("written", "read", "told"),
    [
        ("a person rusn", "a person runs", ("'rusn' is read as 'runs'",)),
        ("a person wlaks forward", "a person walks forward", ("'wlaks' is read as 'walks'",)),
        ("a person tunrs lefft", "a person turns left", ("'tunrs' is read as 'turns'", "'lefft' is read as 'left'")),
        ("a person walks forward", "a person walks forward", ()),
        ("a person walks with Kate", "a person walks with Kate", ()),  # a name is no slip
    ],
)
def test_a_slip_of_spelling_is_made_as_it_is_read_and_told(
    pipe: MotionPipeline, written: str, read: str, told: tuple[str, ...]
) -> None:
    clip = pipe.generate(written, **FEW)
    assert [note for note in clip.notes if "is read as" in note] == list(told) and clip.text == written
    np.testing.assert_array_equal(clip.joints, pipe.generate(read, **FEW).joints)
    composed = pipe.compose([written, "a person bows"], **FEW)
    assert [note for note in composed.notes if "is read as" in note] == list(told)
    np.testing.assert_array_equal(composed.joints, pipe.compose([read, "a person bows"], **FEW).joints)
