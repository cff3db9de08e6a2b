"""What befell people's files: each kind is read right, or refused with the reason and the cure.

The files of ../shared/cases, where they are, are read too.

Above 500 lines because every kind of file that people bring is a case here, each with its own input.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

from kinegraph.errors import InvalidInputError, OutputError
from kinegraph.limits import MAX_FRAMES
from kinegraph.motion.skeleton import JOINT_NAMES, canonicalise
from kinegraph_training.config import DataConfig
from kinegraph_training.data import folder as data_folder
from kinegraph_training.data.body import UP_AXES, axis_vector, rotation_to_y_up
from kinegraph_training.data.bvh import parse_bvh, read_recording
from kinegraph_training.data.captions_file import read_captions
from kinegraph_training.data.clips import read_split
from kinegraph_training.data.jumps import find_jumps, motion_start
from kinegraph_training.data.recording import MAX_POINTS
from kinegraph_training.data.understanding import Stated, Understood, understand
from kinegraph_training.data.windows import MIN_FRAMES, cut_windows, holds_at_any_moment
from kinegraph_training.prepare import main
from support.bvh_files import bvh_text, write_bvh_folder
from support.exporters import EXPORTERS, true_joints
from support.shared import shared_path

WALK = EXPORTERS["Mixamo"].text(31)
TRUTH = canonicalise(true_joints(21))
HEAD, MOTION = WALK.split("MOTION\n")
ROWS = MOTION.splitlines()[2:]


def with_rows(rows: list[str], frames: int | None = None) -> str:
    return f"{HEAD}MOTION\nFrames: {frames or len(rows)}\nFrame Time: 0.0333333\n" + "\n".join(rows) + "\n"


def read(tmp_path: Path, text: str | bytes, **stated: object) -> Understood:
    path = tmp_path / "walk.bvh"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return understand(read_recording(path), Stated(**stated), 20.0)  # type: ignore[arg-type]


def prepared(tmp_path: Path, files: dict[str, str], *options: str, captions: dict[str, str] | None = None) -> int:
    return main([*write_bvh_folder(tmp_path, files, captions), "--val", "0", "--test", "0", *options])


def error_of(tmp_path: Path, capsys: pytest.CaptureFixture[str], files: dict[str, str], *options: str) -> str:
    """The one error of a run that writes nothing."""
    assert prepared(tmp_path, files, *options) == 2
    assert not (tmp_path / "out").exists()
    error = capsys.readouterr().err
    assert error.count("error:") == 1
    return error


# up, sides, unit


@pytest.mark.parametrize("up", UP_AXES)
def test_up_is_found_along_every_axis(tmp_path: Path, up: str) -> None:
    rotation = rotation_to_y_up(up)
    assert np.linalg.det(rotation) == pytest.approx(1)
    np.testing.assert_allclose(rotation @ axis_vector(up), [0, 1, 0])
    recording = read_recording(_write(tmp_path, WALK))
    turned = replace(
        recording,
        sample=lambda times: recording.sample(times) @ rotation,
        rest=recording.rest @ rotation,  # type: ignore[operator]
    )
    found = understand(turned, Stated(), 20.0)
    assert found.up == up
    assert np.linalg.norm(found.joints - TRUTH, axis=-1).max() <= 0.01


def lying(frames: int = 31) -> str:
    """A body that lies on its back, in a file whose rest pose stands along y."""
    row = ROWS[0].split()
    first = ["0", "10", "0", "0", "-90", "0"]
    return with_rows([" ".join([*first, *row[6:]])] * frames)


def test_a_lying_body_asks_for_up_or_follows_its_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "pass --up=y if it lies, --up=-z if it stands" in error_of(tmp_path, capsys, {"lie.bvh": lying()})
    joints = read(tmp_path, lying(), up="y").joints
    assert np.ptp(joints[..., 1]) < 0.6
    assert prepared(tmp_path, {"lie.bvh": lying(), "walk.bvh": WALK}) == 0
    assert "up is y as in the other files" in capsys.readouterr().out


def test_a_body_that_only_stands_at_times_takes_up_from_its_rest_pose(tmp_path: Path) -> None:
    row = ROWS[0].split()
    found = read(tmp_path, with_rows([" ".join(["0", "50", "0", "0", "48", "0", *row[6:]])] * 31))
    assert found.up == "y"
    assert any("seldom stands" in warning for warning in found.warnings)


def test_the_unit_is_found_or_scale_is_named(tmp_path: Path) -> None:
    assert read(tmp_path, WALK).unit == "centimetres"
    giant = "\n".join(
        "OFFSET " + " ".join(str(5 * float(word)) for word in line.split()[1:]) if line.startswith("OFFSET") else line
        for line in HEAD.splitlines()
    )
    text = giant + WALK[len(HEAD) - 1 :]
    with pytest.raises(InvalidInputError, match=r"leg is 4\d\d units.*--scale 0\.00"):
        read(tmp_path, text)
    assert read(tmp_path, text, scale=0.002).unit == "0.002 m"


# skeletons


def test_zero_position_channels_mean_the_offset(tmp_path: Path) -> None:
    found = read(tmp_path, replace(EXPORTERS["Mixamo"], positions="zero").text(31))
    assert any("their OFFSET is used" in warning for warning in found.warnings)
    assert np.linalg.norm(found.joints - TRUTH, axis=-1).max() <= 0.01


@pytest.mark.parametrize(
    ("change", "message"),
    [
        # a body in one point
        (lambda text: re.sub(r"OFFSET \S+ \S+ \S+", "OFFSET 0 0 0", text), "lies on"),
        (lambda text: text.replace("OFFSET 0.000000 -6.000000 12.000000", "OFFSET 0 0 0"), r"left_foot \(.*ToeBase\)"),
    ],
)
def test_bones_without_length_are_refused_by_name(tmp_path: Path, change: object, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        read(tmp_path, change(WALK))  # type: ignore[operator]


def test_one_joint_mapped_twice_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match=r"left_foot .* lies on left_ankle .*--map"):
        read(tmp_path, WALK, joint_sources={"left_foot": "LeftFoot"})


def test_a_map_of_names_that_are_known_anyway_changes_nothing(tmp_path: Path) -> None:
    entries = {
        "pelvis": "hip",
        "left_ankle": "lfoot",
        "left_wrist": "lhand",
        "right_ankle": "rfoot",
        "right_wrist": "rhand",
    }
    text = EXPORTERS["MakeHuman"].text(31)
    mapped, plain = read(tmp_path, text, joint_sources=entries), read(tmp_path, text)
    np.testing.assert_array_equal(mapped.joints, plain.joints)
    foot = JOINT_NAMES.index("left_foot")
    assert np.linalg.norm(mapped.joints[:, foot] - TRUTH[:, foot], axis=-1).max() <= 0.01


def test_stretching_bones_are_refused_by_name_and_time(tmp_path: Path) -> None:
    text = replace(EXPORTERS["Mixamo"], positions="all").text(31)
    head, motion = text.split("MOTION\n")
    lines = motion.splitlines()
    names = [line.split()[1] for line in head.splitlines() if line.startswith(("ROOT", "JOINT"))]
    column = 6 * names.index("mixamorig:LeftLeg") + 1
    words = lines[12].split()
    words[column] = str(2 * float(words[column]))
    lines[12] = " ".join(words)
    with pytest.raises(
        InvalidInputError, match=r"left_hip .*left_knee \(mixamorig:LeftLeg\) stretches from 40 to 80.* 0\.33 s"
    ):
        read(tmp_path, head + "MOTION\n" + "\n".join(lines))


def test_missing_toes_are_taken_from_end_sites_and_the_error_names_them(tmp_path: Path) -> None:
    found = read(tmp_path, EXPORTERS["Biovision"].text(31))
    foot = JOINT_NAMES.index("left_foot")
    assert np.linalg.norm(found.joints[:, foot] - TRUTH[:, foot], axis=-1).max() <= 0.01
    strange = WALK.replace("LeftToeBase", "Lump")
    with pytest.raises(InvalidInputError, match=r"left_foot.*NAME\.end is the End Site of NAME"):
        read(tmp_path, strange)
    assert read(tmp_path, strange, joint_sources={"left_foot": "Lump"}).names.startswith("Mixamo")


# frames


def test_a_frame_more_is_taken_with_a_warning_and_less_is_refused(tmp_path: Path) -> None:
    found = read(tmp_path, with_rows(ROWS, len(ROWS) - 1))
    assert found.frames == 31
    assert any("says 30 frames and holds 31" in warning for warning in found.warnings)
    for frames in (29, 32):
        with pytest.raises(InvalidInputError, match="cut short or mixed up"):
            read(tmp_path, with_rows(ROWS, frames))


@pytest.mark.parametrize("held", [1, 3])
def test_a_pose_before_the_motion_is_cut(tmp_path: Path, held: int) -> None:
    pose = " ".join([*ROWS[0].split()[:3], *["0"] * (len(ROWS[0].split()) - 3)])
    found = read(tmp_path, with_rows([pose] * held + ROWS))
    assert any(f"{held} frame" in warning and "cut" in warning for warning in found.warnings)
    assert np.linalg.norm(found.joints - TRUTH, axis=-1).max() <= 0.01
    speed = np.linalg.norm(np.diff(found.joints, axis=0), axis=-1) * 20
    assert speed.max() < 6


def test_motion_that_starts_fast_is_not_cut() -> None:
    joints = true_joints(40)
    assert motion_start(joints, 20.0) == 0
    assert len(find_jumps(joints, 20.0)) == 0
    joints[20:] += [0, 0, 1.5]
    assert list(find_jumps(joints, 20.0)) == [19]


@pytest.mark.parametrize("seconds", ["30", "1e6", "1e9", "1e300", "0.0001", "5e-324"])
def test_frame_rates_outside_5_to_1000_are_refused(tmp_path: Path, seconds: str) -> None:
    with pytest.raises(InvalidInputError, match=r"Frame Time is .*frames per second, not 5 to 1000"):
        read(tmp_path, WALK.replace("Frame Time: 0.0333333", f"Frame Time: {seconds}"))


def test_sizes_are_refused_before_anything_is_allocated(tmp_path: Path) -> None:
    empty = "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\n}\nMOTION\nFrames: 1000000000\nFrame Time: 0.05\n"
    with pytest.raises(InvalidInputError, match="1,000,000,000 frames of 1 joints"):
        parse_bvh(empty)
    with pytest.raises(InvalidInputError, match="frames of"):
        parse_bvh(empty.replace("1000000000", "9" * 400))
    with pytest.raises(InvalidInputError, match="at least 2,001 joints"):
        parse_bvh("HIERARCHY\n" + "JOINT a\n{\nOFFSET 0 0 0\n" * 3000 + "}\n" * 3000 + "MOTION\n")
    recording = read_recording(_write(tmp_path, WALK))
    pose = recording.sample(np.zeros(1))[0]
    still = replace(
        recording,
        frames=MAX_POINTS // len(pose) // 20,
        fps=5.0,
        sample=lambda times: np.broadcast_to(pose, (len(times), *pose.shape)),
    )
    with pytest.raises(InvalidInputError, match=r"at 240 frames per second \(--fps\)"):
        understand(still, Stated(), 240.0)


# spelling


@pytest.mark.parametrize("name", ["CR", "CRLF", "glued", "comma", "BOM", "Latin-1", "wrapped", "tabs"])
def test_other_spellings_are_read(tmp_path: Path, name: str) -> None:
    texts = {
        "CR": WALK.replace("\n", "\r"),
        "CRLF": WALK.replace("\n", "\r\n"),
        "glued": WALK.replace("Frames: ", "Frames:").replace("Frame Time: ", "Frame Time:"),
        "comma": re.sub(r"(\d)\.(\d)", r"\1,\2", WALK),
        "BOM": "\ufeff" + WALK,
        "wrapped": WALK.replace(ROWS[3], ROWS[3].replace(" ", "\n")),
        "tabs": WALK.replace(" ", "\t").replace("Frame\tTime", "Frame Time"),
    }
    text = WALK.replace("mixamorig:Hips", "H\xfcfte").encode("latin-1") if name == "Latin-1" else texts[name]
    stated = {"joint_sources": {"pelvis": "H\ufffdfte"}} if name == "Latin-1" else {}
    found = read(tmp_path, text, **stated)
    assert np.linalg.norm(found.joints - TRUTH, axis=-1).max() <= 0.01


def test_other_encodings_are_refused_with_the_reason(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="UTF-16; save it as UTF-8"):
        read(tmp_path, WALK.encode("utf-16"))
    with pytest.raises(InvalidInputError, match="numbers only"):
        read(tmp_path, WALK.replace(ROWS[3], ROWS[3].replace(".", ",")))


@pytest.mark.parametrize(
    ("text", "captions"),
    [
        ('file,caption\na.bvh,"a person walks\nforward"\n', ("a person walks forward",)),
        ('file,caption\r\na.bvh,"a person\r\n\r\nwalks"\r\n', ("a person walks",)),
        ("file;caption\na.bvh;a person walks\n", ("a person walks",)),
        ("a.bvh;walks, then bows\n", ("walks, then bows",)),
        ("a.bvh,walks; then bows\n", ("walks; then bows",)),
        ("file\tcaption\na.bvh\twalks, bows; runs\n", ("walks, bows; runs",)),
        ('"a.bvh";"walks, ""slowly"""\n', ('walks, "slowly"',)),
    ],
)
def test_tables_of_other_programs_are_read(tmp_path: Path, text: str, captions: tuple[str, ...]) -> None:
    (tmp_path / "c.csv").write_text(text, newline="")
    assert read_captions(tmp_path / "c.csv") == {"a.bvh": captions}


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("c.csv", "file;caption\na.bvh;walks;bows\n", r"line 2: 3 columns .*separated by a semicolon"),
        ("c.csv", "file caption\n", r"1 columns .*separated by a comma"),
        ("c.jsonl", '{"file": "walk.bvh", "caption": "\\ud800 walks"}', r"U\+D800 is no text"),
        ("c.jsonl", '{"file": "\\udfff.bvh", "caption": "walks"}', r"U\+DFFF is no text"),
        ("c.jsonl", '{"file": "walk.bvh", "caption": "walks\\u0000"}', r"U\+0000 is no text"),
        ("c.jsonl", '{"file": ' + "9" * 5000 + "}", "no JSON"),
        ("c.jsonl", "[" * 100_000, "no JSON"),
        ("c.jsonl", '{"file": "walk.bvh", "caption": "a", "captions": ["b"]}', "either caption or captions"),
        ("c.jsonl", '{"file": "walk.bvh", "caption": "a", "start": 3}', "'start'"),
    ],
)
def test_captions_that_are_no_text_are_refused_before_anything_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, text: str, message: str
) -> None:
    write_bvh_folder(tmp_path, {"walk.bvh": WALK})
    (tmp_path / name).write_text(text)
    paths = ["--bvh", str(tmp_path / "bvh"), "--captions", str(tmp_path / name), "--out", str(tmp_path / "out")]
    assert main(paths) == 2
    assert re.search(message, capsys.readouterr().err)
    assert not (tmp_path / "out").exists()


def test_random_damage_ends_in_joints_or_in_our_error(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    data = WALK.encode()
    words = [
        b"nan",
        b"-",
        b"1e400",
        b"{",
        b"}",
        b"JOINT",
        b"End Site",
        b"OFFSET",
        b"\n",
        b"\0",
        b"\xff",
        b"9" * 400,
        b",",
    ]
    outcomes = {True: 0, False: 0}
    for number in range(60):
        broken = bytearray(data)
        for at in rng.integers(0, len(HEAD) + 200 if number % 2 else len(data), size=int(rng.integers(1, 4))):
            if number % 3:
                broken[at : at + int(rng.integers(0, 30))] = words[int(rng.integers(len(words)))]
            elif chr(broken[at]).isdigit():
                broken[at] = ord("0") + int(rng.integers(10))
        try:
            joints = read(tmp_path, bytes(broken)).joints
            assert np.isfinite(joints).all()
            outcomes[True] += 1
        except InvalidInputError as error:
            assert len(str(error)) < 4000
            outcomes[False] += 1
    assert min(outcomes.values()) > 5


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_pipes_are_refused_and_not_waited_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = write_bvh_folder(tmp_path, {"walk.bvh": WALK})
    os.mkfifo(tmp_path / "c.jsonl")
    assert main([*arguments[:3], str(tmp_path / "c.jsonl"), *arguments[4:]]) == 2
    os.mkfifo(tmp_path / "bvh" / "pipe.bvh")
    assert main(arguments) == 2
    assert main([*arguments, "--map", str(tmp_path / "c.jsonl")]) == 2
    error = capsys.readouterr().err
    assert error.count("pipe") >= 3


# lengths


def test_the_limits_are_those_of_training() -> None:
    assert (DataConfig().min_frames, DataConfig().max_frames) == (MIN_FRAMES, MAX_FRAMES)


@pytest.mark.parametrize("frames", [16, 196, 197, 198, 250, 393, 1000, 3001])
def test_windows_cover_a_clip_without_gaps_and_fit_training(frames: int) -> None:
    rng = np.random.default_rng(frames)
    joints = np.cumsum(rng.normal(scale=0.01, size=(frames, 22, 3)), axis=0)
    windows = cut_windows(joints)
    assert [first for first, _ in windows] == [0, *(end for _, end in windows[:-1])]
    assert windows[-1][1] == frames
    assert all(MIN_FRAMES <= end - first <= MAX_FRAMES for first, end in windows)


def test_windows_end_where_the_body_rests() -> None:
    speed = np.ones(300)
    speed[140:150] = 0.0
    joints = np.zeros((300, 22, 3))
    joints[..., 2] = np.cumsum(speed)[:, None] * 0.05
    assert [140 <= end <= 151 for _, end in cut_windows(joints)[:-1]] == [True]


@pytest.mark.parametrize(
    ("caption", "holds"),
    [
        ("a person walks forward", True),
        ("someone dances wildly", True),
        ("a woman walks in a circle, slowly", True),
        ("a person walks, then bows", False),
        ("a man sits down", False),
        ("a man walks and waves", False),
        ("she jumps three times", False),
        ("first he runs", False),
        ("a person starts to run", False),
    ],
)
def test_captions_that_hold_at_any_moment(caption: str, holds: bool) -> None:
    assert holds_at_any_moment(caption) is holds


def long_text(seconds: float) -> str:
    return EXPORTERS["Mixamo"].text(int(30 * seconds))


def test_long_clips_become_windows_of_one_split(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = write_bvh_folder(tmp_path, {"long.bvh": long_text(21), "walk.bvh": WALK}, {"walk.bvh": "walks"})
    with (tmp_path / "c.csv").open("a") as file:
        file.write('long.bvh,a person walks\nlong.bvh,"a person walks, then stops"\n')
    assert main([*arguments, "--val", "0.4", "--test", "0"]) == 0
    printed = capsys.readouterr().out
    assert "21.0 s are 3 windows" in printed
    assert "not kept for them: 'a person walks, then stops'" in printed
    index = [json.loads(line) for line in (tmp_path / "out" / "index.jsonl").read_text().splitlines()]
    windows = [row for row in index if row["source_file"] == "long.bvh"]
    assert [row["id"] for row in windows] == ["long#1", "long#2", "long#3"]
    assert len({row["split"] for row in windows}) == 1
    assert sum(row["frames"] for row in windows) == 420
    starts = np.cumsum([0, *(row["frames"] for row in windows[:-1])]) / 20
    assert [row["start"] for row in windows] == pytest.approx(starts.tolist())
    clips = {clip.id: clip for split in ("train", "val") for clip in read_split(tmp_path / "out", split)}
    assert clips["long#2"].captions == ("a person walks",)
    assert clips["long#2"].any_length
    assert not clips["walk"].any_length
    np.testing.assert_allclose(clips["long#2"].joints[0, 0, [0, 2]], 0, atol=1e-4)


def test_long_clips_without_a_caption_that_holds_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = write_bvh_folder(tmp_path, {"long.bvh": long_text(11)}, {"long.bvh": "a person walks and then stops"})
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert "long.bvh: 11.0 s are 2 windows" in error
    assert "'a person walks and then stops'" in error
    assert main([*arguments, "--captions-hold"]) == 0


def test_short_clips_are_named_file_by_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    short = with_rows(ROWS[:22])
    error = error_of(tmp_path, capsys, {"a.bvh": short, "b.bvh": short, "ok.bvh": WALK})
    assert "2 of 3 files" in error
    assert "a.bvh: 15 frames are too short" in error
    assert "b.bvh: 15 frames" in error


# nothing without a word, nothing half


def test_files_that_are_not_read_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = write_bvh_folder(tmp_path, {"walk.bvh": WALK})
    for name in ("a.fbx", "b.fbx", "c.c3d", "notes.txt"):
        (tmp_path / "bvh" / name).write_text("x")
    assert main(arguments) == 0
    assert "left out: 1 .c3d, 2 .fbx are not read" in capsys.readouterr().err
    (tmp_path / "bvh" / "walk.bvh").unlink()
    assert main([*arguments, "--force"]) == 2
    assert "holds no .bvh or .glb files: 1 .c3d, 2 .fbx" in capsys.readouterr().err


def test_skip_broken_leaves_out_everything_that_is_ours(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = {
        "ok.bvh": WALK,
        "lie.bvh": lying().replace("-90", "-45"),
        "short.bvh": with_rows(ROWS[:9]),
        "slow.bvh": WALK.replace("0.0333333", "1e9"),
        "huge.bvh": WALK.replace("Frames: 31", "Frames: 99999999999"),
        "mirrored.bvh": replace(EXPORTERS["Mixamo"], mirrored=True).text(31),
        "empty.bvh": "",
        "long.bvh": long_text(11),
    }
    captions = dict.fromkeys(files, "a person moves") | {"long.bvh": "runs then walks"}
    assert prepared(tmp_path, files, "--skip-broken", captions=captions) == 0
    error = capsys.readouterr().err
    for name in set(files) - {"ok.bvh", "lie.bvh"}:
        assert f"left out: {name}: " in error
    assert {"ok"} <= {clip.id for clip in read_split(tmp_path / "out", "train")} <= {"ok", "lie"}


def test_the_table_comes_before_anything_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert prepared(tmp_path, {"walk.bvh": WALK, "box/z.bvh": EXPORTERS["Rigify"].text(48)}) == 0
    heading, box, walk, *_ = capsys.readouterr().out.splitlines()
    assert heading.split() == ["file", "frames", "fps", "seconds", "clips", "up", "facing", "unit", "height", "names"]
    assert box.split()[:8] == ["box/z.bvh", "48", "24", "2.0", "1", "z", "-y", "metres"]
    assert walk.split()[:8] == ["walk.bvh", "31", "30", "1.0", "1", "y", "z", "centimetres"]


@pytest.mark.parametrize("exists", [False, True])
@pytest.mark.parametrize("fails_at", ["train.npz", "index.jsonl"])
def test_a_folder_is_written_whole_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, exists: bool, fails_at: str
) -> None:
    out = tmp_path / "out"
    if exists:
        assert prepared(tmp_path, {"old.bvh": WALK}) == 0
        (out / "mine.txt").write_text("keep")
        (tmp_path / "bvh" / "old.bvh").unlink()
    before = {path.name: path.read_bytes() for path in out.iterdir()} if exists else None
    write = data_folder.write_atomically

    def full(path: Path, data: bytes) -> None:
        if path.name == fails_at:
            raise OutputError("no space") from OSError(28, "No space left on device")
        write(path, data)

    monkeypatch.setattr(data_folder, "write_atomically", full)
    assert prepared(tmp_path, {"new.bvh": WALK}, "--force") == 2
    assert ({path.name: path.read_bytes() for path in out.iterdir()} if out.exists() else None) == before
    monkeypatch.undo()
    rename = Path.rename
    monkeypatch.setattr(Path, "rename", lambda self, to: _broken(self, fails_at) or rename(self, to))
    if exists:
        assert prepared(tmp_path, {"new.bvh": WALK}, "--force") == 2
        assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    monkeypatch.undo()
    assert prepared(tmp_path, {"new.bvh": WALK}, "--force") == 0
    assert [clip.id for clip in read_split(out, "train")] == ["new"]
    assert not [path for path in (*tmp_path.iterdir(), *out.iterdir()) if path.suffix == ".tmp"]
    assert (out / "mine.txt").exists() == exists


def _broken(path: Path, name: str) -> None:
    if path.name == name and path.parent.name.endswith(".tmp") and "-old" not in path.parent.name:
        raise OSError(5, "Input/output error")


def test_the_preview_shows_what_was_understood(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    arguments = write_bvh_folder(tmp_path, {"walk.bvh": WALK, "b.bvh": bvh_text()[0]})
    sheet = tmp_path / "sheet.png"
    assert main([*arguments[:4], "--preview", str(sheet)]) == 0
    assert sheet.read_bytes().startswith(b"\x89PNG")
    assert "2 of 2 clips" in capsys.readouterr().out
    assert not (tmp_path / "out").exists()
    assert main([*arguments[:4], "--preview", str(sheet)]) == 2
    assert "sheet.png' exists" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(arguments[:4])


# the files of the cases themselves


READ = (
    "ok_reference", "one_frame_more", "tpose_first", "six_channels_zero", "xsens_names", "biped_names", "unity_names",
    "classic_no_toes", "makehuman_names", "cr_line_ends", "frames_glued", "comma_decimals",
)  # fmt: skip


@pytest.mark.parametrize("name", READ)
def test_cases_that_are_read_give_the_reference(name: str) -> None:
    path = shared_path("cases", f"{name}.bvh")
    found, truth = (
        understand(read_recording(file), Stated(), 30.0) for file in (path, path.parent / "ok_reference.bvh")
    )
    limbs = [joint for joint, label in enumerate(JOINT_NAMES) if not label.startswith("spine")]
    if name in ("classic_no_toes",):  # its End Site lies elsewhere
        limbs = [joint for joint in limbs if not JOINT_NAMES[joint].endswith("foot")]
    expected = canonicalise(truth.joints[1:]) if name == "tpose_first" else truth.joints
    away = found.joints - expected
    away[..., 1] -= away[:, :1, 1]  # the floor is that of the toes
    assert np.linalg.norm(away, axis=-1)[:, limbs].max() <= 0.03


@pytest.mark.parametrize(("name", "message"), [("mirrored", "--handedness left"), ("frame_time_is_fps", "5 to 1000")])
def test_cases_that_are_refused(name: str, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        understand(read_recording(shared_path("cases", f"{name}.bvh")), Stated(), 20.0)


def test_cases_of_up_and_lengths(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cases = shared_path("cases", "z_up_on_the_spot.bvh").parent
    assert understand(read_recording(cases / "z_up_on_the_spot.bvh"), Stated(), 20.0).up == "z"
    for name, code in (("long_clips", 0), ("short_clips", 2)):
        folder = cases / name
        out = tmp_path / name
        assert main(["--bvh", str(folder), "--captions", str(folder / "captions.csv"), "--out", str(out)]) == code
    assert "short0.bvh: 13 frames are too short" in capsys.readouterr().err


def test_cases_of_reliability(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for folder in sorted(shared_path("cases", "reliability", "prepare").iterdir()):
        captions = next(path for path in folder.iterdir() if path.is_file())
        out = tmp_path / folder.name
        assert main(["--bvh", str(folder / "bvh"), "--captions", str(captions), "--out", str(out)]) == 2
        assert capsys.readouterr().err.count("error:") == 1
        assert not out.exists()
    shutil.rmtree(tmp_path / "out", ignore_errors=True)


def _write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "walk.bvh"
    path.write_text(text)
    return path
