"""Layout kit-251: joints of the body that KIT-ML shares with ours, in metres."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.errors import InvalidInputError
from kinegraph.motion.humanml3d import joints_from_humanml3d
from kinegraph.motion.kit_ml import KIT_JOINTS, LEG_METRES, SOURCES, WIDTH, from_kit_joints, joints_from_kit
from kinegraph.motion.skeleton import JOINT_INDEX, JOINT_NAMES


def test_every_joint_is_the_middle_of_its_sources() -> None:
    rng = np.random.default_rng(1)
    joints = rng.standard_normal((4, KIT_JOINTS, 3)) * 300
    ours = from_kit_joints(joints)
    leg = np.linalg.norm(joints[:, 12] - joints[:, 11], axis=-1) + np.linalg.norm(
        joints[:, 13] - joints[:, 12], axis=-1
    )
    assert set(SOURCES) == set(JOINT_NAMES)
    for name, sources in SOURCES.items():
        middle = sum(joints[:, source] for source in sources) / len(sources)
        np.testing.assert_allclose(ours[:, JOINT_INDEX[name]], middle * LEG_METRES / leg.mean(), rtol=1e-4, atol=1e-5)


def test_features_are_those_of_the_same_code_with_21_joints() -> None:
    rows = np.random.default_rng(2).standard_normal((5, WIDTH)).astype(np.float32)
    assert WIDTH == 4 + 3 * 20 + 6 * 20 + 3 * KIT_JOINTS + 4
    np.testing.assert_array_equal(joints_from_kit(rows), from_kit_joints(joints_from_humanml3d(rows, KIT_JOINTS)))


def test_a_body_without_legs_has_no_unit() -> None:
    with pytest.raises(InvalidInputError, match="leg has no length"):
        from_kit_joints(np.zeros((2, KIT_JOINTS, 3)))
