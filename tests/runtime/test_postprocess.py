"""Bones keep their length; planted feet are found and locked, by legs that reach without changing their bones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinegraph import MotionPipeline
from kinegraph.bundle.reader import read_bundle
from kinegraph.errors import BundleFormatError
from kinegraph.motion.postprocess import (
    CONTACT_SPEED,
    LEGS,
    MAX_CONTACT_SPEED,
    MAX_CORRECTION,
    MAX_EXTENSION,
    METRES_PER_JERK,
    RAMP_SECONDS,
    _toe_corrections,
    ease_corrections,
    enforce_bone_lengths,
    find_contacts,
    lock_feet,
    sliding_speed,
    two_bone_ik,
)
from kinegraph.motion.skeleton import JOINT_INDEX, PARENTS, bone_lengths
from support.motions import recorded, stand, walk
from support.synthetic_bundle import bundle_files, tables_npz, write_bundle

FPS = 20.0
TOES = [JOINT_INDEX["left_foot"], JOINT_INDEX["right_foot"]]
LEG_JOINTS = [joint for leg in LEGS for joint in leg[1:]]
LENGTHS = np.linspace(0.08, 0.45, 21, dtype=np.float32)


def with_bones(directions: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Place bones of these lengths in these directions (frames, 21, 3), joint by joint from the pelvis."""
    joints = np.zeros((len(directions), 22, 3))
    for child, parent in enumerate(PARENTS):
        if parent >= 0:
            bone = directions[:, child - 1]
            joints[:, child] = joints[:, parent] + lengths[child - 1] * bone / np.linalg.norm(bone, axis=1)[:, None]
    return joints.astype(np.float32)


def random_motion(lengths: np.ndarray, frames: int = 40) -> np.ndarray:
    """Move bones of these lengths at random; (frames, 22, 3)."""
    rng = np.random.default_rng(0)
    start, steps = rng.standard_normal((21, 3)), 0.05 * rng.standard_normal((frames, 21, 3))
    return with_bones(start + np.cumsum(steps, 0), lengths)


def test_a_motion_with_these_bones_stays_as_it_is() -> None:
    joints = random_motion(LENGTHS)
    np.testing.assert_allclose(enforce_bone_lengths(joints, LENGTHS), joints, atol=2e-6)


def test_lengths_come_out_exact_and_feet_hardly_move() -> None:
    true = random_motion(LENGTHS)
    noisy = true + np.random.default_rng(1).normal(0, 0.002, true.shape).astype(np.float32)
    projected = enforce_bone_lengths(noisy, LENGTHS)
    assert np.abs(bone_lengths(projected) - LENGTHS).max() < 1e-6
    moved = np.linalg.norm(projected - noisy, axis=-1)
    assert moved.mean() < 0.003
    plain = with_bones(noisy[:, 1:] - noisy[:, list(PARENTS[1:])], LENGTHS)
    assert moved[:, TOES].mean() < 0.5 * np.linalg.norm(plain - noisy, axis=-1)[:, TOES].mean()
    # nearer to the truth than before: a wrong length was noise
    assert np.linalg.norm(projected - true, axis=-1).mean() < np.linalg.norm(noisy - true, axis=-1).mean()


def test_without_lengths_each_bone_keeps_its_median() -> None:
    joints = random_motion(LENGTHS) + np.random.default_rng(1).normal(0, 0.002, (40, 22, 3)).astype(np.float32)
    lengths = bone_lengths(enforce_bone_lengths(joints, None))
    assert np.abs(lengths - np.median(bone_lengths(joints), axis=0)).max() < 1e-6


def test_joints_in_one_point_stay_finite() -> None:
    assert np.isfinite(enforce_bone_lengths(np.zeros((3, 22, 3), np.float32), LENGTHS)).all()


def test_input_is_left_alone() -> None:
    joints = 1.1 * random_motion(LENGTHS)
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


def test_bones_of_a_clip_do_not_stretch(toy: MotionPipeline) -> None:
    joints = toy.generate("a person walks", seconds=2, seed=1).joints
    assert np.ptp(bone_lengths(joints), axis=0).max() < 1e-5


def sliding(seed: int, drift: float = 0.004) -> np.ndarray:
    """Let a standing figure drift over the floor; (40, 22, 3)."""
    joints = np.repeat(walk(1), 40, axis=0).astype(np.float64)
    rng = np.random.default_rng(seed)
    wander = np.cumsum(rng.normal(0, drift, (40, 1, 3)), axis=0) * [1.0, 0.0, 1.0]
    return (joints + wander).astype(np.float32)


def slides(joints: np.ndarray, original: np.ndarray) -> float:
    """Measure the mean speed of toes, m/s, within the contacts of the original."""
    speeds = []
    for toe in TOES:
        for start, end in find_contacts(original[:, toe].astype(np.float64), FPS):
            speeds += (np.linalg.norm(np.diff(joints[start:end, toe][:, [0, 2]], axis=0), axis=-1) * FPS).tolist()
    return float(np.mean(speeds))


@pytest.mark.parametrize("seed", range(4))
def test_standing_toes_stand_still(seed: int) -> None:
    joints = sliding(seed)
    fixed = lock_feet(joints, FPS)
    assert slides(joints, joints) > 0.05
    assert slides(fixed, joints) < 0.3 * slides(joints, joints)


def test_recorded_feet_slide_less_and_nothing_else_changes() -> None:
    for joints in recorded(count=20):
        fixed = lock_feet(joints, FPS)
        np.testing.assert_allclose(bone_lengths(fixed), bone_lengths(joints), atol=1e-4)
        above = [joint for joint in range(22) if joint not in LEG_JOINTS]
        np.testing.assert_array_equal(fixed[:, above], joints[:, above])
        assert np.linalg.norm(fixed - joints, axis=-1).max() < 2 * MAX_CORRECTION
        if any(find_contacts(joints[:, toe].astype(np.float64), FPS) for toe in TOES):
            assert slides(fixed, joints) <= slides(joints, joints) + 1e-6


def stepping() -> np.ndarray:
    """Move a toe (60, 3) that drifts while it stands, steps, and drifts again."""
    toe = np.zeros((60, 3))
    toe[:22, 2] = np.linspace(0.0, 0.05, 22)
    toe[22:34, 2] = 0.05 + 0.8 * (0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 12)))
    toe[34:, 2] = np.linspace(0.85, 0.9, 26)
    toe[22:34, 1] = 0.1 * np.sin(np.linspace(0.0, np.pi, 12))
    toe[:, 0] = 0.01 * np.sin(np.arange(60) / 5)
    return toe


def test_beside_a_contact_the_toe_takes_the_path_of_least_jerk() -> None:
    toe = stepping()
    contacts, ramp = find_contacts(toe, FPS), round(RAMP_SECONDS * FPS)
    correction = ease_corrections(toe, _toe_corrections(toe, contacts, None), contacts, FPS)
    assert len(contacts) == 2
    for start, end in contacts:
        np.testing.assert_allclose(np.diff((toe + correction)[start:end, [0, 2]], axis=0), 0.0, atol=1e-12)
    near = {frame for start, end in contacts for frame in range(start - ramp, end + ramp)}
    free = sorted(near & set(range(60)) - {frame for start, end in contacts for frame in range(start, end)})
    assert free and not correction[sorted(set(range(60)) - near)].any() and not correction[:, 1].any()

    def cost(candidate: np.ndarray) -> float:
        x = np.concatenate([toe[:, [0, 2]] + candidate[:, [0, 2]]])
        third = (x[3:] - 3 * x[2:-1] + 3 * x[1:-2] - x[:-3]) * FPS**3
        return float((third**2).sum() + (candidate[free] ** 2).sum() / METRES_PER_JERK**2)

    rng = np.random.default_rng(0)
    for size in (1e-2, 1e-3, 1e-4):
        for _ in range(50):
            other = correction.copy()
            other[np.ix_(free, [0, 2])] += size * rng.normal(size=(len(free), 2))
            assert cost(other) > cost(correction)


def test_a_low_toe_slides_if_it_is_slower_than_the_body() -> None:
    assert sliding_speed(walk(60, speed=0.04), FPS) == pytest.approx(0.8, abs=0.01)
    assert sliding_speed(stand(60), FPS) == pytest.approx(CONTACT_SPEED)
    assert sliding_speed(walk(60, speed=0.12), FPS) == pytest.approx(MAX_CONTACT_SPEED)
    toe = np.zeros((40, 3))
    toe[10:20, 2] = 0.035 * np.arange(10)  # 0.7 m/s
    toe[20:, 2] = 0.35 + 0.1 * np.arange(20)
    assert find_contacts(toe, FPS) == [(0, 11)] and find_contacts(toe, FPS, 0.8) == [(0, 20)]


def test_recorded_legs_jerk_no_more_than_before() -> None:
    ratios = [jerk(lock_feet(joints, FPS)) / jerk(joints) for joints in recorded(count=30)]
    assert np.mean(ratios) <= 1.0


def jerk(joints: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(joints[:, LEG_JOINTS].astype(np.float64), n=3, axis=0), axis=-1).mean())


def test_a_contact_is_slow_low_and_long_enough() -> None:
    toe = np.zeros((60, 3))
    toe[20:40, 2] = np.linspace(0, 1.5, 20)  # 1.5 m in a second: a step
    toe[40:, 2] = 1.5
    toe[20:40, 1] = 0.1
    assert [(start <= 1, 18 <= end <= 21) for start, end in find_contacts(toe, FPS)[:1]] == [(True, True)]
    assert find_contacts(toe, FPS)[1][1] == 60 and len(find_contacts(toe, FPS)) == 2
    toe[5:15, 1] = 0.5  # in the air, however slow
    assert all(end - start >= 3 and (end <= 5 or start >= 15) for start, end in find_contacts(toe, FPS))
    assert find_contacts(toe[:2], FPS) == []


@settings(max_examples=60)
@given(st.integers(0, 10**6), st.floats(0.0, 0.3))
def test_a_leg_reaches_its_goal_or_as_far_as_it_goes(seed: int, away: float) -> None:
    rng = np.random.default_rng(seed)
    hip = rng.normal(size=(5, 3))
    knee = hip + 0.4 * (lambda v: v / np.linalg.norm(v, axis=-1, keepdims=True))(rng.normal(size=(5, 3)))
    ankle = knee + 0.42 * (lambda v: v / np.linalg.norm(v, axis=-1, keepdims=True))(rng.normal(size=(5, 3)))
    goal = ankle + away * rng.normal(size=(5, 3))
    new_knee, new_ankle = two_bone_ik(hip, knee, ankle, goal)
    np.testing.assert_allclose(np.linalg.norm(new_knee - hip, axis=-1), 0.4, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(new_ankle - new_knee, axis=-1), 0.42, atol=1e-6)
    distance = np.linalg.norm(goal - hip, axis=-1)
    reachable = (distance > 0.03) & (distance < MAX_EXTENSION * 0.82)
    np.testing.assert_allclose(new_ankle[reachable], goal[reachable], atol=1e-6)
    # otherwise in the direction of the goal
    off = np.cross(new_ankle - hip, goal - hip)
    np.testing.assert_allclose(off, 0, atol=1e-6 * max(1.0, float(distance.max())))


def test_a_goal_where_the_ankle_is_changes_nothing() -> None:
    joints = walk(30).astype(np.float64)
    for hip, knee, ankle, _ in LEGS:
        new_knee, new_ankle = two_bone_ik(joints[:, hip], joints[:, knee], joints[:, ankle], joints[:, ankle])
        np.testing.assert_allclose(new_knee, joints[:, knee], atol=1e-5)
        np.testing.assert_allclose(new_ankle, joints[:, ankle], atol=1e-5)


def test_a_leg_without_length_stays_a_point() -> None:
    point = np.zeros((3, 3))
    for joint in two_bone_ik(point, point, point, point + 0.1):
        np.testing.assert_allclose(joint, 0.0, atol=1e-6)


@pytest.mark.parametrize("frames", [1, 2, 3, 5])
def test_the_shortest_clips_pass(frames: int) -> None:
    assert lock_feet(walk(frames), FPS).shape == (frames, 22, 3)


@pytest.mark.parametrize("forward", [0.003, 0.01, 0.05])
@pytest.mark.parametrize("shift", [(0.0, 0.05), (0.0, -0.05), (0.05, 0.0), (-0.05, 0.0)])
def test_a_nearly_straight_knee_bends_the_way_it_did(forward: float, shift: tuple[float, float]) -> None:
    hip, ankle = np.array([[0.0, 0.85, 0.0]]), np.array([[0.0, 0.05, 0.0]])
    knee = np.array([[0.0, 0.45, forward]])
    sideways, ahead = shift
    new_knee, new_ankle = two_bone_ik(hip, knee, ankle, ankle + np.array([[sideways, 0.03, ahead]]))
    middle = (hip + new_ankle) / 2
    assert (new_knee - middle)[0, 2] > 0.0  # forward still
    if forward < 0.02:  # of a leg that is bent, the knee moves least
        assert abs((new_knee - middle)[0, 0]) < 0.01  # and not to a side
