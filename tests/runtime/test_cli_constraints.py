"""Constraints on the command line: what the flags mean, what they refuse, and how misses are told."""

from __future__ import annotations

import argparse
import json
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pytest

from kinegraph import (
    Clip,
    EndPose,
    InvalidInputError,
    JointTarget,
    Keyframe,
    Loop,
    Miss,
    MotionPipeline,
    Path,
    StartPose,
    Waypoint,
)
from kinegraph.batch import BatchOptions, read_table, unfinished
from kinegraph.cli import main
from kinegraph.cli.constraints import add_constraints, describe_misses, miss_records, parse_constraints
from kinegraph.formats import read as read_clip
from kinegraph.formats.constraints_json import encode
from support.cli_runs import fails, not_loaded
from support.motions import walk


def parsed(*arguments: str) -> list[Any]:
    """The constraints of some flags."""
    parser = argparse.ArgumentParser()
    add_constraints(parser)
    return parse_constraints(parser.parse_args(arguments))


@pytest.fixture
def clip(here: FilePath) -> Clip:
    """Saved as clip.npz in the working folder."""
    made = Clip(walk(40), 20, 1, "a person walks", "test 1")
    made.save("clip.npz")
    return made


def test_without_flags_there_are_none() -> None:
    assert parsed() == []


def test_a_path() -> None:
    (path,) = parsed("--path", "0,0 1,2  3,2.5")
    assert isinstance(path, Path) and path.points.tolist() == [[0, 0], [1, 2], [3, 2.5]] and path.times is None
    (timed,) = parsed("--path=-1,0@0 1,-2@1.5s")
    assert timed.points.tolist() == [[-1, 0], [1, -2]] and timed.times.tolist() == [0, 1.5]


def test_waypoints() -> None:
    made = parsed("--waypoint", "2.5s=1,2", "--waypoint", "3=-1,2,90")
    assert made == [Waypoint(2.5, (1, 2)), Waypoint(3, (-1, 2), heading=90)]


def test_hands_feet_and_other_joints() -> None:
    made = parsed("--hand", "right@2s=.3,1.5,.4", "--foot", "Left@1-2.5s=0,_,1", "--joint", "head@2=_,1.2,_")
    assert made == [
        JointTarget("right_wrist", (0.3, 1.5, 0.4), 2),
        JointTarget("left_foot", (0, None, 1), (1, 2.5)),
        JointTarget("head", (None, 1.2, None), 2),
    ]


def test_poses_of_clips(clip: Clip) -> None:
    keyframe, start, end, loop = parsed(
        "--keyframe", "1s=clip.npz@0.5s", "--start", "clip.npz", "--end", "clip.npz", "--loop-pose"
    )
    assert isinstance(keyframe, Keyframe) and keyframe.seconds == 1
    np.testing.assert_array_equal(keyframe.joints, clip.joints[10])
    assert isinstance(start, StartPose) and (start.joints == clip.joints[-4:]).all()
    assert isinstance(end, EndPose) and (end.joints == clip.joints[:4]).all()
    assert loop == Loop()


def test_a_file_comes_after_the_flags(here: FilePath) -> None:
    (here / "file.json").write_bytes(encode([Waypoint(1, (0, 1))]))
    assert parsed("--constraints", "file.json", "--waypoint", "2=0,2") == [Waypoint(2, (0, 2)), Waypoint(1, (0, 1))]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--path", "0,0"), "--path '0,0': a path has 2 to 1000 points"),
        (("--path", "0,0 1"), "'1' is not x,z in metres"),
        (("--path", "0,0 1,x"), "'x' is no number"),
        (("--path", "0,0@0 1,1"), "1 times for 2 points"),
        (("--path", "0,0@0 1,1@0-1"), "is a while"),
        (("--waypoint", "1,2"), "write TIME=X,Z"),
        (("--waypoint", "soon=1,2"), "'soon' is no time"),
        (("--waypoint", "-1=1,2"), "'-1' is no time"),
        (("--waypoint", "1=nan,2"), "'nan' is no number"),
        (("--hand", "2s=.3,1.5,.4"), "write SIDE@TIME=X,Y,Z"),
        (("--hand", "middle@2s=.3,1.5,.4"), "left or right, not 'middle'"),
        (("--foot", "left@2s"), "write NAME@TIME=X,Y,Z"),
        (("--joint", "tail@2s=1,1,1"), "no joint 'tail'"),
        (("--joint", "head@2s=_,_,_"), "no axis that is not free"),
        (("--joint", "head@2s=1,1"), "in metres"),
        (("--keyframe", "2s=clip.npz"), "write TIME=CLIP@TIME"),
        (("--keyframe", "2s=clip.npz@9s"), "has 2 s and no pose at 9 s"),
        (("--keyframe", "2s=none.npz@1s"), "none.npz"),
        (("--start", "none.npz"), "none.npz"),
        (("--constraints", "none.json"), "none.json"),
    ],
)
@pytest.mark.usefixtures("clip")
def test_what_cannot_be_read_is_told(arguments: tuple[str, ...], message: str) -> None:
    flag, value = arguments
    with pytest.raises(InvalidInputError, match=message):
        parsed(f"{flag}={value}")


def test_misses_are_told_in_a_line_each() -> None:
    misses = (
        Miss("waypoint at 2 s", 0.0042, 0.0042),
        Miss("path of 4 m", 0.013, 0.151, 7.6),
    )
    assert describe_misses(misses) == [
        "waypoint at 2 s: missed by 4 mm",
        "path of 4 m: missed by 13 mm, 0.15 m at worst, heading 8 degrees",
    ]
    assert miss_records(misses)[1] == {"what": "path of 4 m", "metres": 0.013, "worst": 0.151, "degrees": 7.6}


# Whole runs, on the toy bundle

SHORT = ("--seconds", "1", "--seed", "1", "--steps", "1")


@pytest.mark.usefixtures("toy_by_default")
@pytest.mark.parametrize("command", [("generate", "a person walks"), ("compose", "--and", "a person walks")])
def test_a_clip_comes_with_its_misses(
    command: tuple[str, ...], here: FilePath, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("spacy")
    words = [*command, *SHORT, "--waypoint", "1s=0,0.3", "--hand", "left@0.5s=_,1.2,_", "-o", "walk.npz"]
    assert main(words) == 0
    first, *others = capsys.readouterr().out.splitlines()
    assert first.startswith("walk.npz: 20 frames")
    assert [line.partition(": missed by ")[0] for line in others] == ["  waypoint at 1 s", "  left_wrist at 0.5 s"]
    assert main([*words, "--force", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert [miss["what"] for miss in record["misses"]] == ["waypoint at 1 s", "left_wrist at 0.5 s"]
    assert main([*words, "--force", "--quiet"]) == 0
    assert capsys.readouterr().out == ""


@pytest.mark.usefixtures("toy_by_default")
def test_what_nobody_can_do_is_told_and_refused_when_strict(
    here: FilePath, toy: MotionPipeline, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("spacy")
    words = ["generate", "a person walks", *SHORT, "--waypoint", "1s=0,9", "-o", "walk.npz"]
    assert main(words) == 0
    assert "9 m from the origin" in capsys.readouterr().err
    (here / "walk.npz").unlink()
    if toy.vocabulary is not None:
        assert "9 m from the origin" in fails(capsys, *words, "--strict")
        assert list(here.iterdir()) == []
    assert "after the end of the clip" in fails(capsys, *words, "--waypoint", "2s=0,1")
    assert list(here.iterdir()) == []


def test_bad_flags_are_refused_before_anything_is_loaded(
    here: FilePath, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(MotionPipeline, "load", not_loaded)
    for command in (("generate", "a person walks"), ("compose", "--and", "a person walks")):
        assert "--path '0,0'" in fails(capsys, *command, "-o", "x.npz", "--path", "0,0")
    assert list(here.iterdir()) == []


def test_rows_of_a_table_name_files_of_constraints(
    here: FilePath, toy_bundle: FilePath, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("spacy")
    (here / "place.json").write_bytes(encode([Waypoint(1, (0, 0.3))]))
    (here / "rows.csv").write_text("text,seconds,constraints\na person walks,1,place.json\na person walks,1,\n")
    words = ["batch", "rows.csv", "-o", "out", "--bundle", str(toy_bundle), "--workers", "1", "--quiet"]
    assert main(words) == 0
    records = [json.loads(line) for line in (here / "out" / "manifest.jsonl").read_text().splitlines()]
    assert [[miss["what"] for miss in record["misses"]] for record in records] == [["waypoint at 1 s"], []]
    rows = read_table("rows.csv")
    assert unfinished(rows, "out", BatchOptions(bundle=str(toy_bundle))) == []
    (here / "place.json").write_bytes(encode([Waypoint(1, (0, 0.4))]) + b"\n")
    assert unfinished(rows, "out", BatchOptions(bundle=str(toy_bundle))) == rows[:1]  # another file, another clip
    (here / "rows.csv").write_text("text,constraints\na person walks,none.json\n")
    assert "row 1: there is no file of constraints" in fails(capsys, *words)


@pytest.mark.usefixtures("toy_by_default")
@pytest.mark.parametrize(
    ("command", "told"),
    [
        (("edit", "clip.npz", "a person bows", "--keep", "legs", "--keep", "0-0.5s"), "what is kept"),
        (("inbetween", "clip.npz", "clip.npz", "a person walks", "--seconds", "1"), "end pose"),
    ],
)
def test_saved_clips_are_edited_and_joined(
    clip: Clip, command: tuple[str, ...], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("spacy")
    assert main([*command, "--seed", "1", "--steps", "1", "-o", "made.npz"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith(f"  {told}: missed by")
    assert read_clip("made.npz").frames == (clip.frames if command[0] == "edit" else 20)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (("edit", "clip.npz", "a person bows", "--keep", "1s"), "write a span like 0-1s"),
        (("edit", "none.npz", "a person bows", "--keep", "legs"), "none.npz"),
        (("inbetween", "clip.npz", "none.npz", "a person bows"), "none.npz"),
    ],
)
@pytest.mark.usefixtures("clip")
def test_bad_edits_are_refused_before_anything_is_loaded(
    command: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(MotionPipeline, "load", not_loaded)
    assert message in fails(capsys, *command, "-o", "made.npz")


@pytest.mark.usefixtures("clip", "toy_by_default")
def test_what_is_no_part_of_the_body_is_refused(here: FilePath, capsys: pytest.CaptureFixture[str]) -> None:
    assert "tail" in fails(capsys, "edit", "clip.npz", "a person bows", "--keep", "tail", "-o", "made.npz")
    assert not (here / "made.npz").exists()
