"""Clips stitched into one, where nothing jumps and bones and feet stay; and clips that loop round and round."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinegraph.clip import Clip
from kinegraph.errors import InvalidInputError
from kinegraph.formats import encode
from kinegraph.motion.blending import (
    BLEND_SECONDS,
    MAX_SHIFT,
    best_blend,
    best_loop,
    best_transition,
    blend_margins,
    canonical_poses,
    peak_accelerations,
    stitch,
)
from kinegraph.motion.postprocess import find_contacts
from kinegraph.motion.skeleton import JOINT_INDEX, bone_lengths, facing_angle
from support.motions import recorded, walk, with_recorded

FPS = 20.0
TOES = (JOINT_INDEX["left_foot"], JOINT_INDEX["right_foot"])


def clip(joints: np.ndarray, fps: float = FPS) -> Clip:
    return Clip(joints=joints, fps=fps, seed=1, text="a person walks", bundle="edge 1.2")


def motions() -> list[np.ndarray]:
    return with_recorded([walk(60), walk(60, turning=0.03)], 20)


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    """Rotate about Y, from +Z towards +X."""
    cos, sin = np.cos(angle), np.sin(angle)
    return points @ np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]])


def rounds(loop: np.ndarray, count: int) -> np.ndarray:
    """Play a loop with root motion: every round begins where, and facing as, the one before it ends."""
    floor = np.array([1.0, 0.0, 1.0])
    angle = float(facing_angle(loop)[-1] - facing_angle(loop)[0])
    shown = [loop[:-1].astype(np.float64)]
    for _ in range(count - 1):
        shown.append(turned(shown[-1] - loop[0, 0] * floor, angle) + loop[-1, 0] * floor)
    return np.concatenate(shown)


def fastest_standing_toe(joints: np.ndarray) -> float:
    """Measure the 99th percentile of the speed of planted toes, m/s."""
    speeds = [0.0]
    for toe in TOES:
        for start, end in find_contacts(joints[:, toe].astype(np.float64), FPS):
            speeds += (np.linalg.norm(np.diff(joints[start:end, toe][:, [0, 2]], axis=0), axis=-1) * FPS).tolist()
    return float(np.quantile(speeds, 0.99))


def test_one_clip_is_itself() -> None:
    joints = walk(40)
    np.testing.assert_array_equal(stitch([joints], FPS), joints)


def test_two_halves_of_a_walk_become_the_walk_again() -> None:
    original = walk(120, turning=0.02)
    first, second = original[:80], original[40:]
    second = second - second[:1, :1] * np.array([1, 0, 1])  # from its own origin, as every clip is
    a, b = best_transition(first, second, 10, FPS, end=60, start=20)
    assert abs(a - (40 + b)) <= 1  # the same moment of the walk
    stitched = stitch([first, second], FPS, leads=[0, 20], lengths=[60, 60])
    assert len(stitched) == 120
    assert peak_accelerations(stitched, FPS).max() < 1.5 * peak_accelerations(original, FPS).max()


@pytest.mark.parametrize("lengths", [(60, 60, 60), (30, 90, 40), (100, 20, 50)])
def test_every_part_keeps_its_length_and_its_motion(lengths: tuple[int, ...]) -> None:
    speeds = (0.02, 0.05, 0.08)  # metres a frame: each part is known by its pace
    margins = [blend_margins(FPS, first=index == 0, last=index == 2) for index in range(3)]
    leads = [before for before, _ in margins]
    clips = [
        walk(before + length + after, speed=speed)
        for (before, after), length, speed in zip(margins, lengths, speeds, strict=True)
    ]
    stitched = stitch(clips, FPS, leads=leads, lengths=lengths)
    assert len(stitched) == sum(lengths)
    ends = np.cumsum([0, *lengths])
    pace = np.linalg.norm(np.diff(stitched[:, 0][:, [0, 2]], axis=0), axis=-1)
    for start, end, speed in zip(ends[:-1], ends[1:], speeds, strict=True):
        reach = round((max(BLEND_SECONDS) / 2 + MAX_SHIFT) * FPS)
        inside = pace[start + reach : end - reach]
        assert len(inside) == 0 or np.median(inside) == pytest.approx(speed, abs=0.01)
        middle = (start + end) // 2
        assert abs(np.median(pace[middle - 3 : middle + 3]) - speed) < 0.016  # no part is swallowed


@pytest.mark.parametrize("headings", [(0.0, 2.0), (1.0, -3.0)])
def test_the_second_clip_goes_on_where_the_first_looks(headings: tuple[float, float]) -> None:
    first, second = (walk(60, heading=angle) for angle in headings)
    stitched = stitch([first, second], FPS)
    assert np.abs(facing_angle(stitched) - facing_angle(first)[0]).max() < 0.3
    steps = np.linalg.norm(np.diff(stitched[:, 0][:, [0, 2]], axis=0), axis=-1)
    np.testing.assert_allclose(steps[2:-2], 0.05, atol=0.03)


def test_recorded_clips_join_without_a_jump() -> None:
    clips = recorded(count=24)
    for first, second in zip(clips[::2], clips[1::2], strict=False):
        stitched = stitch([first, second], FPS)
        assert np.isfinite(stitched).all() and len(stitched) >= 0.5 * (len(first) + len(second))
        accelerations = np.concatenate([peak_accelerations(first, FPS), peak_accelerations(second, FPS)])
        blend = best_blend(first, second, FPS)
        # the blend, and the fifth of a second on either side in which feet come to be locked
        around = peak_accelerations(stitched, FPS)[max(0, blend.start - 6) : blend.start + blend.frames + 4]
        assert around.max() <= 2 * max(np.quantile(accelerations, 0.95), 10.0)
        lengths = bone_lengths(stitched)
        np.testing.assert_allclose(lengths, np.broadcast_to(lengths[:1], lengths.shape), atol=2e-3)


def test_hands_that_have_far_to_go_take_longer() -> None:
    low = np.repeat(walk(1), 60, axis=0)
    high = low.copy()
    arm = [JOINT_INDEX[name] for name in ("left_elbow", "left_wrist")]
    shoulder = low[:, [JOINT_INDEX["left_shoulder"]]]
    high[:, arm] = shoulder - (low[:, arm] - shoulder) * np.array([-1, 1, 1], dtype=np.float32)
    swaying = 0.002 * np.sin(np.arange(60) / 2).astype(np.float32)[:, None, None]
    clips = [low + swaying, high + swaying]
    assert best_blend(*clips, FPS).frames == round(BLEND_SECONDS[-1] * FPS) > best_blend(clips[0], clips[0], FPS).frames
    stitched = stitch(clips, FPS)
    # the arm goes round, it does not shrink
    lengths = bone_lengths(stitched)
    np.testing.assert_allclose(lengths, np.broadcast_to(lengths[:1], lengths.shape), atol=2e-3)


def test_feet_are_locked_during_a_blend_unless_foot_fix_is_off() -> None:
    drift = 0.002 * np.arange(40, dtype=np.float32)[:, None, None] * np.array([1, 0, 0], dtype=np.float32)
    clips = [np.repeat(walk(1), 40, axis=0) + sign * drift for sign in (1, -1)]
    locked, free = stitch(clips, FPS), stitch(clips, FPS, foot_fix=False)
    for toe in (JOINT_INDEX["left_foot"], JOINT_INDEX["right_foot"]):
        speed = [np.linalg.norm(np.diff(motion[:, toe][:, [0, 2]], axis=0), axis=-1) * FPS for motion in (locked, free)]
        assert speed[0].mean() < 0.1 * speed[1].mean()
    np.testing.assert_allclose(free[:15], clips[0][:15], atol=1e-5)  # a blend takes less than this from the end


@pytest.mark.parametrize("frames", [2, 4, 9])
def test_short_clips_join(frames: int) -> None:
    stitched = stitch([walk(frames), walk(30), walk(frames)], FPS)
    assert stitched.shape[1:] == (22, 3) and np.isfinite(stitched).all()


def test_the_last_frame_is_the_first_again() -> None:
    for joints in motions():
        loop = clip(joints).looped()
        assert loop.loops and len(joints) / 2 <= loop.frames <= len(joints)
        poses = canonical_poses(loop.joints)
        np.testing.assert_allclose(poses[-1], poses[0], atol=1e-5)
        assert np.ptp(bone_lengths(loop.joints), axis=0).max() < 1e-4


@pytest.mark.parametrize(("frames", "fps"), [(8, 30.0), (12, 60.0), (20, 120.0), (8, 240.0)])
def test_short_clips_of_many_frames_a_second_loop(frames: int, fps: float) -> None:
    loop = replace(clip(walk(frames)), fps=fps).looped()
    assert loop.loops and frames / 2 <= loop.frames <= frames


def test_long_clips_loop_in_reasonable_memory() -> None:
    first, last = best_loop(np.tile(walk(200), (60, 1, 1)), FPS)
    assert 0 <= first < last < 12_000 and last - first >= 5000


def test_nothing_jumps_or_slides_where_a_round_ends() -> None:
    for joints in motions():
        shown = rounds(clip(joints).looped().joints, 3)
        frames = len(shown) // 3
        usual = np.quantile(peak_accelerations(joints, FPS), 0.95)
        assert peak_accelerations(shown, FPS)[frames - 14 : frames + 4].max() <= 2.5 * max(usual, 10.0)
        assert fastest_standing_toe(shown) < max(0.1, 1.5 * fastest_standing_toe(joints))


def test_a_loop_in_place_ends_where_it_began_and_faces_the_same_way() -> None:
    for joints in motions():
        loop = clip(joints).looped().in_place()
        np.testing.assert_allclose(loop.joints[-1], loop.joints[0], atol=1e-5)
        # its poses are those of the loop
        poses = canonical_poses(clip(joints).looped().joints)
        np.testing.assert_allclose(canonical_poses(loop.joints), poses, atol=1e-4)


@pytest.mark.parametrize("fps", [24, 30, 60, 17.3])
def test_a_loop_at_another_frame_rate_is_a_loop(fps: float) -> None:
    loop = clip(walk(60)).looped()
    resampled = loop.resampled(fps)
    poses = canonical_poses(resampled.joints)
    np.testing.assert_allclose(poses[-1], poses[0], atol=1e-5)
    assert abs((resampled.frames - 1) / fps - (loop.frames - 1) / FPS) <= 0.5 / fps
    assert len(resampled.shown) == resampled.frames - 1 and len(clip(walk(9)).shown) == 9


def test_files_of_a_loop_end_with_their_first_key() -> None:
    for joints in motions():
        document = json.loads(encode(clip(joints).looped().in_place().resampled(30), ".json"))
        rotations = np.array(document["rotations"])
        np.testing.assert_allclose(np.abs((rotations[0] * rotations[-1]).sum(-1)), 1.0, atol=5e-5)
        np.testing.assert_allclose(document["joints"][0], document["joints"][-1], atol=2e-5)


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
    locked, free = (rounds(clip(joints).looped(foot_fix=fix).joints, 2)[:, TOES[0], 0] for fix in (True, False))
    assert np.ptp(locked) < 1e-4 < 1e-2 < np.ptp(free)


def test_any_frame_rate_can_loop() -> None:
    fast = clip(walk(60)).resampled(240)
    loop = fast.looped()
    assert fast.frames / 2 - 12 <= loop.frames <= fast.frames
    np.testing.assert_allclose(canonical_poses(loop.joints)[-1], canonical_poses(loop.joints)[0], atol=1e-5)


@settings(max_examples=20)
@given(st.integers(8, 60), st.floats(-0.1, 0.1))
def test_any_clip_can_loop_and_stays_finite(frames: int, turning: float) -> None:
    loop = clip(walk(frames, turning=turning)).looped()
    assert np.isfinite(loop.joints).all() and 5 <= loop.frames <= frames


def test_too_short_a_clip_cannot_loop() -> None:
    with pytest.raises(InvalidInputError, match="8 frames, this clip has 7"):
        clip(walk(7)).looped()


def test_a_loop_goes_on_at_the_speed_that_it_had() -> None:
    round_ = 36  # frames of a cycle of this walk
    joints = walk(4 * round_ + 1, cadence=2 * np.pi / round_)
    loop = clip(joints).looped(foot_fix=False).joints
    local = loop - loop[:, :1]
    speed = np.linalg.norm(np.diff(local, axis=0), axis=-1).mean(axis=-1)
    was = np.linalg.norm(np.diff(joints - joints[:, :1], axis=0), axis=-1).mean(axis=-1)
    assert speed[-6:].min() > 0.8 * was.min() and speed.max() < 1.2 * was.max()
    seam = np.concatenate([speed[-3:], speed[:3]])
    assert np.abs(np.diff(seam)).max() < 1.5 * np.abs(np.diff(was)).max()
