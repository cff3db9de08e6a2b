"""Bones that keep their length."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinegraph import MotionPipeline
from kinegraph.bundle.reader import read_bundle
from kinegraph.errors import BundleFormatError
from kinegraph.motion.postprocess import enforce_bone_lengths
from kinegraph.motion.skeleton import JOINT_INDEX, PARENTS, bone_lengths
from support.synthetic_bundle import bundle_files, tables_npz, write_bundle

LENGTHS = np.linspace(0.08, 0.45, 21, dtype=np.float32)
TOES = [JOINT_INDEX["left_foot"], JOINT_INDEX["right_foot"]]


def outwards(ways: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Exactly these bones in these directions (frames, 21, 3), joint by joint from the pelvis."""
    joints = np.zeros((len(ways), 22, 3))
    for child, parent in enumerate(PARENTS):
        if parent >= 0:
            way = ways[:, child - 1]
            joints[:, child] = joints[:, parent] + lengths[child - 1] * way / np.linalg.norm(way, axis=1)[:, None]
    return joints.astype(np.float32)


def grown(lengths: np.ndarray, frames: int = 40) -> np.ndarray:
    """A motion with these bones."""
    rng = np.random.default_rng(0)
    return outwards(rng.standard_normal((21, 3)) + np.cumsum(0.05 * rng.standard_normal((frames, 21, 3)), 0), lengths)


def test_a_motion_with_these_bones_stays_as_it_is() -> None:
    joints = grown(LENGTHS)
    np.testing.assert_allclose(enforce_bone_lengths(joints, LENGTHS), joints, atol=2e-6)


def test_lengths_come_out_exact_and_feet_hardly_move() -> None:
    true = grown(LENGTHS)
    joints = true + np.random.default_rng(1).normal(0, 0.002, true.shape).astype(np.float32)
    found = enforce_bone_lengths(joints, LENGTHS)
    assert np.abs(bone_lengths(found) - LENGTHS).max() < 1e-6
    moved = np.linalg.norm(found - joints, axis=-1)
    assert moved.mean() < 0.003
    plain = outwards(joints[:, 1:] - joints[:, list(PARENTS[1:])], LENGTHS)
    assert moved[:, TOES].mean() < 0.5 * np.linalg.norm(plain - joints, axis=-1)[:, TOES].mean()
    # nearer to the truth than before: a wrong length was noise
    assert np.linalg.norm(found - true, axis=-1).mean() < np.linalg.norm(joints - true, axis=-1).mean()


def test_without_lengths_each_bone_keeps_its_median() -> None:
    joints = grown(LENGTHS) + np.random.default_rng(1).normal(0, 0.002, (40, 22, 3)).astype(np.float32)
    lengths = bone_lengths(enforce_bone_lengths(joints, None))
    assert np.abs(lengths - np.median(bone_lengths(joints), axis=0)).max() < 1e-6


def test_joints_in_one_point_stay_finite() -> None:
    assert np.isfinite(enforce_bone_lengths(np.zeros((3, 22, 3), np.float32), LENGTHS)).all()


def test_input_is_left_alone() -> None:
    joints = 1.1 * grown(LENGTHS)
    before = joints.copy()
    enforce_bone_lengths(joints, LENGTHS)
    np.testing.assert_array_equal(joints, before)


def test_a_bundle_may_carry_them_or_not(tmp_path: Path) -> None:
    with_them = {**bundle_files(), "tables.npz": tables_npz(bone_lengths=LENGTHS[None])}
    tables = read_bundle(write_bundle(tmp_path / "a", with_them)).tables
    np.testing.assert_array_equal(tables["bone_lengths"], LENGTHS[None])
    wrong = {**bundle_files(), "tables.npz": tables_npz(bone_lengths=LENGTHS[None, :20])}
    with pytest.raises(BundleFormatError, match="bone_lengths"):
        read_bundle(write_bundle(tmp_path / "b", wrong))


def test_bones_of_a_clip_do_not_stretch(pipe: MotionPipeline) -> None:
    joints = pipe.generate("a person walks", seconds=2, seed=1).joints
    assert np.ptp(bone_lengths(joints), axis=0).max() < 1e-5
