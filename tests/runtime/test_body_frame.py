"""The frame of a body: points come into the world and back, and parts go on where the motion before has come to."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.motion.body_frame import BodyFrame, append_part
from kinegraph.motion.skeleton import PELVIS, facing_angle, start_at_origin
from support.motions import walk

WHERE = BodyFrame(np.array([1.0, 0.0, 2.0]), np.pi / 2)
"""At (1, 2), facing +X."""


def test_a_frame_brings_points_into_the_world_and_back() -> None:
    ahead = np.array([0.0, 1.5, 1.0])  # a metre ahead is a metre towards +X
    np.testing.assert_allclose(WHERE.to_world(ahead), [2.0, 1.5, 2.0], atol=1e-9)
    np.testing.assert_allclose(WHERE.to_body([2.0, 1.5, 2.0]), ahead, atol=1e-9)
    np.testing.assert_allclose(WHERE.floor_to_body([[2.0, 2.0], [1.0, 3.0]]), [[0, 1], [-1, 0]], atol=1e-9)


def test_a_pose_is_at_the_origin_of_its_own_frame() -> None:
    pose = WHERE.to_world(walk(30)[20])
    back = BodyFrame.of(pose).to_body(pose)
    np.testing.assert_allclose(back[PELVIS, [0, 2]], 0, atol=1e-5)
    assert float(facing_angle(back[None])[0]) == pytest.approx(0, abs=1e-5)
    np.testing.assert_allclose(back[:, 1], pose[:, 1])
    motion = WHERE.to_world(walk(30, turning=0.05))
    np.testing.assert_allclose(BodyFrame.of(motion[0]).to_body(motion), start_at_origin(motion), atol=1e-5)


def test_a_part_goes_on_where_the_motion_has_come_to() -> None:
    motion = WHERE.to_world(walk(40, turning=0.03)).astype(np.float32)
    whole = append_part(motion[:24], start_at_origin(motion[20:]), 4)
    np.testing.assert_allclose(whole, motion, atol=1e-5)
    assert whole.dtype == np.float32
