"""One body for clips of many: lengths, layout of the trunk, planted feet."""

from __future__ import annotations

import numpy as np
import pytest

from support.motions import walk
from support.shared import shared_path

pytest.importorskip("torch")

from kinegraph.motion.skeleton import FEET, JOINT_INDEX, bone_lengths, facing_angle
from kinegraph_training.data.clips import read_split
from kinegraph_training.data.common_skeleton import (
    _RESTS,
    BONE_LENGTHS,
    rest_directions,
    to_common_skeleton,
    trunk_frames,
)


def test_bones_have_the_common_lengths() -> None:
    joints = walk(50, turning=0.03).astype(np.float32)
    out = to_common_skeleton(joints, rest_directions([joints]))
    np.testing.assert_allclose(bone_lengths(out), np.tile(BONE_LENGTHS, (50, 1)), atol=1e-5)


def test_a_body_that_rests_elsewhere_is_brought_to_the_common_rest() -> None:
    joints = walk(50).astype(np.float32)
    raised = joints.copy()
    for side in ("left", "right"):  # a source whose collar bones rise from the chest
        for name in ("shoulder", "elbow", "wrist"):
            raised[:, JOINT_INDEX[f"{side}_{name}"], 1] += 0.08
    a, b = (to_common_skeleton(source, rest_directions([source])) for source in (joints, raised))
    shoulder = JOINT_INDEX["left_shoulder"]
    assert np.abs(a[:, shoulder] - b[:, shoulder]).max() < 0.02
    # Without the correction they would be apart.
    apart = to_common_skeleton(raised, rest_directions([joints]))
    assert np.abs(a[:, shoulder] - apart[:, shoulder]).max() > 0.03


def test_arms_and_legs_keep_their_directions_and_the_walk_its_heading() -> None:
    joints = walk(60, turning=0.02).astype(np.float32)
    out = to_common_skeleton(joints, rest_directions([joints]))
    for child, parent in (("left_knee", "left_hip"), ("right_ankle", "right_knee"), ("left_wrist", "left_elbow")):
        bones = [x[:, JOINT_INDEX[child]] - x[:, JOINT_INDEX[parent]] for x in (joints, out)]
        units = [bone / np.linalg.norm(bone, axis=-1, keepdims=True) for bone in bones]
        np.testing.assert_allclose(units[0], units[1], atol=1e-5)
    turned = [facing_angle(x)[-1] - facing_angle(x)[0] for x in (joints, out)]
    assert abs(turned[0] - turned[1]) < 0.02


def test_rests_are_mirror_images_and_the_frames_are_rotations() -> None:
    joints = walk(40).astype(np.float32)
    rests = rest_directions([joints])
    left, right = rests[JOINT_INDEX["left_collar"]], rests[JOINT_INDEX["right_collar"]]
    np.testing.assert_allclose(left * [-1, 1, 1], right, atol=1e-12)
    for frames in trunk_frames(joints):
        np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.tile(np.eye(3), (40, 1, 1)), atol=1e-9)
        np.testing.assert_allclose(np.linalg.det(frames), 1.0, atol=1e-9)
    assert set(_RESTS) == set(rests)


@pytest.mark.parametrize("name", ["bandai", "open"])
def test_real_feet_do_not_slide_more_than_before(name: str) -> None:
    clips = [clip.joints for clip in read_split(shared_path("data", name), "val")][:40]
    rests = rest_directions(clips)
    before, after = [], []
    for joints in clips:
        out = to_common_skeleton(joints, rests)
        for speeds, motion in ((before, joints), (after, out)):
            feet = motion[:, list(FEET)]
            moving = np.linalg.norm(np.diff(feet[..., [0, 2]], axis=0), axis=-1) * 20
            speeds.append(np.median(moving[feet[:-1, :, 1] < 0.08]) if (feet[:-1, :, 1] < 0.08).any() else 0.0)
    assert np.mean(after) < np.mean(before) + 0.03
