"""Output of the command line: what it prints and writes for valid input, and how it ends when it is stopped."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import kinegraph
from kinegraph import MotionPipeline, cli
from kinegraph.errors import Cancelled, InvalidInputError
from support.cli_runs import Parser, fails
from support.synthetic_bundle import bundle_files

RUNTIME = Path(kinegraph.__file__).resolve().parents[1]

pytestmark = pytest.mark.usefixtures("toy_by_default")


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
        "what it cannot",
        "decoder.onnx",
    ):
        assert word in text
    assert cli.main(["info", "--json", "--bundle", str(bundle)]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["licence"]["weights"] == "CC0-1.0"
    assert record["provenance"] == {"training_data": "none", "built_with": "tests"}
    assert record["scope"] == {"actions": "none", "cannot": "move"}
    assert record["bytes"] == {name: len(data) for name, data in bundle_files().items()}


def test_verify_lists_every_file(capsys: pytest.CaptureFixture[str], bundle: Path) -> None:
    assert cli.main(["verify", "--bundle", str(bundle)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "ok: 32 files, 29 graphs"
    for name in bundle_files():
        assert any(line.startswith(f"  ok  {name}: ") for line in lines)
    assert cli.main(["verify", "--json", "--bundle", str(bundle)]) == 0
    assert json.loads(capsys.readouterr().out)["path"] == str(bundle.resolve())


@pytest.mark.parametrize("stop", [KeyboardInterrupt, Cancelled])
def test_an_interrupt_is_130(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, stop: type[BaseException]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise stop

    monkeypatch.setattr(MotionPipeline, "load", interrupted)
    assert cli.main(["parse", "a person walks"]) == 130
    assert capsys.readouterr().err == "kinegraph: cancelled\n"


def test_messages_stay_on_one_line(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise InvalidInputError("first\nsecond\r\n\tthird")

    monkeypatch.setattr(MotionPipeline, "load", broken)
    assert fails(capsys, "parse", "a person walks") == "kinegraph: error: first second third\n"


def test_a_terminal_without_unicode_gets_escapes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(MotionPipeline, "load", lambda *_, **__: Parser())
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding="ascii"))
    assert cli.main(["parse", "--json", "über 😀"]) == 0
    sys.stdout.flush()
    assert json.loads(raw.getvalue())["caption"] == "über 😀"


def run(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(RUNTIME), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(
        [sys.executable, "-m", "kinegraph", *arguments],
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
    command = f"{sys.executable} -m kinegraph info --json --bundle {bundle}; echo $? >&2"
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


@pytest.mark.parametrize("arguments", BAD_OPTIONS, ids=lambda item: " ".join(item)[:40])
def test_bad_text_and_options_write_nothing(
    capsys: pytest.CaptureFixture[str], here: Path, arguments: list[str]
) -> None:
    fails(capsys, "generate", *arguments, "-o", "x.npz")
    assert list(here.iterdir()) == []


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


def test_a_parsed_graph_goes_back_in(capsys: pytest.CaptureFixture[str], here: Path) -> None:
    pytest.importorskip("spacy", reason="plain sentences need the text extra")
    assert cli.main(["parse", "a person walks slowly to the left"]) == 0
    (here / "g.json").write_text(capsys.readouterr().out)
    arguments = ["--seconds", "2", "--seed", "7", "--steps", "2", "--quiet"]
    assert cli.main(["generate", "--graph", "g.json", "-o", "graph.bvh", *arguments]) == 0
    assert cli.main(["generate", "a person walks slowly to the left", "-o", "text.bvh", *arguments]) == 0
    assert (here / "graph.bvh").read_bytes() == (here / "text.bvh").read_bytes()
