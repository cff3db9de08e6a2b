"""Layout joints-137: both ways, signs, contacts, normalisation."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.motion import features as layout
from kinegraph.motion.features import features_from_joints, joints_from_features, joints_vjp, normalisation
from kinegraph.motion.skeleton import JOINT_INDEX, bone_lengths, facing_angle, mirrored
from support.motions import recorded, t_pose, turn, walk


@pytest.mark.parametrize("turning", [0.0, 0.06, -0.13])
def test_walking_figure_comes_back(turning: float) -> None:
    joints = walk(80, turning=turning)
    rows = features_from_joints(joints)
    assert rows.shape == (80, 137)
    assert rows.dtype == np.float32
    back = joints_from_features(rows, heading=float(facing_angle(joints)[0]))
    np.testing.assert_allclose(back, joints, atol=2e-5)


def test_recorded_clips_come_back() -> None:
    for joints in recorded():
        back = joints_from_features(features_from_joints(joints), heading=float(facing_angle(joints)[0]))
        assert np.linalg.norm(back - joints, axis=-1).max() <= 1e-3


def test_without_heading_a_clip_starts_facing_ahead() -> None:
    joints = walk(30, heading=1.1, turning=0.02)
    back = joints_from_features(features_from_joints(joints))
    angle = -float(facing_angle(joints)[0])
    expected = joints.astype(np.float64) @ turn("y", angle).T
    np.testing.assert_allclose(back, expected, atol=2e-5)


@pytest.mark.parametrize("heading", [0.0, 0.5, 2.0, -3.0])
def test_facing_is_positive_to_the_left(heading: float) -> None:
    still = t_pose(1)[0].astype(np.float64) @ turn("y", heading).T
    assert facing_angle(still[None].astype(np.float32))[0] == pytest.approx(heading, abs=1e-5)
    toe = still[JOINT_INDEX["left_foot"]] - still[JOINT_INDEX["left_ankle"]]
    assert np.arctan2(toe[0], toe[2]) == pytest.approx(heading, abs=1e-5)


def test_turning_left_has_a_positive_yaw_velocity_and_walking_ahead_a_positive_forward_velocity() -> None:
    for heading in (0.0, 1.0, 2.5):
        rows = features_from_joints(walk(72, turning=0.05, heading=heading, speed=0.04))
        # The pelvis and shoulders swing with the steps; their mean over whole steps is the turn.
        assert rows[:, layout.YAW_VELOCITY].mean() == pytest.approx(0.05, abs=2e-3)
        left, forward = rows[:, layout.ROOT_VELOCITY].mean(axis=0)
        assert forward == pytest.approx(0.04, abs=1e-3)
        assert left == pytest.approx(0.0, abs=2e-3)


def test_features_do_not_see_where_a_clip_starts() -> None:
    joints = walk(40, turning=0.03)
    moved = (joints.astype(np.float64) @ turn("y", 2.2).T + np.array([4.0, 0.0, -7.0])).astype(np.float32)
    np.testing.assert_allclose(features_from_joints(moved), features_from_joints(joints), atol=1e-5)


def test_a_full_turn_passes_the_back_without_a_jump() -> None:
    yaw = features_from_joints(walk(140, turning=0.1))[:, 0]
    assert np.abs(yaw - 0.1).max() < 0.1


def test_mirrored_features() -> None:
    joints = walk(50, turning=0.04)
    rows, other = features_from_joints(joints), features_from_joints(mirrored(joints))
    np.testing.assert_allclose(mirrored(mirrored(joints)), joints)
    np.testing.assert_allclose(other[:, layout.YAW_VELOCITY], -rows[:, layout.YAW_VELOCITY], atol=1e-5)
    np.testing.assert_allclose(other[:, layout.ROOT_VELOCITY], rows[:, layout.ROOT_VELOCITY] * [-1, 1], atol=1e-5)
    np.testing.assert_allclose(other[:, layout.HEIGHT], rows[:, layout.HEIGHT])
    positions = rows[:, layout.POSITIONS].reshape(-1, 21, 3)
    other_positions = other[:, layout.POSITIONS].reshape(-1, 21, 3)
    left, right = JOINT_INDEX["left_wrist"] - 1, JOINT_INDEX["right_wrist"] - 1
    np.testing.assert_allclose(other_positions[:, left], positions[:, right] * [-1, 1, 1], atol=1e-5)
    assert np.abs(positions[:, right] - positions[:, left]).max() > 0.1
    contacts, other_contacts = rows[:, layout.CONTACTS], other[:, layout.CONTACTS]
    np.testing.assert_array_equal(other_contacts, contacts[:, [2, 3, 0, 1]])


def test_local_positions_are_in_the_facing_frame() -> None:
    joints = t_pose(3)
    turned = (joints.astype(np.float64) @ turn("y", 1.3).T + [2.0, 0.0, 1.0]).astype(np.float32)
    positions = features_from_joints(turned)[:, layout.POSITIONS].reshape(3, 21, 3)
    pelvis = joints[:, :1] * [1, 0, 1]
    np.testing.assert_allclose(positions, joints[:, 1:] - pelvis, atol=1e-5)


def test_contacts_need_a_foot_that_is_low_and_still() -> None:
    still = t_pose(4)
    assert (features_from_joints(still)[:, layout.CONTACTS] == 1).all()
    lifted = still.copy()
    lifted[:, [JOINT_INDEX["left_ankle"], JOINT_INDEX["left_foot"]], 1] += 0.3
    assert (features_from_joints(lifted)[:, layout.CONTACTS] == [0, 0, 1, 1]).all()
    sliding = still.copy()
    sliding[:, JOINT_INDEX["right_foot"], 2] += 0.02 * np.arange(4)
    assert (features_from_joints(sliding)[:, layout.CONTACTS] == [1, 1, 1, 0]).all()


def test_the_last_row_repeats_the_last_step() -> None:
    rows = features_from_joints(walk(20, turning=0.05))
    np.testing.assert_allclose(rows[-1, layout.YAW_VELOCITY], rows[-2, layout.YAW_VELOCITY])
    speeds = np.linalg.norm(rows[-2:, layout.VELOCITIES].reshape(2, 22, 3), axis=-1)
    np.testing.assert_allclose(speeds[1], speeds[0], rtol=1e-4)


def test_normalisation_shares_the_deviation_in_a_group() -> None:
    rng = np.random.default_rng(0)
    clips = [rng.normal(3.0, 2.0, size=(count, 137)).astype(np.float32) for count in (40, 7)]
    mean, std = normalisation(clips)
    rows = np.concatenate(clips).astype(np.float64)
    np.testing.assert_allclose(mean, rows.mean(axis=0), rtol=1e-5)
    for group in layout.GROUPS:
        centred = rows[:, group] - rows[:, group].mean(axis=0)
        np.testing.assert_allclose(std[group], np.sqrt((centred**2).mean()), rtol=1e-5)
    assert sorted(index for group in layout.GROUPS for index in range(137)[group]) == list(range(137))


def test_bone_lengths_of_the_figure() -> None:
    lengths = bone_lengths(walk(10))
    assert lengths.shape == (10, 21)
    np.testing.assert_allclose(lengths[:, JOINT_INDEX["left_knee"] - 1], 0.40, atol=1e-5)
    np.testing.assert_allclose(lengths[:, JOINT_INDEX["right_wrist"] - 1], 0.25, atol=1e-5)


def test_a_group_that_never_changes_is_normalised_to_zero() -> None:
    still = features_from_joints(t_pose(20))
    mean, std = normalisation([still])
    assert (std > 0).all()
    np.testing.assert_allclose((still - mean) / std, 0.0, atol=1e-3)


def test_the_gradient_of_joints_is_that_of_autograd() -> None:
    torch = pytest.importorskip("torch")
    rng = np.random.default_rng(0)
    rows = features_from_joints(walk(50, turning=0.04)) + rng.normal(0.0, 0.02, (50, 137)).astype(np.float32)
    cotangent = rng.normal(size=(50, 22, 3))
    features = torch.from_numpy(rows.astype(np.float64)).requires_grad_()
    angle = torch.cat([torch.zeros(1, dtype=torch.float64), torch.cumsum(features[:-1, 0], 0)])
    cos, sin = angle.cos(), angle.sin()
    left, forward = features[:, 1], features[:, 2]
    step = torch.stack([cos * left + sin * forward, -sin * left + cos * forward], -1)
    root = torch.cat([torch.zeros(1, 2, dtype=torch.float64), torch.cumsum(step[:-1], 0)])
    x, y, z = features[:, 4:67].reshape(50, 21, 3).unbind(-1)
    others = [cos[:, None] * x + sin[:, None] * z + root[:, :1], y, -sin[:, None] * x + cos[:, None] * z + root[:, 1:]]
    pelvis = torch.stack([root[:, 0], features[:, 3], root[:, 1]], -1)
    joints = torch.cat([pelvis[:, None], torch.stack(others, -1)], 1)
    np.testing.assert_allclose(joints.detach().numpy(), joints_from_features(rows), atol=1e-5)
    (joints * torch.from_numpy(cotangent)).sum().backward()
    np.testing.assert_allclose(joints_vjp(rows, cotangent), features.grad.numpy(), rtol=1e-9, atol=1e-9)


def test_the_gradient_of_joints_is_that_of_finite_differences() -> None:
    rng = np.random.default_rng(1)
    rows = features_from_joints(walk(24, turning=0.1)).astype(np.float64)
    cotangent = rng.normal(size=(24, 22, 3))
    gradient = joints_vjp(rows, cotangent)
    for _ in range(20):
        direction = rng.normal(size=rows.shape)
        ends = [joints_from_features(rows + sign * 1e-3 * direction).astype(np.float64) for sign in (1, -1)]
        slope = ((ends[0] - ends[1]) * cotangent).sum() / 2e-3
        assert abs(slope - (gradient * direction).sum()) <= 1e-3 * np.abs(gradient).sum()
    assert not gradient[:, layout.VELOCITIES].any() and not gradient[:, layout.CONTACTS].any()
