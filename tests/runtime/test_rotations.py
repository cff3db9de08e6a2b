"""Quaternions against matrices, and rotations solved from joints against a skeleton turned by matrices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.motion import quaternions as q
from kinegraph.motion.kinematics import REST_DIRECTIONS, forward_kinematics, rest_offsets, rotations_from_positions
from kinegraph.motion.skeleton import JOINT_INDEX, PARENTS, bone_lengths, facing_angle
from support.motions import posed, recorded, t_pose, turn, walk

angles = st.floats(-3.1, 3.1)


def matrix_of(z: float, x: float, y: float) -> np.ndarray:
    return turn("z", z) @ turn("x", x) @ turn("y", y)


def quaternion_of(z: float, x: float, y: float) -> np.ndarray:
    parts = [q.about_axis(axis, np.array(angle)) for axis, angle in ((2, z), (0, x), (1, y))]
    return q.multiply(q.multiply(parts[0], parts[1]), parts[2])


def directions(count: int) -> np.ndarray:
    return q.normalised(np.random.default_rng(3).normal(size=(count, 3)))


def independent_fk(offsets: np.ndarray, root: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Joints by homogeneous matrices from the textbook formula."""
    w, x, y, z = np.moveaxis(turns, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    local = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    joints = []
    for frame in range(len(turns)):
        frames: list[np.ndarray] = []
        for joint, parent in enumerate(PARENTS):
            own = np.eye(4)
            own[:3, :3] = local[frame, joint]
            own[:3, 3] = root[frame] if parent < 0 else offsets[joint]
            frames.append(own if parent < 0 else frames[parent] @ own)
        joints.append([each[:3, 3] for each in frames])
    return np.array(joints)


@given(angles, angles, angles)
def test_products_and_matrices_agree(z: float, x: float, y: float) -> None:
    matrix, turned = matrix_of(z, x, y), quaternion_of(z, x, y)
    np.testing.assert_allclose(q.to_matrix(turned), matrix, atol=1e-12)
    np.testing.assert_allclose(q.rotate(turned, np.array([0.3, -2.0, 0.7])), matrix @ [0.3, -2.0, 0.7], atol=1e-12)
    np.testing.assert_allclose(q.to_matrix(q.conjugate(turned)), matrix.T, atol=1e-12)
    again = q.from_matrix(matrix)
    assert again[0] >= 0
    np.testing.assert_allclose(q.to_matrix(again), matrix, atol=1e-9)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_half_turns_from_matrices(axis: str) -> None:
    matrix = turn(axis, np.pi)
    np.testing.assert_allclose(q.to_matrix(q.from_matrix(matrix)), matrix, atol=1e-12)


def test_between_is_the_shortest_turn() -> None:
    start, end = directions(50), directions(100)[50:]
    turned = q.shortest_rotation(start * 3.0, end * 0.2)
    np.testing.assert_allclose(q.rotate(turned, start), end, atol=1e-9)
    np.testing.assert_allclose(2 * np.arccos(turned[:, 0]), np.arccos((start * end).sum(-1)), atol=1e-6)


def test_between_opposite_equal_and_zero_directions() -> None:
    start = directions(20)
    opposite = q.shortest_rotation(start, -start)
    np.testing.assert_allclose(q.rotate(opposite, start), -start, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(opposite, axis=-1), 1.0)
    np.testing.assert_allclose(q.shortest_rotation(start, start), np.tile(q.IDENTITY, (20, 1)), atol=1e-12)
    np.testing.assert_array_equal(q.shortest_rotation(np.zeros(3), start[0]), q.IDENTITY)


def test_slerp_goes_the_shorter_way_at_even_speed() -> None:
    first, second = quaternion_of(0, 0, 0.2), quaternion_of(0, 0, 1.4)
    for sign in (1.0, -1.0):
        for share in (0.0, 0.25, 0.5, 1.0):
            mixed = q.slerp(first, sign * second, np.array(share))
            np.testing.assert_allclose(q.to_matrix(mixed), turn("y", 0.2 + 1.2 * share), atol=1e-12)
    close = q.slerp(first, quaternion_of(0, 0, 0.2 + 1e-6), np.array(0.5))
    np.testing.assert_allclose(q.to_matrix(close), turn("y", 0.2 + 5e-7), atol=1e-10)


def test_continuous_keeps_the_turns_and_mends_the_signs() -> None:
    smooth = q.about_axis(1, np.linspace(0.0, 9.0, 40))
    signs = np.random.default_rng(0).choice([-1.0, 1.0], size=(40, 1))
    signs[0] = 1.0
    np.testing.assert_allclose(q.continuous_signs(smooth * signs), smooth)


def test_quaternions_keep_float32() -> None:
    turned = q.about_axis(0, np.array([0.3], dtype=np.float32))
    ahead = np.array([[0, 0, 1]], dtype=np.float32)
    results = [q.multiply(turned, turned), q.rotate(turned, ahead), q.shortest_rotation(ahead, -ahead)]
    assert {each.dtype for each in [*results, q.to_matrix(turned)]} == {np.dtype(np.float32)}


@pytest.mark.parametrize("turning", [0.0, 0.09])
def test_a_rigid_figure_is_reproduced(turning: float) -> None:
    joints = walk(80, turning=turning)
    motion = rotations_from_positions(joints, 20.0)
    places = independent_fk(motion.rest_offsets, motion.root, motion.rotations)
    np.testing.assert_allclose(places, joints, atol=1e-4)
    np.testing.assert_allclose(
        forward_kinematics(motion.rest_offsets, motion.root, motion.rotations), places, atol=1e-9
    )
    np.testing.assert_allclose(np.linalg.norm(motion.rotations, axis=-1), 1.0, atol=1e-9)
    assert (motion.rotations[1:] * motion.rotations[:-1]).sum(-1).min() > 0


def test_recorded_clips_are_reproduced() -> None:
    for joints in recorded(count=40):
        motion = rotations_from_positions(joints, 20.0)
        places = forward_kinematics(motion.rest_offsets, motion.root, motion.rotations)
        error = np.linalg.norm(places - joints, axis=-1)
        assert error.mean() < 5e-3
        assert error.max() < 15e-3


def test_the_error_is_that_of_the_bones_that_change_length() -> None:
    rng = np.random.default_rng(1)
    joints = walk(40) + rng.normal(0.0, 0.01, size=(40, 22, 3)).astype(np.float32)
    motion = rotations_from_positions(joints, 20.0)
    places = independent_fk(motion.rest_offsets, motion.root, motion.rotations)
    np.testing.assert_allclose(motion.error, np.linalg.norm(places - joints, axis=-1), atol=1e-6)
    # Joints are aimed at one by one, so the noise of 1 cm does not add up along the limbs.
    assert 1e-3 < motion.error.mean() < 0.02
    assert motion.error[:, JOINT_INDEX["left_wrist"]].mean() < 0.02


def test_the_t_pose_needs_no_turns_but_its_bend_of_the_limbs() -> None:
    lengths = np.full(22, 0.2)
    still = np.tile(q.IDENTITY, (3, 22, 1))
    joints = forward_kinematics(REST_DIRECTIONS * lengths[:, None], np.zeros((3, 3)), still)
    motion = rotations_from_positions(joints, 20.0)
    np.testing.assert_allclose(motion.rotations, np.tile(q.IDENTITY, (3, 22, 1)), atol=1e-6)
    np.testing.assert_allclose(motion.error, 0.0, atol=1e-9)


def test_rest_offsets_have_the_mean_lengths_and_stand_upright() -> None:
    joints = walk(50, turning=0.1, heading=1.0)
    offsets = rest_offsets(joints)
    np.testing.assert_allclose(np.linalg.norm(offsets, axis=-1)[1:], bone_lengths(joints).mean(axis=0), atol=1e-6)
    assert not offsets[0].any()
    left = [JOINT_INDEX[name] for name in ("left_hip", "left_collar", "left_shoulder", "left_wrist")]
    right = [JOINT_INDEX[name] for name in ("right_hip", "right_collar", "right_shoulder", "right_wrist")]
    np.testing.assert_allclose(offsets[left] * [-1, 1, 1], offsets[right], atol=1e-3)
    assert (offsets[left, 0] > 0.03).all()


@pytest.mark.parametrize("heading", [0.0, 1.2, 3.0])
def test_the_pelvis_turns_with_the_body(heading: float) -> None:
    joints = walk(40, turning=0.05, heading=heading)
    ahead = q.rotate(rotations_from_positions(joints, 20.0).rotations[:, 0], np.array([0.0, 0.0, 1.0]))
    difference = np.arctan2(ahead[:, 0], ahead[:, 2]) - facing_angle(joints)
    wrapped = np.angle(np.exp(1j * difference))
    # The shoulders of the figure swing against its hips.
    assert np.abs(wrapped).max() < 0.15


def test_the_upper_body_follows_the_shoulders_when_it_twists() -> None:
    poses = [posed(np.zeros(3), {3: turn("y", angle)}) for angle in (0.0, 0.4, 0.8)]
    motion = rotations_from_positions(np.stack(poses), 20.0)
    chest = motion.rotations[:, 0]
    for joint in ("spine1", "spine2", "spine3"):
        chest = q.multiply(chest, motion.rotations[:, JOINT_INDEX[joint]])
    ahead = q.rotate(chest, np.array([0.0, 0.0, 1.0]))
    heading = np.arctan2(ahead[:, 0], ahead[:, 2])
    np.testing.assert_allclose(heading - heading[0], [0.0, 0.4, 0.8], atol=0.02)


def test_one_frame_and_bones_without_length() -> None:
    single = rotations_from_positions(t_pose(1), 20.0)
    assert single.error.max() < 1e-5
    nothing = rotations_from_positions(np.zeros((3, 22, 3)), 20.0)
    assert np.isfinite(nothing.rotations).all()
    assert nothing.error.max() == 0
