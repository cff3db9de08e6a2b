"""A folder of BVH files and captions becomes training data; every fault is named by file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from kinegraph.clip import Clip
from kinegraph.errors import InvalidInputError, OutputError
from kinegraph.motion.skeleton import canonicalise
from kinegraph_training.data.bvh import parse_bvh
from kinegraph_training.data.captions_file import match_captions, read_captions
from kinegraph_training.data.clips import read_split
from kinegraph_training.data.folder import assign_splits
from kinegraph_training.prepare import PrepareOptions, clip_joints, main, prepare
from support.bvh_files import bvh_text, prepare_joints, write_bvh_folder
from support.shared import shared_path

GOOD = bvh_text()[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no BVH file"),
        ("HIERARCHY\nROOT a\n", "no BVH file"),
        (GOOD.replace("HIERARCHY", "HIERACHY"), "no BVH file"),
        (GOOD.replace("ROOT Hips", "RUT Hips"), "outside of every joint|no line"),
        (GOOD.replace("OFFSET", "OFSET", 1), "OFSET"),
        (GOOD.replace("OFFSET 1 2 3", "OFFSET 1 2"), "OFFSET of 'Hips'.*three numbers"),
        (GOOD.replace("OFFSET 1 2 3", "OFFSET 1 nan 3"), "OFFSET of 'Hips'.*finite"),
        (GOOD.replace("OFFSET 1 2 3\n", ""), "'Hips' has no OFFSET"),
        (GOOD.replace("CHANNELS 6", "CHANNELS 5"), "CHANNELS of 'Hips'"),
        (GOOD.replace("Zrotation", "Wrotation", 1), "CHANNELS of 'Hips'"),
        (GOOD.replace("Zrotation", "Yrotation", 1), "CHANNELS of 'Hips'"),
        (GOOD.replace("}\nMOTION", "MOTION"), "cut short"),
        (GOOD.replace("Frames: 30", "Frames: 31"), "31 frames of 69 channels are 2139 numbers.*2070"),
        (GOOD.replace("Frames: 30", "Frames: 0"), "above 0"),
        (GOOD.replace("Frames: 30", "Frames: many"), "Frames: N"),
        (GOOD.replace("Frame Time: 0.05", "Frame Time: -0.05"), "above 0"),
        (GOOD[: len(GOOD) // 2 * 2 - 400], "cut short"),
        (GOOD.rpartition(" ")[0] + " nan\n", "not finite"),
        (GOOD.replace("95.", "95,"), "numbers only"),
    ],
)
def test_broken_files_are_refused_by_name(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InvalidInputError, match=rf"one\.bvh: .*({message})"):
        prepare_joints(tmp_path, text)


def test_a_clip_of_one_frame_or_far_too_large_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="two frames"):
        prepare_joints(tmp_path, bvh_text(frames=1)[0])
    with pytest.raises(InvalidInputError, match=r"3\.2 m"):
        prepare_joints(tmp_path, GOOD, scale=1.0)
    with pytest.raises(InvalidInputError, match=r"absent\.bvh: it cannot be read"):
        clip_joints(tmp_path / "absent.bvh", PrepareOptions())


def test_a_joint_may_be_called_motion() -> None:
    motion = parse_bvh(GOOD.replace("ROOT Hips", "ROOT MOTION Hips").replace("\n", "\r\n"))
    assert motion.names[0] == "MOTION Hips"
    assert "Head.end" in motion.names


def test_a_folder_becomes_training_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = {f"{'walks/' if n % 2 else ''}clip{n}.bvh": bvh_text(frames=20 + n) for n in range(12)}
    arguments = write_bvh_folder(tmp_path, {name: text for name, (text, _) in files.items()})
    assert main([*arguments, "--val", "0.2", "--test", "0.2"]) == 0
    assert "12 clips" in capsys.readouterr().out
    clips = {clip.id: clip for split in ("train", "val", "test") for clip in read_split(tmp_path / "out", split)}
    assert sorted(clips) == sorted(name.removesuffix(".bvh") for name in files)
    for name, (_, places) in files.items():
        clip = clips[name.removesuffix(".bvh")]
        assert clip.captions == ("a person moves",)
        np.testing.assert_allclose(clip.joints, canonicalise(places / 100), atol=1.5e-4)
    index = [json.loads(line) for line in (tmp_path / "out" / "index.jsonl").read_text().splitlines()]
    assert index[0] == {
        "id": "clip0",
        "frames": 20,
        "fps": 20,
        "source_file": "clip0.bvh",
        "split": index[0]["split"],
    }
    assert {row["split"] for row in index} == {"train", "val", "test"}
    for split in ("train", "val", "test"):
        ids = [row["id"] for row in index if row["split"] == split]
        assert ids == [clip.id for clip in read_split(tmp_path / "out", split)]
    with np.load(tmp_path / "out" / "train.npz", allow_pickle=False) as pack:
        assert pack["joints"].dtype == np.int16
        assert pack["root_xz"].dtype == np.float32
        assert pack["fps"] == 20
        assert pack["offsets"][-1] == len(pack["joints"]) == len(pack["root_xz"])
        assert not pack["joints"][:, 0, [0, 2]].any()


def test_our_own_files_come_back(tmp_path: Path) -> None:
    path = shared_path("data", "bandai", "val.npz")
    for clip in read_split(path.parent, "val")[::16]:
        saved = Clip(joints=clip.joints, fps=20.0, seed=0, text="x", bundle="b")
        saved.save(tmp_path / f"{clip.id}.bvh")
        back = clip_joints(tmp_path / f"{clip.id}.bvh", PrepareOptions())
        assert np.linalg.norm(back - canonicalise(clip.joints), axis=-1).max() <= 2e-3


def test_a_made_up_clip_of_our_own_comes_back(tmp_path: Path) -> None:
    _, places = bvh_text(frames=40)
    joints = canonicalise(places / 100)
    Clip(joints=joints, fps=60.0, seed=0, text="x", bundle="b").save(tmp_path / "x.bvh")
    back = clip_joints(tmp_path / "x.bvh", PrepareOptions(fps=60.0))
    assert np.linalg.norm(back - joints, axis=-1).max() <= 2e-3


def test_splits_depend_on_the_name_alone() -> None:
    ids = [f"clip{number}" for number in range(2000)]
    splits = assign_splits(ids, val=0.1, test=0.05)
    counts = {split: sum(assigned == split for assigned in splits.values()) for split in ("train", "val", "test")}
    assert 150 < counts["val"] < 250
    assert 60 < counts["test"] < 140
    fewer = assign_splits(ids[::2], val=0.1, test=0.05)
    assert all(splits[name] == fewer[name] for name in fewer)


def test_small_data_still_gets_a_validation_clip() -> None:
    assert sorted(assign_splits(["a", "b", "c"], val=0.001, test=0.001).values()) == ["test", "train", "val"]
    assert assign_splits(["a"], val=0.05, test=0.05) == {"a": "train"}
    assert set(assign_splits(["a", "b"], val=0.0, test=0.0).values()) == {"train"}


def write(tmp_path: Path, name: str, text: str) -> Path:
    (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path / name


def test_captions_of_all_kinds(tmp_path: Path) -> None:
    expected = {"a.bvh": ("walks, then bows", "bows"), "b": ("runs",)}
    lines = '{"file": "a.bvh", "captions": ["walks, then  bows", "bows"]}\n\n{"file": "b", "caption": "runs"}\n'
    assert read_captions(write(tmp_path, "c.jsonl", lines)) == expected
    rows = '\ufefffile,caption\na.bvh,"walks, then bows"\na.bvh,bows\nb, runs \n'
    assert read_captions(write(tmp_path, "c.csv", rows)) == expected
    tabs = "a.bvh\twalks, then bows\na.bvh\tbows\nb\truns\n"
    assert read_captions(write(tmp_path, "c.tsv", tabs)) == expected


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("c.txt", "a,b", r"\.jsonl, \.csv, \.tsv"),
        ("c.csv", "", "no captions"),
        ("c.csv", "file,caption\na.bvh,walks, then bows\n", "line 2: 3 columns"),
        ("c.csv", "a.bvh,\n", "line 1: the caption ''"),
        ("c.csv", "a.bvh,!!!\n", "must have words"),
        ("c.csv", f"a.bvh,{'x' * 513}\n", "512 characters"),
        ("c.csv", ",walks\n", "no file is named"),
        ("c.jsonl", "{", "line 1: no JSON"),
        ("c.jsonl", '{"file": "a"}', "line 1: must be"),
        ("c.jsonl", '{"file": "a", "captions": []}', "line 1: must be"),
        ("c.jsonl", '{"file": "a", "captions": ["x", 3]}', "line 1: must be"),
        ("c.jsonl", '{"file": 3, "captions": ["x"]}', "line 1: must be"),
    ],
)
def test_bad_captions_files(tmp_path: Path, name: str, text: str, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        read_captions(write(tmp_path, name, text))


def test_captions_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "c.csv").write_bytes(b"a.bvh,caf\xe9\n")
    for name in ("c.csv", "absent.csv"):
        with pytest.raises(InvalidInputError, match=name):
            read_captions(tmp_path / name)


def test_captions_find_their_files() -> None:
    captions = {"deep/a.BVH": ("x",), "b": ("y",), ".\\deep\\c.bvh": ("z",), "a": ("w",), "b.bvh": ("v",)}
    assert match_captions(captions, ["deep/a", "deep/b", "deep/c"]) == {
        "deep/a": ("x", "w"),
        "deep/b": ("y", "v"),
        "deep/c": ("z",),
    }
    with pytest.raises(InvalidInputError, match=r"captions without a file: d.*files without a caption: a, b"):
        match_captions({"d": ("x",)}, ["b", "a"])
    with pytest.raises(InvalidInputError, match=r"a\.bvh \(which of one/a, two/a\?\)"):
        match_captions({"a.bvh": ("x",), "one/a": ("y",), "two/a": ("z",)}, ["one/a", "two/a"])


@pytest.mark.parametrize(
    ("files", "captions", "extra", "message"),
    [
        ({"a.bvh": GOOD, "b.bvh": "junk"}, None, [], "b.bvh: no BVH file"),
        ({"a.bvh": GOOD}, {"a.bvh": "x", "z.bvh": "y"}, [], "captions without a file: z.bvh"),
        ({"a.bvh": GOOD, "b.bvh": GOOD}, {"a.bvh": "x"}, [], "without a caption: b"),
        ({"a.bvh": GOOD, "a.BVH": GOOD}, None, [], "same id"),
        ({"a.txt": GOOD}, None, [], "no .bvh or .glb files"),
        ({"a.bvh": GOOD}, None, ["--fps", "0"], "--fps"),
        ({"a.bvh": GOOD}, None, ["--fps", "1e9"], "--fps"),
        ({"a.bvh": GOOD}, None, ["--fps", "nan"], "--fps"),
        ({"a.bvh": GOOD}, None, ["--scale", "-1"], "--scale"),
        ({"a.bvh": GOOD}, None, ["--val", "0.6", "--test", "0.5"], "--val"),
        ({"a.bvh": GOOD}, None, ["--val", "nan"], "--val"),
        ({"a.bvh": GOOD}, None, ["--map", "absent.json"], "absent.json"),
        ({"a.bvh": "junk"}, None, ["--skip-broken"], "a.bvh"),
    ],
)
def test_the_command_line_says_what_is_wrong_and_writes_nothing(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    files: dict[str, str],
    captions: dict[str, str] | None,
    extra: list[str],
    message: str,
) -> None:
    assert main([*write_bvh_folder(tmp_path, files, captions), *extra]) == 2
    error = capsys.readouterr().err
    assert error.count("error:") == 1
    assert message in error
    assert not (tmp_path / "out").exists()


def test_broken_files_can_be_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = write_bvh_folder(tmp_path, {"a.bvh": GOOD, "b.bvh": "junk", "c.bvh": GOOD})
    assert main([*arguments, "--skip-broken", "--val", "0", "--test", "0"]) == 0
    assert "left out" in capsys.readouterr().err
    assert [clip.id for clip in read_split(tmp_path / "out", "train")] == ["a", "c"]
    assert read_split(tmp_path / "out", "val") == []


def test_data_is_not_overwritten_unless_asked(tmp_path: Path) -> None:
    arguments = write_bvh_folder(tmp_path, {"a.bvh": GOOD, "b.bvh": GOOD})
    paths = [tmp_path / "bvh", tmp_path / "c.csv", tmp_path / "out"]
    prepare(*paths, PrepareOptions())
    before = (tmp_path / "out" / "index.jsonl").read_bytes()
    (tmp_path / "bvh" / "b.bvh").write_text(bvh_text(frames=19)[0])
    with pytest.raises(OutputError, match="--force"):
        prepare(*paths, PrepareOptions())
    assert (tmp_path / "out" / "index.jsonl").read_bytes() == before
    assert main([*arguments, "--force"]) == 0
    assert (tmp_path / "out" / "index.jsonl").read_bytes() != before
    with pytest.raises(OutputError, match="is a file"):
        prepare(tmp_path / "bvh", tmp_path / "c.csv", tmp_path / "c.csv", PrepareOptions())
    with pytest.raises(InvalidInputError, match="no folder"):
        prepare(tmp_path / "absent", tmp_path / "c.csv", tmp_path / "other", PrepareOptions())
