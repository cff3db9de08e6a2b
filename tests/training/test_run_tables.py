"""What a run measures on its data for the bundle."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kinegraph.motion.skeleton import PARENTS, bone_lengths
from kinegraph_training.bundle_tables import common_bone_lengths, read_tables, write_tables


def body(size: float) -> np.ndarray:
    """Two frames of a straight chain."""
    depth = [0] * 22
    for child, parent in enumerate(PARENTS):
        depth[child] = depth[parent] + 1 if parent >= 0 else 0
    joints = np.zeros((2, 22, 3), np.float32)
    joints[:, :, 1] = size * np.array(depth)
    return joints


def test_bones_of_one_body_and_of_two() -> None:
    one = common_bone_lengths([body(0.2), body(0.2)])
    assert one is not None and one.shape == (1, 21) and one.dtype == np.float32
    np.testing.assert_allclose(one[0], bone_lengths(body(0.2))[0], rtol=1e-6)
    assert common_bone_lengths([body(0.2), body(0.25)]) is None


def test_tables_come_back_and_a_run_without_them_has_none(tmp_path: Path) -> None:
    assert read_tables(tmp_path) == {}
    write_tables(tmp_path / "run", {"a": np.ones((1, 3), np.float32)})
    assert read_tables(tmp_path / "run")["a"].tolist() == [[1, 1, 1]]
