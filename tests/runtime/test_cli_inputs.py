"""Input of the command line: invalid input gives one line on stderr, exit code 2 and no file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from kinegraph import MotionPipeline, cli
from support.cli_runs import Parser, fails, not_loaded, whole

pytestmark = pytest.mark.usefixtures("toy_by_default")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "required: COMMAND"),
        (["fly"], "invalid choice"),
        (["generate", "a person walks"], "-o/--output"),
        (["generate", "a person walks", "-o", "x.npz", "--seconds", "four"], "--seconds"),
        (["generate", "a person walks", "-o", "x.npz", "--seed", "1.5"], "--seed"),
        (["generate", "a person walks", "-o", "x.npz", "--steps", "15,x"], "15,x"),
        (["generate", "a person walks", "-o", "x.npz", "--guidance", "big"], "big"),
        (["generate", "a person walks", "-o", "x.npz", "--threads", "two"], "--threads"),
        (["parse", "a person walks", "--faster"], "--faster"),
    ],
)
def test_wrong_usage(capsys: pytest.CaptureFixture[str], here: Path, arguments: list[str], message: str) -> None:
    with pytest.raises(SystemExit) as end:
        cli.main(arguments)
    assert end.value.code == 2
    assert message in capsys.readouterr().err
    assert list(here.iterdir()) == []


@pytest.mark.parametrize("target", ["missing/x.npz", ".", "x.mp3", "x", "/dev/null/x.npz"])
def test_a_target_that_cannot_be_written_is_refused_before_anything_is_loaded(
    capsys: pytest.CaptureFixture[str], here: Path, monkeypatch: pytest.MonkeyPatch, target: str
) -> None:
    monkeypatch.setattr(MotionPipeline, "load", not_loaded)
    fails(capsys, "generate", "a person walks", "-o", target)
    assert list(here.iterdir()) == []


def test_a_file_is_not_overwritten_unasked(
    capsys: pytest.CaptureFixture[str], here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(MotionPipeline, "load", not_loaded)
    (here / "x.npz").write_bytes(b"precious")
    assert "x.npz" in fails(capsys, "generate", "a person walks", "-o", "x.npz")
    assert (here / "x.npz").read_bytes() == b"precious"


@pytest.mark.parametrize("arguments", [[], ["a person walks", "--graph", "g.json"]])
def test_a_sentence_or_a_graph(
    capsys: pytest.CaptureFixture[str], here: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str]
) -> None:
    monkeypatch.setattr(MotionPipeline, "load", not_loaded)
    assert "either a sentence or --graph" in fails(capsys, "generate", *arguments, "-o", "x.npz")
    assert list(here.iterdir()) == []


GRAPHS = {
    "empty": b"",
    "no json": b"a person walks",
    "no object": b"[]",
    "not utf-8": b'{"caption": "\xff", "actions": []}',
    "unknown key": b'{"caption": "a person walks", "actions": [], "speed": 1}',
    "a bad offset": b'{"caption": "a b", "actions": [{"text": "b", "start": 0, "end": 1, "arguments": []}]}',
    "deep": b"[" * 100_000,
    "large": b" " * (1 << 20) + b"{}",
}


@pytest.mark.parametrize("kind", GRAPHS)
def test_a_broken_graph_is_named(
    capsys: pytest.CaptureFixture[str], here: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setattr(MotionPipeline, "load", not_loaded)
    (here / "g.json").write_bytes(GRAPHS[kind])
    assert "g.json" in fails(capsys, "generate", "--graph", "g.json", "-o", "x.npz")
    assert [path.name for path in here.iterdir()] == ["g.json"]


@pytest.mark.parametrize("name", ["missing.json", ".", "a\0b", "x" * 5000])
def test_a_graph_that_is_no_file(
    capsys: pytest.CaptureFixture[str], here: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr(MotionPipeline, "load", not_loaded)
    fails(capsys, "generate", "--graph", name, "-o", "x.npz")
    assert list(here.iterdir()) == []


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"a person walks\n\na person runs\n", "line 2: empty"),
        (b'a person walks\n{"caption": 3}\n', "line 2: the object needs"),
        (b'{"text": "a person walks"}\n', "line 1: the object needs"),
        (b'a\nb\n{"caption": "x"\n', "line 3: not valid JSON"),
        (b"{" + b'"a":{' * 50_000, "line 1: not valid JSON"),
        (b"a\xffb\n", "not UTF-8"),
        (b"", "line 1: empty"),
    ],
)
def test_a_bad_line_is_named_before_anything_is_loaded(
    capsys: pytest.CaptureFixture[str],
    here: Path,
    monkeypatch: pytest.MonkeyPatch,
    content: bytes,
    message: str,
) -> None:
    monkeypatch.setattr(MotionPipeline, "load", not_loaded)
    (here / "captions.jsonl").write_bytes(content)
    assert message in fails(capsys, "parse", "--jsonl", "captions.jsonl")


def test_a_line_that_does_not_parse_is_named(
    capsys: pytest.CaptureFixture[str], here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(MotionPipeline, "load", lambda *_, **__: Parser())
    (here / "captions.jsonl").write_text('{"caption": "  "}\n')
    assert "captions.jsonl, line 1: the text is blank" in fails(capsys, "parse", "--jsonl", "captions.jsonl")


def test_parse_prints_one_object(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(MotionPipeline, "load", lambda *_, **__: Parser())
    assert cli.main(["parse", "a person waves"]) == 0
    assert json.loads(capsys.readouterr().out) == whole("a person waves").to_dict()


def test_parse_prints_one_object_per_line(
    capsys: pytest.CaptureFixture[str], here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """U+2028 ends a line for `str.splitlines`, but not in JSON lines; a BOM is not part of a caption."""
    monkeypatch.setattr(MotionPipeline, "load", lambda *_, **__: Parser())
    captions = ["a person walks", "a\u2028b", "über 😀", "{curly}"]
    lines = [
        captions[0],
        json.dumps({"caption": captions[1], "motion": 4}),
        captions[2],
        json.dumps({"caption": captions[3]}),
    ]
    (here / "captions.jsonl").write_bytes(b"\xef\xbb\xbf" + "\r\n".join(lines).encode() + b"\n")
    assert cli.main(["parse", "--jsonl", "captions.jsonl"]) == 0
    out = capsys.readouterr().out
    assert [json.loads(line)["caption"] for line in out.removesuffix("\n").split("\n")] == captions


@pytest.mark.parametrize("verb", ["info", "verify"])
@pytest.mark.parametrize("damage", ["flip", "missing", "extra", "no folder", "no manifest"])
def test_a_damaged_bundle(capsys: pytest.CaptureFixture[str], bundle: Path, verb: str, damage: str) -> None:
    expected = {"extra": "surprise", "no folder": "elsewhere", "no manifest": "manifest.json"}.get(
        damage, "decoder.onnx"
    )
    if damage == "flip":
        data = bytearray((bundle / "decoder.onnx").read_bytes())
        data[20] ^= 4
        (bundle / "decoder.onnx").write_bytes(data)
    elif damage == "missing":
        (bundle / "decoder.onnx").unlink()
    elif damage == "extra":
        (bundle / "surprise").touch()
    elif damage == "no manifest":
        (bundle / "manifest.json").unlink()
    folder = bundle.parent / "elsewhere" if damage == "no folder" else bundle
    assert expected in fails(capsys, verb, "--bundle", str(folder))


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["generate", "a person walks", "-o", "x.npz", "--secnds", "4"], "--secnds 4; did you mean --seconds?"),
        (["generate", "a", "person", "walks", "-o", "x.npz"], "person walks; a sentence goes into quotes"),
        (["generate", "a person walks", "-o", "x.npz", "--sec", "4"], "did you mean --seconds?"),  # no abbreviations
        (["generate", "a person walks", "-o", "x.npz", "--seed", "abc"], "invalid int value: 'abc'"),
        (["edit"], "the following arguments are required"),
    ],
)
def test_wrong_arguments_are_told_in_one_line(
    words: list[str], told: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stopped:
        cli.main(words)
    error = capsys.readouterr().err
    assert stopped.value.code == 2 and error.count("\n") == 1 and told in error
    assert f"`kinegraph {words[0]} --help` lists what it takes" in error and not list(tmp_path.iterdir())
