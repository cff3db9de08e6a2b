"""The last centimetres: joints come to their places with rigid bones, and feet stay planted."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.motion.postprocess import find_contacts
from kinegraph.motion.reaching import MAX_REACH, METRES_PER_ACCELERATION, Pins, reach, smooth_field
from kinegraph.motion.skeleton import JOINT_INDEX, LEFT_HIP, PELVIS, RIGHT_HIP, bone_lengths
from support.motions import stand, walk

FPS = 20.0


def pins(frames: int) -> Pins:
    return Pins(np.zeros((frames, 22, 3)), np.zeros((frames, 22, 3), dtype=np.bool_))


def rigid(joints: np.ndarray) -> np.ndarray:
    return np.asarray(bone_lengths(joints)[0])


def tilt(joints: np.ndarray) -> np.ndarray:
    """Measure the angle between up and the way from the middle of the hips to the pelvis: (frames,) degrees."""
    up = joints[:, PELVIS] - (joints[:, LEFT_HIP] + joints[:, RIGHT_HIP]) / 2
    return np.degrees(np.arccos(up[:, 1] / np.linalg.norm(up, axis=1)))


def test_nothing_wanted_changes_nothing() -> None:
    motion = walk(40, turning=0.02)
    np.testing.assert_allclose(reach(motion, pins(40), rigid(motion), FPS, foot_fix=False), motion, atol=1e-6)


@pytest.mark.parametrize("joint", ["right_wrist", "left_elbow", "head", "left_foot", "spine2"])
def test_a_joint_comes_to_its_place_and_the_rest_stays(joint: str) -> None:
    motion, index = stand(40), JOINT_INDEX[joint]
    wanted = pins(40)
    wanted.target[20, index] = motion[20, index] + [0.02, -0.03 if joint in ("head", "spine2") else 0.03, 0.01]
    wanted.wanted[20, index] = True
    moved = reach(motion, wanted, rigid(motion), FPS, foot_fix=False)
    np.testing.assert_allclose(moved[20, index], wanted.target[20, index], atol=3e-3)
    np.testing.assert_allclose(bone_lengths(moved), np.tile(rigid(motion), (40, 1)), atol=1e-4)
    np.testing.assert_allclose(moved[[0, 39]], motion[[0, 39]], atol=6e-3)
    steps = np.abs(np.diff(moved - motion, axis=0)).max()
    assert steps < 0.02  # no jump


def test_a_path_is_followed_to_the_millimetre_with_planted_feet() -> None:
    motion = stand(60, wave=2.0)
    wanted = pins(60)
    wanted.target[:, PELVIS] = motion[:, PELVIS] + 0.03 * np.sin(np.arange(60) / 9)[:, None] * [1.0, 0.0, 0.5]
    wanted.wanted[:, PELVIS, [0, 2]] = True
    moved = reach(motion, wanted, rigid(motion), FPS, foot_fix=True)
    np.testing.assert_allclose(moved[:, PELVIS, [0, 2]], wanted.target[:, PELVIS, [0, 2]], atol=1e-3)
    slid = []
    for toe in (10, 11):
        for start, end in find_contacts(moved[:, toe].astype(np.float64), FPS):
            slid.append(np.linalg.norm(np.diff(moved[start:end, toe][:, [0, 2]], axis=0), axis=-1))
    assert np.concatenate(slid).max() < 2e-3


def test_a_whole_pose_is_reached() -> None:
    motion, bow = stand(40), stand(40, bow=0.15)
    wanted = pins(40)
    wanted.target[20], wanted.wanted[20] = bow[15], True
    moved = reach(motion, wanted, rigid(motion), FPS, foot_fix=True)
    assert np.linalg.norm(moved[20] - bow[15], axis=-1).mean() < 5e-3


def test_what_is_out_of_reach_does_not_explode() -> None:
    motion = stand(30)
    wanted = pins(30)
    wanted.target[15, JOINT_INDEX["left_wrist"]], wanted.wanted[15, JOINT_INDEX["left_wrist"]] = [50.0, 3.0, 0.0], True
    moved = reach(motion, wanted, rigid(motion), FPS, foot_fix=True)
    assert np.abs(moved - motion).max() < 0.8
    np.testing.assert_allclose(bone_lengths(moved), np.tile(rigid(motion), (30, 1)), atol=1e-4)


def test_a_place_where_the_body_was_is_reached_from_any_distance() -> None:
    motion, other = stand(40), walk(40)
    legs = [PELVIS, *(JOINT_INDEX[f"{side}_{name}"] for side in ("left", "right") for name in ("hip", "knee", "ankle"))]
    target, wanted = other.astype(np.float64), np.zeros((40, 22, 3), dtype=np.bool_)
    wanted[:, legs] = True
    assert np.abs(target - motion)[:, legs].max() > 2 * MAX_REACH
    moved = reach(motion, Pins(target, wanted, certain=wanted), rigid(motion), FPS, foot_fix=False)
    np.testing.assert_allclose(moved[:, legs], other[:, legs], atol=5e-3)
    as_before = reach(motion, Pins(target, wanted), rigid(motion), FPS, foot_fix=False)
    assert np.abs(as_before - other)[:, legs].max() > MAX_REACH / 2


def test_a_smooth_field_with_slack_is_the_least_squares_solution() -> None:
    rng = np.random.default_rng(1)
    at, slack = np.arange(20) % 3 > 0, 2e-3
    known = rng.normal(0.0, 0.02, (20, 2))
    field = smooth_field(known, at, FPS, slack)
    # the same as one stacked least-squares problem
    rows = [*(np.diff(np.eye(20), n=2, axis=0) * FPS**2)]
    goals = [np.zeros(2)] * len(rows)
    for frame in range(20):
        scale = slack if at[frame] else METRES_PER_ACCELERATION
        rows.append(np.eye(20)[frame] / scale)
        goals.append((known[frame] if at[frame] else np.zeros(2)) / scale)
    np.testing.assert_allclose(field, np.linalg.lstsq(np.array(rows), np.array(goals))[0], atol=1e-8)


def test_a_body_cuts_the_corners_of_its_path() -> None:
    motion, wanted = stand(60), pins(60)
    corner = 0.04 * np.abs(np.arange(60) - 30)[:, None] / 20 * [1.0, 0.0, 0.0]
    wanted.target[:, PELVIS], wanted.wanted[:, PELVIS, [0, 2]] = motion[:, PELVIS] + corner - corner[0], True
    moved = reach(motion, wanted, rigid(motion), FPS, foot_fix=False)
    np.testing.assert_allclose(moved[:, PELVIS], wanted.target[:, PELVIS], atol=2e-3)
    neck = (moved - motion)[:, JOINT_INDEX["neck"], 0]
    assert np.abs(np.diff(neck, n=3)).max() < 0.5 * np.abs(np.diff(corner[:, 0], n=3)).max()


def test_a_pelvis_does_not_tilt_where_a_start_pose_goes_over_into_a_path() -> None:
    motion, wanted = walk(60), pins(60)
    wanted.target[:, PELVIS], wanted.wanted[:, PELVIS, [0, 2]] = motion[:, PELVIS], True
    wanted.target[:4], wanted.wanted[:4] = motion[:4], True
    wanted.target[:4, :, 2] += 0.01 * np.array([0.0, 0.8, 0.6, -0.6])[:, None]  # missed by millimetres that accelerate
    moved = reach(motion, wanted, rigid(motion), FPS, foot_fix=False)
    np.testing.assert_allclose(moved[:, PELVIS, [0, 2]], wanted.target[:, PELVIS, [0, 2]], atol=2e-3)
    assert np.abs(tilt(moved) - tilt(motion)).max() < 3
    assert np.abs(moved - motion)[4:].max() < 0.02


def test_hips_go_with_a_pelvis_round_a_corner() -> None:
    motion, wanted = stand(60), pins(60)
    corner = 0.2 * np.abs(np.arange(60) - 30)[:, None] / 20 * [1.0, 0.0, 0.0]
    wanted.target[:, PELVIS], wanted.wanted[:, PELVIS, [0, 2]] = motion[:, PELVIS] + corner - corner[30], True
    moved = reach(motion, wanted, rigid(motion), FPS, foot_fix=False)
    np.testing.assert_allclose(moved[:, PELVIS, [0, 2]], wanted.target[:, PELVIS, [0, 2]], atol=2e-3)
    assert np.abs(tilt(moved) - tilt(motion)).max() < 2


def test_a_smooth_field_is_the_least_squares_solution() -> None:
    rng = np.random.default_rng(0)
    at = np.zeros(30, dtype=np.bool_)
    at[[3, 4, 20]] = True
    known = 0.02 + rng.normal(0.0, 0.001, (30, 2))
    field = smooth_field(known, at, FPS)
    np.testing.assert_array_equal(field[at], known[at])

    def cost(values: np.ndarray) -> float:
        bent = np.diff(values, n=2, axis=0) * FPS**2
        return float((bent**2).sum() + ((values / METRES_PER_ACCELERATION) ** 2).sum())

    for _ in range(20):
        other = field + np.where(at[:, None], 0.0, rng.normal(0.0, 1e-4, field.shape))
        assert cost(other) > cost(field)
    assert np.abs(field[-1]).max() < 0.01 < np.abs(field[17]).max()


def test_a_standing_foot_is_moved_for_as_long_as_it_stands() -> None:
    motion, toe, ankle = stand(60), JOINT_INDEX["left_foot"], JOINT_INDEX["left_ankle"]
    wanted = pins(60)
    for joint in (toe, ankle):
        wanted.target[30, joint], wanted.wanted[30, joint] = motion[30, joint] + [0.0, 0.0, 0.03], True
    moved = reach(motion, wanted, rigid(motion), FPS, foot_fix=True)
    np.testing.assert_allclose(moved[30, toe], wanted.target[30, toe], atol=3e-3)
    np.testing.assert_allclose(moved[:, toe, 2], motion[:, toe, 2] + 0.03, atol=5e-3)  # also at the first frame
    slides = reach(motion, wanted, rigid(motion), FPS, foot_fix=False)
    assert abs(slides[0, toe, 2] - motion[0, toe, 2]) < 5e-3
