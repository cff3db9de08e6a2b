"""Joints that fit both the positions and the velocities of features."""

from __future__ import annotations

import numpy as np

from kinegraph.motion.features import POSITIONS, VELOCITIES, features_from_joints, joints_from_features
from kinegraph.motion.fusion import HELD, certainty_of, fit_steps, fused_joints
from kinegraph.motion.known_features import KnownFeatures
from support.motions import walk


def test_the_least_squares_are_those_of_a_dense_solver() -> None:
    rng = np.random.default_rng(3)
    positions, steps = rng.standard_normal((9, 2, 3)), rng.standard_normal((8, 2, 3))
    certainty = rng.uniform(0.2, 3.0, (9, 2))
    found = fit_steps(positions, steps, certainty, 2.5)
    for joint in range(2):
        rows = [np.sqrt(certainty[t, joint]) * np.eye(9)[t] for t in range(9)]
        right = [np.sqrt(certainty[t, joint]) * positions[t, joint] for t in range(9)]
        rows += [np.sqrt(2.5) * (np.eye(9)[t + 1] - np.eye(9)[t]) for t in range(8)]
        right += [np.sqrt(2.5) * steps[t, joint] for t in range(8)]
        expected = np.linalg.lstsq(np.array(rows), np.array(right), rcond=None)[0]
        np.testing.assert_allclose(found[:, joint], expected, atol=1e-10)


def test_positions_alone_count_without_trust_in_velocities() -> None:
    rng = np.random.default_rng(5)
    positions = rng.standard_normal((6, 2, 3))
    np.testing.assert_allclose(fit_steps(positions, rng.standard_normal((5, 2, 3)), np.ones((6, 2)), 0.0), positions)


def test_features_that_agree_are_read_as_they_are() -> None:
    joints = walk(60, turning=0.02)
    features = features_from_joints(joints)
    np.testing.assert_allclose(fused_joints(features), joints_from_features(features), atol=1e-4)


def test_a_motion_whose_positions_tremble_is_calmed_by_its_velocities() -> None:
    features = features_from_joints(walk(60, turning=0.02))
    true = joints_from_features(features)
    noisy = features.copy()
    noisy[:, POSITIONS] += np.random.default_rng(1).normal(0.0, 0.02, noisy[:, POSITIONS].shape)

    def trembling(joints: np.ndarray) -> float:
        return float(np.abs(np.diff(joints - true, n=3, axis=0)).mean())

    assert trembling(fused_joints(noisy)) < 0.15 * trembling(joints_from_features(noisy))


def test_what_is_known_stays_where_it_is() -> None:
    joints = walk(40)
    features = features_from_joints(joints)
    known = KnownFeatures.nothing(40).with_poses(joints[10:14], 10)
    wrong = features.copy()
    wrong[:, VELOCITIES] += 0.03
    certainty = certainty_of(known)
    assert (certainty[10:14] == HELD).all() and (certainty[:10] == 1).all() and (certainty[14:] == 1).all()
    moved = np.linalg.norm(fused_joints(wrong, certainty) - joints_from_features(wrong), axis=-1)
    assert moved[10:14].max() < 1e-5 and moved[20].min() > 0.003
