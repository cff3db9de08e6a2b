"""The command line: bad input gives one line on stderr, exit code 2 and no file; good input what it says."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from synthetic_bundle import bundle_files, write_bundle

import kinegraph
from kinegraph import cli
from kinegraph.bundle import DEFAULT_BUNDLE
from kinegraph.errors import Cancelled, InvalidInputError
from kinegraph.graph import Action, SemanticGraph

needs_default = pytest.mark.skipif(
    not (DEFAULT_BUNDLE / "manifest.json").is_file(), reason="the default bundle has not been exported yet"
)

RUNTIME = Path(kinegraph.__file__).resolve().parents[1]


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    return write_bundle(tmp_path / "bundle")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty current folder."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "here"


def fails(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run a command that must fail; returns its one line."""
    assert cli.main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert captured.err.startswith("kinegraph: error: ")
    return captured.err


def not_loaded(*_: object, **__: object) -> None:
    raise AssertionError("a bundle was loaded although the input is bad")


def whole(caption: str) -> SemanticGraph:
    """A graph whose one action is the whole caption."""
    return SemanticGraph(caption, (Action(caption, 0, len(caption), 0),))


class Parser:
    """Stands in for the pipeline where only parsing is asked for."""

    def parse(self, text: str) -> SemanticGraph:
        if not text.strip():
            raise InvalidInputError("the text is blank")
        return whole(text)


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
    monkeypatch.setattr(cli, "_load", not_loaded)
    fails(capsys, "generate", "a person walks", "-o", target)
    assert list(here.iterdir()) == []


def test_a_file_is_not_overwritten_unasked(
    capsys: pytest.CaptureFixture[str], here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cli, "_load", not_loaded)
    (here / "x.npz").write_bytes(b"precious")
    assert "x.npz" in fails(capsys, "generate", "a person walks", "-o", "x.npz")
    assert (here / "x.npz").read_bytes() == b"precious"


@pytest.mark.parametrize("arguments", [[], ["a person walks", "--graph", "g.json"]])
def test_a_sentence_or_a_graph(
    capsys: pytest.CaptureFixture[str], here: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str]
) -> None:
    monkeypatch.setattr(cli, "_load", not_loaded)
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
    monkeypatch.setattr(cli, "_load", not_loaded)
    (here / "g.json").write_bytes(GRAPHS[kind])
    assert "g.json" in fails(capsys, "generate", "--graph", "g.json", "-o", "x.npz")
    assert [path.name for path in here.iterdir()] == ["g.json"]


@pytest.mark.parametrize("name", ["missing.json", ".", "a\0b", "x" * 5000])
def test_a_graph_that_is_no_file(
    capsys: pytest.CaptureFixture[str], here: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr(cli, "_load", not_loaded)
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
    monkeypatch.setattr(cli, "_load", not_loaded)
    (here / "captions.jsonl").write_bytes(content)
    assert message in fails(capsys, "parse", "--jsonl", "captions.jsonl")


def test_a_line_that_does_not_parse_is_named(
    capsys: pytest.CaptureFixture[str], here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cli, "_load", lambda *_: Parser())
    (here / "captions.jsonl").write_text('{"caption": "  "}\n')
    assert "captions.jsonl, line 1: the text is blank" in fails(capsys, "parse", "--jsonl", "captions.jsonl")


def test_parse_prints_one_object(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cli, "_load", lambda *_: Parser())
    assert cli.main(["parse", "a person waves"]) == 0
    assert json.loads(capsys.readouterr().out) == whole("a person waves").to_dict()


def test_parse_prints_one_object_per_line(
    capsys: pytest.CaptureFixture[str], here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """U+2028 ends a line for `str.splitlines`, but not in JSON lines; a BOM is no part of a caption."""
    monkeypatch.setattr(cli, "_load", lambda *_: Parser())
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


def test_info_tells_licences_and_provenance(capsys: pytest.CaptureFixture[str], bundle: Path) -> None:
    assert cli.main(["info", "--bundle", str(bundle)]) == 0
    text = capsys.readouterr().out
    for word in (
        "synthetic 0.0.1",
        "fp32",
        "CC0-1.0",
        "text_encoder",
        "MIT",
        "training_data",
        "jerk",
        "decoder.onnx",
    ):
        assert word in text
    assert cli.main(["info", "--json", "--bundle", str(bundle)]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["licence"]["weights"] == "CC0-1.0"
    assert record["provenance"] == {"training_data": "none", "built_with": "tests"}
    assert record["bytes"] == {name: len(data) for name, data in bundle_files().items()}


def test_verify_lists_every_file(capsys: pytest.CaptureFixture[str], bundle: Path) -> None:
    assert cli.main(["verify", "--bundle", str(bundle)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "ok: 12 files, 9 graphs"
    for name in bundle_files():
        assert any(line.startswith(f"  ok  {name}: ") for line in lines)
    assert cli.main(["verify", "--json", "--bundle", str(bundle)]) == 0
    assert json.loads(capsys.readouterr().out)["path"] == str(bundle.resolve())


@pytest.mark.parametrize("stop", [KeyboardInterrupt, Cancelled])
def test_an_interrupt_is_130(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, stop: type[BaseException]
) -> None:
    def interrupted(*_: object) -> None:
        raise stop

    monkeypatch.setattr(cli, "_load", interrupted)
    assert cli.main(["parse", "a person walks"]) == 130
    assert capsys.readouterr().err == "kinegraph: cancelled\n"


def test_messages_stay_on_one_line(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise InvalidInputError("first\nsecond\r\n\tthird")

    monkeypatch.setattr(cli, "_load", broken)
    assert fails(capsys, "parse", "a person walks") == "kinegraph: error: first second third\n"


def test_a_terminal_without_unicode_gets_escapes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cli, "_load", lambda *_: Parser())
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding="ascii"))
    assert cli.main(["parse", "--json", "über 😀"]) == 0
    sys.stdout.flush()
    assert json.loads(raw.getvalue())["caption"] == "über 😀"


def run(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(RUNTIME), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(
        [sys.executable, "-m", "kinegraph.cli", *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_version_and_exit_code_of_the_program(tmp_path: Path) -> None:
    assert run("--version", folder=tmp_path).stdout == f"kinegraph {kinegraph.__version__}\n"
    wrong = run("info", "--bundle", "nowhere", folder=tmp_path)
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert wrong.stderr.startswith("kinegraph: error: no bundle at 'nowhere'")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name != "posix", reason="pipes of POSIX")
def test_a_closed_pipe_is_quiet(bundle: Path) -> None:
    command = f"{sys.executable} -m kinegraph.cli info --json --bundle {bundle}; echo $? >&2"
    reader, writer = os.pipe()
    os.close(reader)
    environment = {**os.environ, "PYTHONPATH": str(RUNTIME)}
    done = subprocess.run(
        ["sh", "-c", command], stdout=writer, stderr=subprocess.PIPE, env=environment, timeout=60, check=False
    )
    os.close(writer)
    assert done.stderr.decode() == "141\n"


BAD_OPTIONS = [
    ["", "--seconds", "4"],
    ["   "],
    ["x" * 10_000],
    ["a person walks", "--seconds", "nan"],
    ["a person walks", "--seconds", "-4"],
    ["a person walks", "--seconds", "1e9"],
    ["a person walks", "--seconds", "inf"],
    ["a person walks", "--seed", "-1"],
    ["a person walks", "--seed", str(2**63)],
    ["a person walks", "--steps", "0"],
    ["a person walks", "--steps", "1,2"],
    ["a person walks", "--steps", "1000000"],
    ["a person walks", "--guidance", "nan"],
    ["a person walks", "--guidance", "1,2,300"],
    ["a person walks", "--threads", "0"],
]


@needs_default
@pytest.mark.parametrize("arguments", BAD_OPTIONS, ids=lambda item: " ".join(item)[:40])
def test_bad_text_and_options_write_nothing(
    capsys: pytest.CaptureFixture[str], here: Path, arguments: list[str]
) -> None:
    fails(capsys, "generate", *arguments, "-o", "x.npz")
    assert list(here.iterdir()) == []


@needs_default
@pytest.mark.parametrize("text", ["😀", "\udcff walks", "a\0b", "\u202e\u200b"])
def test_odd_text_ends_in_a_clip_or_one_line(capsys: pytest.CaptureFixture[str], here: Path, text: str) -> None:
    code = cli.main(["generate", text, "-o", "x.npz", "--steps", "1", "--seed", "1"])
    captured = capsys.readouterr()
    if code == 0:
        assert [path.name for path in here.iterdir()] == ["x.npz"]
    else:
        assert code == 2
        assert captured.err.startswith("kinegraph: error: ")
        assert captured.err.count("\n") == 1
        assert list(here.iterdir()) == []


@needs_default
def test_generate_tells_what_it_wrote(capsys: pytest.CaptureFixture[str], here: Path) -> None:
    arguments = ["generate", "a person walks forward", "--seconds", "2", "--seed", "7", "--steps", "2"]
    assert cli.main([*arguments, "-o", "x.npz", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert (record["file"], record["frames"], record["seconds"], record["seed"]) == ("x.npz", 40, 2.0, 7)
    first = (here / "x.npz").read_bytes()
    assert cli.main([*arguments, "-o", "x.npz", "--force", "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    assert (here / "x.npz").read_bytes() == first
    assert cli.main([*arguments, "-o", "x.bvh", "--progress"]) == 0
    captured = capsys.readouterr()
    assert captured.out.startswith("x.bvh: 40 frames, 2 s, seed 7")
    assert "specific 2/2" in captured.err


@needs_default
def test_a_parsed_graph_goes_back_in(capsys: pytest.CaptureFixture[str], here: Path) -> None:
    pytest.importorskip("spacy", reason="plain sentences need the text extra")
    assert cli.main(["parse", "a person walks slowly to the left"]) == 0
    (here / "g.json").write_text(capsys.readouterr().out)
    arguments = ["--seconds", "2", "--seed", "7", "--steps", "2", "--quiet"]
    assert cli.main(["generate", "--graph", "g.json", "-o", "graph.bvh", *arguments]) == 0
    assert cli.main(["generate", "a person walks slowly to the left", "-o", "text.bvh", *arguments]) == 0
    assert (here / "graph.bvh").read_bytes() == (here / "text.bvh").read_bytes()
