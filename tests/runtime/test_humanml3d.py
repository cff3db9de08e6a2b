"""Layout humanml3d-263: the released code's numbers, both ways, and what each column means."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from kinegraph.errors import InvalidInputError
from kinegraph.motion import humanml3d as layout
from kinegraph.motion.humanml3d import (
    BONE_AXES,
    CHAINS,
    Heading,
    facing_directions,
    humanml3d_from_joints,
    joints_from_humanml3d,
)
from kinegraph.motion.skeleton import JOINT_INDEX, PARENTS, bone_lengths, canonicalise, facing_angle
from support.motions import recorded, t_pose, turn, walk
from support.shared import shared_path

HEADINGS = get_args(Heading)


@pytest.fixture(scope="module")
def official() -> dict[str, np.ndarray]:
    path = shared_path("fixtures", "official", "hml_process_synthetic.npz")
    with np.load(path, allow_pickle=False) as pack:
        return dict(pack)


def test_equals_the_released_code(official: dict[str, np.ndarray]) -> None:
    rows = humanml3d_from_joints(official["positions_in"], target_offsets=official["target_offsets"])
    expected = official["features"]
    assert rows.shape == expected.shape
    np.testing.assert_allclose(rows, expected, rtol=0, atol=5e-5)
    np.testing.assert_array_equal(rows[:, layout.CONTACTS], expected[:, layout.CONTACTS])


def test_the_released_code_does_not_face_where_the_body_faces(official: dict[str, np.ndarray]) -> None:
    rows = humanml3d_from_joints(official["positions_in"], heading="true", target_offsets=official["target_offsets"])
    assert np.abs(rows - official["features"]).max() > 1e-2


def test_recovers_the_released_code_s_joints(official: dict[str, np.ndarray]) -> None:
    back = joints_from_humanml3d(official["features"])
    np.testing.assert_allclose(back, official["global_positions"][:-1], rtol=0, atol=1e-5)


@pytest.mark.parametrize("heading", HEADINGS)
@pytest.mark.parametrize("turning", [0.0, 0.11, -0.07])
def test_walking_figure_comes_back(heading: Heading, turning: float) -> None:
    # 100 frames at 0.11 are a whole turn and three quarters: through the back, where quaternions change sign.
    joints = walk(100, turning=turning, heading=0.8)
    rows = humanml3d_from_joints(joints, heading=heading)
    assert rows.shape == (99, 263)
    assert rows.dtype == np.float32
    np.testing.assert_allclose(joints_from_humanml3d(rows), canonicalise(joints)[:-1], atol=2e-5)


@pytest.mark.parametrize("heading", HEADINGS)
def test_recorded_clips_come_back(heading: Heading) -> None:
    for joints in recorded():
        back = joints_from_humanml3d(humanml3d_from_joints(joints, heading=heading))
        assert np.linalg.norm(back - canonicalise(joints)[:-1], axis=-1).max() <= 1e-3


def test_placed_moves_a_clip_and_keeps_its_shape() -> None:
    joints = walk(30, turning=0.05, heading=2.0) + np.array([3.0, 1.5, -2.0], dtype=np.float32)
    moved = canonicalise(joints)
    np.testing.assert_allclose(moved[0, 0, [0, 2]], 0.0, atol=1e-6)
    assert moved[..., 1].min() == 0
    assert facing_angle(moved)[0] == pytest.approx(0.0, abs=1e-5)
    np.testing.assert_allclose(bone_lengths(moved), bone_lengths(joints), atol=1e-5)
    back = moved.astype(np.float64) @ turn("y", float(facing_angle(joints)[0])).T
    np.testing.assert_allclose(back - back[0, 0], joints - joints[0, 0], atol=1e-5)


def test_true_facing_is_the_body_s() -> None:
    joints = walk(40, turning=0.08)
    ahead = facing_directions(joints, heading="true", smooth=False)
    np.testing.assert_allclose(
        np.arctan2(ahead[:, 0], ahead[:, 2]) % 6.28319, facing_angle(joints) % 6.28319, atol=1e-4
    )


def test_the_released_facing_counts_the_hips_against_the_shoulders() -> None:
    still = t_pose(1)
    spread = still.copy()
    spread[:, JOINT_INDEX["left_hip"], 0] += 1.0
    np.testing.assert_allclose(facing_directions(still, heading="humanml3d", smooth=False), [[0, 0, 1]], atol=1e-6)
    np.testing.assert_allclose(facing_directions(spread, heading="humanml3d", smooth=False), [[0, 0, -1]], atol=1e-6)
    np.testing.assert_allclose(facing_directions(spread, heading="true", smooth=False), [[0, 0, 1]], atol=1e-6)


def test_yaw_velocity_is_half_the_turn_to_the_right() -> None:
    steps = [turn("y", 0.2 * frame) for frame in range(5)]
    joints = np.stack([t_pose(1)[0].astype(np.float64) @ step.T for step in steps]).astype(np.float32)
    rows = humanml3d_from_joints(joints, heading="true")
    np.testing.assert_allclose(rows[:, layout.YAW_VELOCITY], -0.1, atol=1e-5)


def test_rotations_turn_the_bones() -> None:
    joints = canonicalise(walk(20, turning=0.05))
    rows = humanml3d_from_joints(joints, heading="true")
    columns = rows[:, layout.ROTATIONS].reshape(-1, 21, 2, 3).astype(np.float64)
    x, y = columns[..., 0, :], columns[..., 1, :]
    local = np.stack([x, y, np.cross(x, y, axis=-1)], axis=-1)
    np.testing.assert_allclose(local.swapaxes(-1, -2) @ local, np.broadcast_to(np.eye(3), local.shape), atol=1e-5)
    for frame in (0, 7, 18):
        root = turn("y", -float(facing_angle(joints)[frame])) if frame else np.eye(3)
        for chain in CHAINS:
            axes = root
            for joint in chain[1:]:
                axes = axes @ local[frame, joint - 1]
                bone = joints[frame, joint] - joints[frame, PARENTS[joint]]
                np.testing.assert_allclose(axes @ BONE_AXES[joint], bone / np.linalg.norm(bone), atol=1e-4)


def test_retargeting_gives_the_wanted_bones_and_keeps_the_motion() -> None:
    joints = walk(30)
    lengths = np.concatenate([[0.0], bone_lengths(joints)[0]])
    target = BONE_AXES * lengths[:, None] * 1.3
    rows = humanml3d_from_joints(joints, heading="true", target_offsets=target)
    back = joints_from_humanml3d(rows)
    np.testing.assert_allclose(bone_lengths(back), np.broadcast_to(lengths[1:] * 1.3, (29, 21)), atol=1e-4)
    np.testing.assert_allclose(back, canonicalise(joints)[:-1] * 1.3, atol=5e-3)


def test_three_frames_are_no_special_case() -> None:
    three = walk(3, turning=0.05)
    longer = np.concatenate([three, three[1::-1]])
    short = humanml3d_from_joints(three, heading="true")
    np.testing.assert_allclose(short, humanml3d_from_joints(longer, heading="true")[:2], atol=1e-6)


def test_groups_cover_every_column_once() -> None:
    assert [index for group in layout.GROUPS for index in range(263)[group]] == list(range(263))


@pytest.mark.parametrize(
    ("joints", "options", "message"),
    [
        (np.zeros((1, 22, 3)), {}, "two frames"),
        (np.zeros((5, 21, 3)), {}, r"\(5, 21, 3\)"),
        (walk(5), {"heading": "north"}, "north.*humanml3d, true"),
        (walk(5), {"target_offsets": np.zeros((21, 3))}, "target_offsets"),
        (walk(5), {"target_offsets": np.full((22, 3), np.nan)}, "target_offsets"),
        (walk(5), {"target_offsets": np.zeros((22, 3))}, "leg has no length"),
    ],
)
def test_refuses(joints: np.ndarray, options: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        humanml3d_from_joints(joints, **options)  # type: ignore[arg-type]
