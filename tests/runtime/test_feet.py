"""Feet that stand: found, held, and legs that reach without changing their bones."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinegraph.motion.postprocess import (
    LEGS,
    MAX_CORRECTION,
    MAX_EXTENSION,
    METRES_PER_JERK,
    RAMP_SECONDS,
    _toe_corrections,
    find_contacts,
    lock_feet,
    two_bone_ik,
)
from kinegraph.motion.skeleton import JOINT_INDEX, bone_lengths
from support.motions import recorded, walk

FPS = 20.0
TOES = [JOINT_INDEX["left_foot"], JOINT_INDEX["right_foot"]]


def sliding(seed: int, drift: float = 0.004) -> np.ndarray:
    """A figure that stands while its legs drift over the floor; (frames, 22, 3)."""
    joints = np.repeat(walk(1), 40, axis=0).astype(np.float64)
    rng = np.random.default_rng(seed)
    wander = np.cumsum(rng.normal(0, drift, (40, 1, 3)), axis=0) * [1.0, 0.0, 1.0]
    return (joints + wander).astype(np.float32)


def slides(joints: np.ndarray, original: np.ndarray) -> float:
    """Mean speed of toes, m/s, within the contacts of the original."""
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
        legs = [joint for side in LEGS for joint in side[1:]]
        above = [joint for joint in range(22) if joint not in legs]
        np.testing.assert_array_equal(fixed[:, above], joints[:, above])
        assert np.linalg.norm(fixed - joints, axis=-1).max() < 2 * MAX_CORRECTION
        found = [bool(find_contacts(joints[:, toe].astype(np.float64), FPS)) for toe in TOES]
        if any(found):
            assert slides(fixed, joints) <= slides(joints, joints) + 1e-6


def stepping() -> np.ndarray:
    """(60, 3): a toe that drifts while it stands, steps, and drifts again."""
    toe = np.zeros((60, 3))
    toe[:22, 2] = np.linspace(0.0, 0.05, 22)
    toe[22:34, 2] = 0.05 + 0.8 * (0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 12)))
    toe[34:, 2] = np.linspace(0.85, 0.9, 26)
    toe[22:34, 1] = 0.1 * np.sin(np.linspace(0.0, np.pi, 12))
    toe[:, 0] = 0.01 * np.sin(np.arange(60) / 5)
    return toe


def test_beside_a_contact_the_toe_takes_the_path_of_least_jerk() -> None:
    toe = stepping()
    shift = _toe_corrections(toe, FPS)
    held, ramp = find_contacts(toe, FPS), round(RAMP_SECONDS * FPS)
    assert len(held) == 2
    for start, end in held:
        np.testing.assert_allclose(np.diff((toe + shift)[start:end, [0, 2]], axis=0), 0.0, atol=1e-12)
    near = {frame for start, end in held for frame in range(start - ramp, end + ramp)}
    free = sorted(near & set(range(60)) - {frame for start, end in held for frame in range(start, end)})
    assert free and not shift[sorted(set(range(60)) - near)].any() and not shift[:, 1].any()

    def cost(correction: np.ndarray) -> float:
        x = np.concatenate([toe[:, [0, 2]] + correction[:, [0, 2]]])
        third = (x[3:] - 3 * x[2:-1] + 3 * x[1:-2] - x[:-3]) * FPS**3
        return float((third**2).sum() + (correction[free] ** 2).sum() / METRES_PER_JERK**2)

    rng = np.random.default_rng(0)
    for size in (1e-2, 1e-3, 1e-4):
        for _ in range(50):
            other = shift.copy()
            other[np.ix_(free, [0, 2])] += size * rng.normal(size=(len(free), 2))
            assert cost(other) > cost(shift)


def test_recorded_legs_jerk_no_more_than_before() -> None:
    ratios = [jerk(lock_feet(joints, FPS)) / jerk(joints) for joints in recorded(count=30)]
    assert np.mean(ratios) <= 1.0


def jerk(joints: np.ndarray) -> float:
    legs = [joint for side in LEGS for joint in side[1:]]
    return float(np.linalg.norm(np.diff(joints[:, legs].astype(np.float64), n=3, axis=0), axis=-1).mean())


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


@pytest.mark.parametrize("frames", [1, 2, 3, 5])
def test_the_shortest_clips_pass(frames: int) -> None:
    assert lock_feet(walk(frames), FPS).shape == (frames, 22, 3)
