"""AMASS in exactly its published folder, with body models of the published layout: SMPL-H and SMPL-X."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("tqdm")

from kinegraph.motion.skeleton import JOINTS, PARENTS, canonicalise
from kinegraph_training.data.clips import read_split
from kinegraph_training.data.smpl_body import from_axis_angle, read_body
from kinegraph_training.prepare import main
from support.exporters import true_joints
from support.published_sets import amass_arrays, write_body_model


def run(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


@pytest.fixture
def amass(tmp_path: Path) -> Path:
    """A folder with two files of two body models, and one that has no caption."""
    folder = tmp_path / "AMASS"
    for name, kind, fps in (("CMU/01/01_01_poses", "smplh", 120), ("BMLmovi/s1/walk_stageii", "smplx", 60)):
        (folder / name).parent.mkdir(parents=True)
        np.savez(folder / f"{name}.npz", **amass_arrays(int(4 * fps), fps, kind))
        write_body_model(tmp_path / "models", kind)
    np.savez(folder / "CMU/01/shape.npz", betas=np.zeros(16), gender="male")
    (tmp_path / "captions.csv").write_text(
        "CMU/01/01_01_poses.npz,a person walks and waves\nBMLmovi/s1/walk_stageii.npz,someone walks\n"
    )
    return folder


def options(folder: Path) -> tuple[object, ...]:
    top = folder.parent
    return (
        "--amass",
        folder,
        "--body-models",
        top / "models",
        "--captions",
        top / "captions.csv",
        "--out",
        top / "out",
    )


def test_joints_come_from_the_callers_body_model(amass: Path) -> None:
    assert run(*options(amass), "--test", 0) == 0
    out = amass.parent / "out"
    clips = {clip.id: clip for split in ("train", "val") for clip in read_split(out, split)}
    assert set(clips) == {"CMU/01/01_01_poses", "BMLmovi/s1/walk_stageii"}
    for clip in clips.values():
        np.testing.assert_allclose(clip.joints, canonicalise(true_joints(80)), atol=2e-4)
    assert clips["CMU/01/01_01_poses"].captions == ("a person walks and waves",)


def test_joints_against_matrices(tmp_path: Path) -> None:
    """J = R (T + B beta), then forward kinematics with Rodrigues' matrices, joint by joint."""
    model = write_body_model(tmp_path)
    rng = np.random.default_rng(5)
    shape, turns, root = rng.standard_normal(16), rng.standard_normal((2, JOINTS, 3)), rng.standard_normal((2, 3))
    rest = model["J_regressor"][:JOINTS] @ (model["v_template"] + model["shapedirs"] @ shape)
    body = read_body(tmp_path / "smplh" / "male" / "model.npz")
    result = body.joints(shape, turns, root)
    for frame in range(2):
        places, axes = [], []
        for joint, parent in enumerate(PARENTS):
            x, y, z = turns[frame, joint]
            angle = np.linalg.norm([x, y, z])
            k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) / angle
            local = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
            axes.append(local if parent < 0 else axes[parent] @ local)
            above = (
                root[frame] + rest[0] if parent < 0 else places[parent] + axes[parent] @ (rest[joint] - rest[parent])
            )
            places.append(above)
        np.testing.assert_allclose(result[frame], places, atol=1e-9)
    np.testing.assert_allclose(from_axis_angle(np.zeros((1, 3))), [[1, 0, 0, 0]])


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"poses": np.full((240, 156), np.nan)}, "poses or trans hold NaN"),
        ({"poses": np.zeros((240, 72))}, "poses have 156 (smplh) or 165 (smplx) columns"),
        ({"gender": np.array("robot")}, "gender is 'robot'"),
        ({"mocap_framerate": np.array(0.0)}, "mocap_framerate is 0"),
        ({"gender": np.array("female")}, "lacks the body model smplh, female"),
        ({"trans": None}, "it lacks trans"),
    ],
)
def test_files_that_are_something_else(
    tmp_path: Path, change: dict[str, np.ndarray | None], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    arrays = {**amass_arrays(240, 120), **change}
    (tmp_path / "AMASS").mkdir()
    np.savez(tmp_path / "AMASS" / "a.npz", **{name: value for name, value in arrays.items() if value is not None})
    write_body_model(tmp_path / "models")
    (tmp_path / "captions.csv").write_text("a,someone walks\n")
    assert run(*options(tmp_path / "AMASS")) == 2
    said = capsys.readouterr().err
    assert reason in said and "a.npz" in said


def test_models_and_captions_that_are_not_there(amass: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = amass.parent / "models" / "smplh" / "male" / "model.npz"
    model.with_suffix(".pkl").write_bytes(b"\x80")
    model.unlink()
    assert run(*options(amass)) == 2
    assert "as .pkl, which runs code when it is read; download the .npz" in capsys.readouterr().err
    (amass.parent / "captions.csv").write_text("CMU/02/02_01_poses,a person walks\n")
    assert run(*options(amass)) == 2
    assert "captions without a file below" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        run("--amass", amass, "--out", amass.parent / "out")
    assert "--amass needs --captions, --body-models" in capsys.readouterr().err
