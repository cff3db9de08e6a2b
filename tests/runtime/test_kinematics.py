"""Rotations solved from joints: a skeleton rotated by matrices comes back, and limbs twist as their hinges show."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.motion import quaternions as q
from kinegraph.motion.kinematics import (
    HINGES,
    REST_DIRECTIONS,
    apply_twist,
    forward_kinematics,
    join_root,
    rest_offsets,
    rest_pose,
    rotations_from_positions,
    spine_twist,
    split_root,
)
from kinegraph.motion.skeleton import JOINT_INDEX, PARENTS, bone_lengths, facing_angle
from support.motions import largest_twist, posed, recorded, t_pose, turn, walk, world_turns


def independent_fk(offsets: np.ndarray, root: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """Compute joints with homogeneous matrices, by the textbook formula."""
    w, x, y, z = np.moveaxis(rotations, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    local = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    joints = []
    for frame in range(len(rotations)):
        world: list[np.ndarray] = []
        for joint, parent in enumerate(PARENTS):
            transform = np.eye(4)
            transform[:3, :3] = local[frame, joint]
            transform[:3, 3] = root[frame] if parent < 0 else offsets[joint]
            world.append(transform if parent < 0 else world[parent] @ transform)
        joints.append([transform[:3, 3] for transform in world])
    return np.array(joints)


@pytest.mark.parametrize("turning", [0.0, 0.09])
def test_a_rigid_figure_is_reproduced(turning: float) -> None:
    joints = walk(80, turning=turning)
    motion = rotations_from_positions(joints, 20.0)
    solved = independent_fk(motion.rest_offsets, motion.root, motion.rotations)
    np.testing.assert_allclose(solved, joints, atol=1e-4)
    np.testing.assert_allclose(
        forward_kinematics(motion.rest_offsets, motion.root, motion.rotations), solved, atol=1e-9
    )
    np.testing.assert_allclose(np.linalg.norm(motion.rotations, axis=-1), 1.0, atol=1e-9)
    assert (motion.rotations[1:] * motion.rotations[:-1]).sum(-1).min() > 0


def test_recorded_clips_are_reproduced() -> None:
    for joints in recorded(count=40):
        motion = rotations_from_positions(joints, 20.0)
        solved = forward_kinematics(motion.rest_offsets, motion.root, motion.rotations)
        error = np.linalg.norm(solved - joints, axis=-1)
        assert error.mean() < 5e-3
        assert error.max() < 15e-3


def test_the_error_is_that_of_the_bones_that_change_length() -> None:
    rng = np.random.default_rng(1)
    joints = walk(40) + rng.normal(0.0, 0.01, size=(40, 22, 3)).astype(np.float32)
    motion = rotations_from_positions(joints, 20.0)
    solved = independent_fk(motion.rest_offsets, motion.root, motion.rotations)
    np.testing.assert_allclose(motion.error, np.linalg.norm(solved - joints, axis=-1), atol=1e-6)
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


def test_the_rest_pose_stands_on_the_floor() -> None:
    offsets = rest_offsets(walk(50, turning=0.1, heading=1.0))
    rest = rest_pose(offsets)
    assert rest[:, 1].min() == 0.0 and not rest[0, [0, 2]].any()
    parents = list(PARENTS[1:])
    np.testing.assert_allclose(rest[1:] - rest[parents], offsets[1:], atol=1e-12)
    feet = rest[[JOINT_INDEX["left_foot"], JOINT_INDEX["right_foot"]], 1]
    np.testing.assert_allclose(feet, 0.0, atol=1e-3)


@pytest.mark.parametrize("turning", [0.0, 0.2])
def test_a_root_joint_splits_the_motion_of_the_pelvis_and_gives_it_back(turning: float) -> None:
    joints = walk(80, turning=turning, heading=0.7)
    motion = rotations_from_positions(joints, 20.0)
    split = split_root(motion, joints)
    assert not split.root[:, 1].any()
    np.testing.assert_array_equal(split.root[:, [0, 2]], joints[:, 0, [0, 2]].astype(float))
    np.testing.assert_allclose(q.rotate(split.root_rotations, np.array([0.0, 1.0, 0.0]))[:, 1], 1.0)
    for rotations in (split.root_rotations, split.pelvis_rotations):
        assert (rotations[1:] * rotations[:-1]).sum(-1).min() > 0
    pelvis, rotations = join_root(split)
    np.testing.assert_allclose(pelvis, motion.root, atol=1e-12)
    np.testing.assert_allclose(np.abs((rotations * motion.rotations[:, 0]).sum(-1)), 1.0)


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


def repeated_pose(turns: dict[int, np.ndarray], frames: int = 6) -> np.ndarray:
    return np.repeat(posed(np.zeros(3), turns)[None], frames, axis=0).astype(np.float32)


@pytest.mark.parametrize("angle", [-1.0, -0.3, 0.0, 0.5, 1.2])
@pytest.mark.parametrize("side", ["left", "right"])
def test_a_bent_arm_and_leg_show_how_they_are_turned(angle: float, side: str) -> None:
    sign = 1.0 if side == "left" else -1.0
    shoulder = turn("z", -0.9 * sign) @ turn("y", 0.4) @ turn("x", angle)
    hip = turn("x", -0.3) @ turn("y", angle)
    index = {part: JOINT_INDEX[f"{side}_{part}"] for part in ("shoulder", "elbow", "hip", "knee")}
    bends = {index["elbow"]: turn("y", -0.9 * sign), index["knee"]: turn("x", 0.8)}
    solved = q.to_matrix(world_turns(repeated_pose({index["shoulder"]: shoulder, index["hip"]: hip, **bends})))
    # the weight of no twist pulls the result towards the shortest rotation
    for part, true in (("shoulder", shoulder), ("hip", hip)):
        upper = solved[3, index[part]]
        assert np.degrees(np.arccos((np.trace(upper @ true.T) - 1) / 2)) < 8.0, part
        lower = solved[3, index["elbow" if part == "shoulder" else "knee"]]
        bend = upper.T @ lower
        assert abs(np.degrees(np.arccos((np.trace(bend) - 1) / 2)) - np.degrees(0.9 if part == "shoulder" else 0.8)) < 1


def test_a_straight_limb_takes_the_shortest_turn() -> None:
    turns = world_turns(repeated_pose({JOINT_INDEX["left_shoulder"]: turn("z", -1.1)}))
    solved = q.to_matrix(turns[0, JOINT_INDEX["left_shoulder"]])
    # the shortest from the collar, whose direction in the solved rest pose differs a little
    assert np.degrees(np.arccos((np.trace(solved @ turn("z", -1.1).T) - 1) / 2)) < 10.0


def test_a_limb_that_bends_for_a_while_is_turned_without_a_jump() -> None:
    left = JOINT_INDEX["left_shoulder"]
    bend = 0.9 * np.clip(np.sin(np.linspace(-2, 5, 80)), 0, 1)
    joints = np.stack(
        [posed(np.zeros(3), {left: turn("x", 1.4), JOINT_INDEX["left_elbow"]: turn("y", -b)}) for b in bend]
    ).astype(np.float32)
    turns = world_turns(joints)[:, left]
    step = np.degrees(2 * np.arccos(np.abs((turns[1:] * turns[:-1]).sum(-1)).clip(0, 1)))
    assert step.max() < 25 and step.sum() < 2.5 * np.degrees(1.4)


@pytest.mark.parametrize("angle", [-0.9, 0.0, 0.6])
def test_the_spine_shares_what_the_chest_is_turned(angle: float) -> None:
    solved = q.to_matrix(world_turns(repeated_pose({JOINT_INDEX["spine3"]: turn("y", angle)})))[2]
    heading = [np.arctan2(solved[JOINT_INDEX[name], 0, 2], solved[JOINT_INDEX[name], 2, 2]) for name in
               ("pelvis", "spine1", "spine2", "spine3")]  # fmt: skip
    np.testing.assert_allclose(heading, np.linspace(0, angle, 4), atol=0.03)


def test_the_twist_of_a_turn_is_that_of_the_textbook() -> None:
    angle = np.array([-3.0, -1.0, 0.0, 0.5, 3.0])
    lean = q.about_axis(0, np.full(5, 0.4))
    chest = q.multiply(lean, q.about_axis(1, angle))
    np.testing.assert_allclose(spine_twist(np.tile(q.IDENTITY, (5, 1)), chest), angle, atol=1e-9)
    np.testing.assert_allclose(spine_twist(np.tile(q.IDENTITY, (5, 1)), -chest), angle, atol=1e-9)
    swing = q.about_axis(2, np.full(5, 0.3))
    bone = np.array([0.0, 2.0, 0.0])
    np.testing.assert_allclose(q.rotate(apply_twist(swing, bone, angle), bone), q.rotate(swing, bone), atol=1e-9)


def test_a_limb_that_flips_would_be_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    assert largest_twist(walk(40)) < 45
    monkeypatch.setattr(
        "kinegraph.motion.kinematics.hinge_twist",
        lambda _, goal, *rest, **more: np.pi * (np.arange(len(goal)) == 20)[:, None] * np.ones(goal.shape[1]),
    )
    assert largest_twist(walk(40)) > 150


def test_recorded_limbs_bend_about_their_hinges_and_never_flip() -> None:
    errors = []
    for joints in recorded(count=60):
        turns = world_turns(joints)
        assert largest_twist(joints) < 45
        for joint, (middle, end, axis) in HINGES.items():
            upper = q.normalised(joints[:, middle] - joints[:, joint]).astype(np.float64)
            lower = q.normalised(joints[:, end] - joints[:, middle]).astype(np.float64)
            plane = np.cross(upper, lower)
            bent = np.linalg.norm(plane, axis=-1) > 0.35
            cosine = (q.rotate(turns[:, joint], np.array(axis)) * q.normalised(plane)).sum(-1)
            errors.append(np.degrees(np.arccos(cosine.clip(-1, 1)))[bent])
    # shortest rotations alone give 33 degrees on half of the arms' frames, and up to 99
    assert np.quantile(np.concatenate(errors), 0.95) < 10 and np.concatenate(errors).max() < 40
