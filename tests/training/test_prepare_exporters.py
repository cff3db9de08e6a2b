"""One motion in the forms of many programs comes out as the same joints, or with the right error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinegraph.errors import InvalidInputError
from kinegraph.motion.skeleton import JOINT_NAMES, PARENTS, bone_lengths, canonicalise
from kinegraph_training.data.bvh import read_recording
from kinegraph_training.data.understanding import Stated, Understood, understand
from support.exporters import EXPORTERS, Exporter, true_joints

SECONDS = 2.0
CLOSE, DEGREES = 0.01, 2.0


def read(tmp_path: Path, exporter: Exporter, **stated: object) -> Understood:
    path = tmp_path / "walk.bvh"
    path.write_text(exporter.text(int(SECONDS * exporter.fps) + 1))
    return understand(read_recording(path), Stated(**stated), 20.0)  # type: ignore[arg-type]


def expected(exporter: Exporter) -> np.ndarray:
    """The true joints; a T-pose before them takes one frame of the file away, and so the first of the result."""
    start = 1 / exporter.fps if exporter.tpose_first else 0.0
    fine = true_joints(int((SECONDS - start) * 20 + 1e-6) + 1) if not start else None
    if fine is None:
        dense = true_joints(int(SECONDS * exporter.fps) + 1, exporter.fps)[1:]
        fine = dense[:: round(exporter.fps / 20)]
    return canonicalise(fine)


def degrees_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    cosine = (first * second).sum(-1) / np.linalg.norm(first, axis=-1) / np.linalg.norm(second, axis=-1)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


@pytest.mark.parametrize("name", EXPORTERS)
def test_every_exporter_gives_the_true_joints(tmp_path: Path, name: str, figure: Callable[[str], None]) -> None:
    exporter = EXPORTERS[name]
    found, truth = read(tmp_path, exporter), expected(exporter)
    assert found.joints.shape == truth.shape
    exact = [
        joint for joint, label in enumerate(JOINT_NAMES) if label in exporter.names and label not in exporter.lies_on
    ]
    exact += [joint for joint, label in enumerate(JOINT_NAMES) if label.endswith("foot") and joint not in exact]
    away = np.linalg.norm(found.joints - truth, axis=-1)
    assert away[:, exact].max() <= CLOSE
    # joints that the skeleton lacks are put between their neighbours
    assert away.max() <= 0.12
    bones = [joint for joint in exact if joint and PARENTS[joint] in exact]
    parents = [PARENTS[joint] for joint in bones]
    angle = degrees_between(
        found.joints[:, bones] - found.joints[:, parents], truth[:, bones] - truth[:, parents]
    ).max()
    assert angle <= DEGREES
    lengths = np.abs(bone_lengths(found.joints) - bone_lengths(truth))[:, np.array(bones) - 1].max()
    assert lengths <= 0.002
    assert found.scale == pytest.approx(exporter.unit)
    assert found.up == ("y" if exporter.up == "y" else "z")
    assert found.fps == exporter.fps
    figure(f"{name}: {1000 * away[:, exact].max():.1f} mm, {angle:.2f} degrees")


def test_there_are_more_than_twenty() -> None:
    assert len(EXPORTERS) >= 20


@pytest.mark.parametrize("name", ["Mixamo", "Rigify", "3ds Max Biped", "Biovision", "Unity"])
def test_left_handed_exports_are_named_and_cured(tmp_path: Path, name: str) -> None:
    mirrored = replace(EXPORTERS[name], mirrored=True)
    with pytest.raises(InvalidInputError, match=r"backwards.*--handedness left"):
        read(tmp_path, mirrored)
    cured, truth = read(tmp_path, mirrored, handedness="left"), expected(mirrored)
    exact = [joint for joint, label in enumerate(JOINT_NAMES) if label in mirrored.names]
    assert np.linalg.norm(cured.joints - truth, axis=-1)[:, exact].max() <= CLOSE
    with pytest.raises(InvalidInputError, match="leave the option out"):
        read(tmp_path, EXPORTERS[name], handedness="left")


def test_up_is_told_in_the_warnings_where_rest_pose_and_motion_differ(tmp_path: Path) -> None:
    assert any("rest pose stands along y" in warning for warning in read(tmp_path, EXPORTERS["SMPL"]).warnings)
    assert not read(tmp_path, EXPORTERS["LaFAN1"]).warnings
    assert read(tmp_path, EXPORTERS["Mixamo"]).facing == "z"
    stated = read(tmp_path, EXPORTERS["Mixamo"], up="z")
    assert any("--up=z was given, but the body stands along y" in warning for warning in stated.warnings)
