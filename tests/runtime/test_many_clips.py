"""`kinegraph batch`: a table of sentences in, files and a manifest out; interrupted and continued."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph import MotionPipeline
from kinegraph.batch import BatchOptions, make_batch, read_table, unfinished
from kinegraph.bundle.reader import manifest_digest
from kinegraph.cli import main
from kinegraph.errors import InvalidInputError, ModelError
from kinegraph.formats import read
from support.characters import BUILDS, make_character
from support.cli_runs import fails, not_loaded

TABLE = """text,seconds,seed,name
a person walks,2,,
"a person walks, then bows",2,40,bow
,2,,broken
a person runs,,,run
"""


def table(folder: Path, text: str = TABLE) -> Path:
    path = folder / "prompts.csv"
    path.write_text(text, encoding="utf-8")
    return path


def lines(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "manifest.jsonl").read_text(encoding="utf-8").splitlines()]


def test_a_table_has_seeds_and_names_for_every_row(tmp_path: Path) -> None:
    rows = read_table(table(tmp_path), seed=7)
    assert [row.seed for row in rows] == [7, 40, 9, 10]
    assert [row.name for row in rows] == ["000001_a-person-walks", "bow", "broken", "run"]
    assert [row.seconds for row in rows] == [2, 2, 2, None]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "the head is ''"),
        ("caption\nx", "must be text"),
        ("text,text\nx,y", "must be text"),
        ("text,colour\nx,y", "must be text"),
        ("text\n", "has 0 rows"),
        ("text,seconds\nx,long\n", "row 1: seconds is 'long'; write a number"),
        ("text,seed\nx,abc\n", "row 1: seed is 'abc'; write a whole number"),
        ("text,seed\nx,-1\n", "row 1: seed is"),
        ("text,seed\nx,99999999999999999999\n", "row 1: seed is"),
        ("text,name\nx,../y\n", "is no name for a file"),
        ("text,name\nx,manifest\n", "is no name for a file"),
        ("text,name\nx,A\ny,a\n", "rows 1 and 2 have the same name"),
        ("text,name\nwalks, then bows,a\n", "3 values for 2 columns"),
        ('text\n"open\n', "line"),
    ],
)
def test_bad_tables_are_refused_before_anything_is_made(
    tmp_path: Path, text: str, problem: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kinegraph.pipeline.MotionPipeline.load", not_loaded)
    with pytest.raises(InvalidInputError, match=problem):
        read_table(table(tmp_path, text))
    fails(capsys, "batch", str(tmp_path / "prompts.csv"), "-o", str(tmp_path / "out"))
    assert not (tmp_path / "out").exists()


TOLD = {"unknown": 0, "notes": 0}
"""Of clips with unknown words, and with notes."""


def test_rows_are_made_failures_are_told_and_a_second_run_goes_on(
    tmp_path: Path, toy: MotionPipeline, toy_bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    words = ["batch", str(table(tmp_path)), "-o", str(out), "--bundle", str(toy_bundle), "--workers", "1", "--json"]
    assert main(words) == 2
    captured = capsys.readouterr()
    assert json.loads(captured.out) == {"folder": str(out), "made": 3, "failed": 1, "kept": 0, **TOLD}
    assert "1 of 4 rows failed" in captured.err
    records = {record["name"]: record for record in lines(out)}
    assert records["broken"]["kind"] == "InvalidInputError" and "file" not in records["broken"]
    assert sorted(path.name for path in out.iterdir()) == [
        "000001_a-person-walks.npz", "bow.npz", "manifest.jsonl", "run.npz",
    ]  # fmt: skip
    clip = toy.generate("a person walks, then bows", seconds=2, seed=40)
    np.testing.assert_array_equal(read(out / "bow.npz").joints, clip.joints)
    # a torn line, a file that is gone, and a row that is another now
    with (out / "manifest.jsonl").open("a") as manifest:
        manifest.write('{"row": 9, "na')
    (out / "run.npz").unlink()
    stamp = (out / "bow.npz").stat().st_mtime_ns
    table(tmp_path, TABLE.replace(",2,,broken", "a person bows,2,,broken").replace("walks,2,,", "jumps,2,1,"))
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out) == {"folder": str(out), "made": 3, "failed": 0, "kept": 1, **TOLD}
    assert (out / "bow.npz").stat().st_mtime_ns == stamp
    assert (out / "000001_a-person-jumps.npz").is_file() and (out / "broken.npz").is_file()
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["made"] == 0


def test_clips_of_another_bundle_are_made_again(tmp_path: Path, toy_bundle: Path) -> None:
    pytest.importorskip("spacy")
    bundle = tmp_path / "bundle"
    shutil.copytree(toy_bundle, bundle)
    rows = read_table(table(tmp_path, "text,seconds\na person walks,1\n"))
    options = BatchOptions(bundle=str(bundle))
    (record,) = make_batch(rows, tmp_path / "out", options, workers=1)
    assert record["bundle_sha256"] == manifest_digest(bundle) and not unfinished(rows, tmp_path / "out", options)
    manifest = json.loads((bundle / "manifest.json").read_text())
    (bundle / "manifest.json").write_text(json.dumps(manifest))  # the same name and version, other bytes
    assert unfinished(rows, tmp_path / "out", options) == rows


def test_a_row_whose_file_of_constraints_is_gone_fails_alone(tmp_path: Path, toy_bundle: Path) -> None:
    pytest.importorskip("spacy")
    (tmp_path / "path.json").write_text("[]")
    text = "text,seconds,constraints\na person walks,1,path.json\na person runs,1,\n"
    rows = read_table(table(tmp_path, text))
    (tmp_path / "path.json").unlink()
    made = list(make_batch(rows, tmp_path / "out", BatchOptions(bundle=str(toy_bundle)), workers=1))
    assert ["error" in record for record in made] == [True, False] and "any more" in made[0]["error"]


def test_processes_make_the_same_files_and_may_be_left_in_the_middle(
    tmp_path: Path, toy: MotionPipeline, toy_bundle: Path
) -> None:
    pytest.importorskip("spacy")
    text = "text,seconds\n" + "".join(f"a person walks {way},2\n" for way in ("forward", "backward", "slowly", "fast"))
    rows = read_table(table(tmp_path, text))
    options = BatchOptions(bundle=str(toy_bundle))
    running = make_batch(rows, tmp_path / "out", options, workers=2)
    first = next(running)
    running.close()
    assert len(lines(tmp_path / "out")) == 1 and len(unfinished(rows, tmp_path / "out", options)) == 3
    rest = list(make_batch(rows, tmp_path / "out", options, workers=2))
    assert {record["row"] for record in [first, *rest]} == {1, 2, 3, 4} and len(rest) == 3
    for row in rows:
        clip = toy.generate(row.text, seconds=2, seed=row.seed)
        np.testing.assert_allclose(read(tmp_path / "out" / f"{row.name}.npz").joints, clip.joints, atol=1e-4)


def test_a_process_that_ends_is_told(tmp_path: Path) -> None:
    rows = read_table(table(tmp_path, "text\na\nb\n"))
    with pytest.raises(ModelError, match="the same command goes on"):
        list(make_batch(rows, tmp_path / "out", BatchOptions(bundle=str(tmp_path / "nowhere")), workers=2))


def test_clips_go_on_a_character_and_options_are_checked_first(
    tmp_path: Path, toy_bundle: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    hero = tmp_path / "hero.glb"
    hero.write_bytes(make_character(BUILDS["SOMA, a hundredth"]))
    words = ["batch", str(table(tmp_path, "text,seconds,name\na person walks,2,walk\n")), "-o", str(tmp_path / "out")]
    words += ["--bundle", str(toy_bundle), "--workers", "1", "--character", str(hero)]
    assert main([*words, "--format", ".glb", "--progress"]) == 0
    assert "1/1 clips" in capsys.readouterr().err
    (record,) = lines(tmp_path / "out")
    assert record["file"] == "walk.glb" and record["fps"] == 30 and record["frames"] == 60
    monkeypatch.setattr("kinegraph.batch.MotionPipeline.load", not_loaded)
    assert "saved as .glb" in fails(capsys, *words)
    for options, problem in (
        (["--format", ".fbx"], "must be one of"),
        (["--format", ".npz", "--root"], "a root joint is for"),
        (["--fps", "0"], "fps must be"),
        (["--workers", "0"], "workers must be"),
        (["--seed", "-1"], "seed is -1"),
    ):
        assert problem in fails(capsys, *words[:6], *options)
    assert "cannot be made" in fails(capsys, *words[:3], str(tmp_path / "no" / "where"))
