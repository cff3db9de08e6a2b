"""HumanML3D and KIT-ML in exactly their published folders: captions with times, splits, bad files, both bodies."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("tqdm")

from kinegraph.motion.humanml3d import humanml3d_from_joints, joints_from_humanml3d
from kinegraph.motion.kit_ml import LEG_METRES, SOURCES
from kinegraph.motion.skeleton import JOINT_INDEX, canonicalise
from kinegraph_training.data.clips import read_split
from kinegraph_training.data.common_skeleton import BONE_LENGTHS
from kinegraph_training.data.humanml3d_reader import HUMANML3D, from_kit, read_stretches
from kinegraph_training.prepare import main
from support.motions import walk
from support.published_sets import write_guo_set


@pytest.fixture
def humanml3d(tmp_path: Path) -> Path:
    clips = {f"00000{index}": walk(120, turning=0.01 * index) for index in range(3)}
    vectors = {"M000001": humanml3d_from_joints(walk(120, turning=0.02))}
    return write_guo_set(tmp_path / "HumanML3D", clips, vectors)


def run(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


def test_clips_keep_their_splits_captions_and_motion(humanml3d: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run("--humanml3d", humanml3d, "--out", out) == 0
    clips = {clip.id: clip for split in ("train", "val", "test") for clip in read_split(out, split)}
    assert {clip.id for clip in read_split(out, "train")} == {
        name for whole in ("000000", "000001") for name in (whole, f"{whole}@2-5")
    }
    assert set(clips) == {n for whole in ("000000", "000001", "000002", "M000001") for n in (whole, f"{whole}@2-5")}
    assert clips["000000"].captions == ("a person walks forward", "someone walks ahead.")
    assert clips["000000@2-5"].captions == ("then the person turns", "a figure turns")
    # what happens within a clip is true of it, without being all of it
    assert clips["000000"].partial_captions == ("then the person turns", "a figure turns", "too short to tell")
    assert clips["000000@2-5"].partial_captions == ()
    assert len(clips["000000@2-5"].joints) == 60
    original = canonicalise(walk(120, turning=0.01))
    np.testing.assert_allclose(clips["000001"].joints, original, atol=2e-4)
    np.testing.assert_allclose(clips["000001@2-5"].joints, canonicalise(original[40:100]), atol=2e-4)


def test_vectors_stand_in_for_joints(humanml3d: Path, tmp_path: Path) -> None:
    assert run("--humanml3d", humanml3d, "--out", tmp_path / "out") == 0
    clip = next(clip for clip in read_split(tmp_path / "out", "test") if clip.id == "M000001")
    rows = np.load(humanml3d / "new_joint_vecs" / "M000001.npy")
    np.testing.assert_allclose(clip.joints, canonicalise(joints_from_humanml3d(rows)), atol=2e-4)


def test_bad_files_are_named_and_left_out_on_request(
    humanml3d: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = np.load(humanml3d / "new_joints" / "000000.npy")
    broken[3, 2] = np.nan
    np.save(humanml3d / "new_joints" / "000000.npy", broken)
    (humanml3d / "texts" / "000001.txt").unlink()
    assert run("--humanml3d", humanml3d, "--out", tmp_path / "out") == 2
    said = capsys.readouterr().err
    assert "2 of 4 clips cannot be used (--skip-broken leaves them out)" in said
    assert "000000.npy holds NaN or infinity" in said
    assert "000001.txt cannot be read" in said
    assert not (tmp_path / "out").exists()
    (humanml3d / "train.txt").write_text("000000\n000001\n000003\n000002\n")
    (humanml3d / "val.txt").write_text("M000001\n")
    (humanml3d / "test.txt").write_text("absent\n")
    assert run("--humanml3d", humanml3d, "--out", tmp_path / "out", "--skip-broken") == 0
    assert "left out: " in capsys.readouterr().err
    assert [clip.id for clip in read_split(tmp_path / "out", "train")] == ["000002", "000002@2-5"]


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("no hashes", "0 '#' instead of 3"),
        ("#x/NOUN#0.0#0.0", "a caption has words"),
        ("a#a/DET#zero#0.0", "could not convert"),
        ("a#a/DET#3.0#2.0", "3 to 2 seconds"),
        ("", "holds no captions"),
    ],
)
def test_lines_that_break_the_format(tmp_path: Path, line: str, reason: str) -> None:
    path = tmp_path / "x.txt"
    path.write_text(f"{line}\n")
    with pytest.raises(ValueError, match=reason):
        read_stretches(path)


def test_folders_of_something_else(tmp_path: Path, humanml3d: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--humanml3d", tmp_path / "absent", "--out", tmp_path / "out") == 2
    assert "--humanml3d names that of HumanML3D" in capsys.readouterr().err
    assert run("--kit", humanml3d, "--out", tmp_path / "out") == 2
    assert "KIT-ML has (frames, 21, 3)" in capsys.readouterr().err
    (humanml3d / "val.txt").write_text("000000\n")
    assert run("--humanml3d", humanml3d, "--out", tmp_path / "out") == 2
    assert "000000 is in train.txt too" in capsys.readouterr().err


def as_kit(joints: np.ndarray, unit: float) -> np.ndarray:
    """The joints of our body that KIT-ML has too, in other units; its others stand at their neighbours."""
    kit = np.zeros((len(joints), 21, 3), dtype=np.float32)
    kit[:, 14], kit[:, 19] = joints[:, JOINT_INDEX["right_foot"]], joints[:, JOINT_INDEX["left_foot"]]
    for name, sources in SOURCES.items():
        if len(sources) == 1:
            kit[:, sources[0]] = joints[:, JOINT_INDEX[name]]
    return kit * unit


def test_kit_comes_back_in_metres_at_our_rate() -> None:
    joints = walk(100)
    ours = from_kit(as_kit(joints, 400.0))
    assert ours.shape == (160, 22, 3)
    leg = [JOINT_INDEX[name] for name in ("right_hip", "right_knee", "right_ankle")]
    assert pytest.approx(float(BONE_LENGTHS[leg[1] - 1] + BONE_LENGTHS[leg[2] - 1])) == LEG_METRES
    length = sum(np.linalg.norm(ours[0, a] - ours[0, b]) for a, b in pairwise(leg))
    assert length == pytest.approx(float(BONE_LENGTHS[leg[1] - 1] + BONE_LENGTHS[leg[2] - 1]), rel=1e-3)
    # frames whose time is in both rates: every fifth of KIT-ML's is every eighth of ours
    scale = length / sum(np.linalg.norm(joints[0, a] - joints[0, b]) for a, b in pairwise(leg))
    for name in ("pelvis", "left_wrist", "right_foot", "head"):
        index = JOINT_INDEX[name]
        np.testing.assert_allclose(ours[8, index], joints[5, index] * scale, atol=2e-3)


def test_a_folder_of_kit(tmp_path: Path) -> None:
    motions = {f"0000{index}": as_kit(walk(60, turning=0.01 * index), 400.0) for index in range(3)}
    out = tmp_path / "out"
    assert run("--kit", write_guo_set(tmp_path / "KIT-ML", motions, {}), "--out", out) == 0
    (whole, *_) = read_split(out, "train")
    assert len(whole.joints) == 96
    assert HUMANML3D.shortest == 40
