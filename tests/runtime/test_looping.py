"""Clips that can be played round and round."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinegraph.clip import Clip
from kinegraph.errors import InvalidInputError
from kinegraph.formats import encode
from kinegraph.motion.blending import canonical_poses, peak_accelerations
from kinegraph.motion.postprocess import find_contacts
from kinegraph.motion.skeleton import JOINT_INDEX, bone_lengths, facing_angle
from support.motions import recorded, walk

FPS = 20.0
TOES = (JOINT_INDEX["left_foot"], JOINT_INDEX["right_foot"])


def clip(joints: np.ndarray, fps: float = FPS) -> Clip:
    return Clip(joints=joints, fps=fps, seed=1, text="a person walks", bundle="edge 1.2")


def motions() -> list[np.ndarray]:
    return [walk(60), walk(60, turning=0.03), *recorded(count=20)]


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    """About Y, from +Z towards +X."""
    cos, sin = np.cos(angle), np.sin(angle)
    return points @ np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]])


def rounds(loop: np.ndarray, count: int) -> np.ndarray:
    """What a player with root motion shows: every round begins where and whither the one before it ends."""
    floor = np.array([1.0, 0.0, 1.0])
    angle = float(facing_angle(loop)[-1] - facing_angle(loop)[0])
    shown = [loop[:-1].astype(np.float64)]
    for _ in range(count - 1):
        shown.append(turned(shown[-1] - loop[0, 0] * floor, angle) + loop[-1, 0] * floor)
    return np.concatenate(shown)


def fastest_standing_toe(joints: np.ndarray) -> float:
    """m/s: the 99th percentile over the frames in which a toe stands."""
    speeds = [0.0]
    for toe in TOES:
        for start, end in find_contacts(joints[:, toe].astype(np.float64), FPS):
            speeds += (np.linalg.norm(np.diff(joints[start:end, toe][:, [0, 2]], axis=0), axis=-1) * FPS).tolist()
    return float(np.quantile(speeds, 0.99))


def test_the_last_frame_is_the_first_again() -> None:
    for joints in motions():
        found = clip(joints).looped()
        assert found.loops and len(joints) / 2 <= found.frames <= len(joints)
        poses = canonical_poses(found.joints)
        np.testing.assert_allclose(poses[-1], poses[0], atol=1e-5)
        assert np.ptp(bone_lengths(found.joints), axis=0).max() < 1e-4


def test_nothing_jumps_or_slides_where_a_round_ends() -> None:
    for joints in motions():
        shown = rounds(clip(joints).looped().joints, 3)
        frames = len(shown) // 3
        own = np.quantile(peak_accelerations(joints, FPS), 0.95)
        assert peak_accelerations(shown, FPS)[frames - 14 : frames + 4].max() <= 2.5 * max(own, 10.0)
        assert fastest_standing_toe(shown) < max(0.1, 1.2 * fastest_standing_toe(joints))


def test_a_loop_in_place_ends_exactly_where_and_whither_it_began() -> None:
    for joints in motions():
        found = clip(joints).looped().in_place()
        np.testing.assert_allclose(found.joints[-1], found.joints[0], atol=1e-5)
        # every pose of it is that of the loop
        poses = canonical_poses(clip(joints).looped().joints)
        np.testing.assert_allclose(canonical_poses(found.joints), poses, atol=1e-4)


@pytest.mark.parametrize("fps", [24, 30, 60, 17.3])
def test_a_loop_at_another_frame_rate_is_a_loop(fps: float) -> None:
    loop = clip(walk(60)).looped()
    found = loop.resampled(fps)
    np.testing.assert_allclose(canonical_poses(found.joints)[-1], canonical_poses(found.joints)[0], atol=1e-5)
    assert abs((found.frames - 1) / fps - (loop.frames - 1) / FPS) <= 0.5 / fps
    assert len(found.shown) == found.frames - 1 and len(clip(walk(9)).shown) == 9


def test_files_of_a_loop_end_with_their_first_key() -> None:
    for joints in motions():
        found = json.loads(encode(clip(joints).looped().in_place().resampled(30), ".json"))
        turns = np.array(found["rotations"])
        np.testing.assert_allclose(np.abs((turns[0] * turns[-1]).sum(-1)), 1.0, atol=5e-5)
        np.testing.assert_allclose(found["joints"][0], found["joints"][-1], atol=2e-5)


def test_who_stays_does_not_creep_and_who_walks_straight_stays_straight() -> None:
    standing = walk(60, speed=0.001)
    assert np.linalg.norm(np.diff(clip(standing).looped().joints[[0, -1], 0], axis=0)) < 1e-5
    bent = clip(walk(60, turning=0.004)).looped()
    assert abs(facing_angle(bent.joints)[-1]) < 1e-4 and np.linalg.norm(bent.joints[-1, 0, [0, 2]]) > 1.0
    around = clip(walk(60, turning=0.05)).looped()
    assert abs(facing_angle(around.joints)[-1]) > 1.0


def test_feet_are_left_alone_on_request() -> None:
    sway = 0.01 * np.sin(np.arange(60) / 3).astype(np.float32)[:, None, None] * np.array([1, 0, 0], dtype=np.float32)
    joints = np.repeat(walk(1), 60, axis=0) + sway
    held, left = (rounds(clip(joints).looped(foot_fix=fix).joints, 2)[:, TOES[0], 0] for fix in (True, False))
    assert np.ptp(held) < 1e-4 < 1e-2 < np.ptp(left)


def test_any_frame_rate_can_loop() -> None:
    fast = clip(walk(60)).resampled(240)
    found = fast.looped()
    assert fast.frames / 2 - 12 <= found.frames <= fast.frames
    np.testing.assert_allclose(canonical_poses(found.joints)[-1], canonical_poses(found.joints)[0], atol=1e-5)


@settings(max_examples=20)
@given(st.integers(8, 60), st.floats(-0.1, 0.1))
def test_any_clip_can_loop_and_stays_finite(frames: int, turning: float) -> None:
    found = clip(walk(frames, turning=turning)).looped()
    assert np.isfinite(found.joints).all() and 5 <= found.frames <= frames


def test_too_short_a_clip_cannot_loop() -> None:
    with pytest.raises(InvalidInputError, match="8 frames, this clip has 7"):
        clip(walk(7)).looped()
