"""Constraints: what each may say, and what they may say together."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import kinegraph
from kinegraph import Clip, EndPose, InvalidInputError, JointTarget, Keyframe, Loop, Path, StartPose, Waypoint
from kinegraph.constraints import describe, joint_name
from kinegraph.feasibility import check_constraints, frame_of
from kinegraph.limits import MAX_CONSTRAINTS, MAX_KEYFRAMES, MAX_PATH_POINTS, MAX_POSE_FRAMES
from kinegraph.motion.kinematics import REST_OFFSETS, forward_kinematics, rest_pose, rotations_from_positions
from kinegraph.motion.quaternions import to_matrix
from kinegraph.motion.skeleton import JOINT_NAMES, PELVIS, facing_angle
from support.motions import t_pose, walk

LONG = 1e400  # infinity, as JSON readers make it
IDENTITIES = np.tile([1.0, 0.0, 0.0, 0.0], (22, 1))


def clip(frames: int = 60, fps: float = 20.0, **how: Any) -> Clip:
    return Clip(walk(frames, **how), fps, 1, "a person walks", "test 1")


@pytest.mark.parametrize(
    "name", ["EndPose", "JointTarget", "Keyframe", "Loop", "Miss", "Path", "StartPose", "Waypoint"]
)
def test_constraints_are_public(name: str) -> None:
    assert name in kinegraph.__all__
    assert getattr(kinegraph, name).__module__ == "kinegraph.constraints"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Path([(0, 0)]), "2 to 1000 points, not 1"),
        (lambda: Path(np.zeros((MAX_PATH_POINTS + 1, 2))), "not 1001"),
        (lambda: Path([(0, 0, 0), (1, 1, 1)]), r"shape \(2, 3\)"),
        (lambda: Path([(0, 0), (1, math.nan)]), r"not finite at index \(1, 1\)"),
        (lambda: Path([(0, 0), (1, LONG)]), "not finite"),
        (lambda: Path([(0, 0), (1,)]), "no array of shape"),
        (lambda: Path("0,0 1,1"), "must be an array"),
        (lambda: Path([("a", "b"), ("c", "d")]), "real numbers"),
        (lambda: Path([(0, 0), (1, 1001)]), "1001 m"),
        (lambda: Path([(0, 0), (1, 1)], times=[0, 1, 2]), "the times of a path have shape"),
        (lambda: Path([(0, 0), (1, 1)], times=[1, 1]), "must rise"),
        (lambda: Path([(0, 0), (1, 1)], times=[-1, 1]), "must rise from 0 s"),
        (lambda: Path([(0, 0), (1, 1)], heading="forward"), "'forward'"),
        (lambda: Path([(0, 0), (1, 1)], heading=[0]), "the heading of a path have shape"),
        (lambda: Path([(0, 0), (1, 1)], weight=-1), "weight of a path must be 0 to 100, not -1"),
        (lambda: Path([(0, 0), (1, 1)], weight=True), "not True"),
        (lambda: Waypoint(-1, (0, 0)), "from 0 on, not -1"),
        (lambda: Waypoint("1", (0, 0)), "'1'"),
        (lambda: Waypoint(1, (0, 0, 0)), r"at \(x, z\) in metres"),
        (lambda: Waypoint(1, (0, None)), "z of a waypoint must be metres, not None"),
        (lambda: Waypoint(1, (math.inf, 0)), "x of a waypoint must be metres, not inf"),
        (lambda: Waypoint(1, (0, 2000)), "2000 m"),
        (lambda: Waypoint(1, (0, 0), heading="left"), "degrees or None"),
        (lambda: Waypoint(1, (0, 0), weight=math.nan), "not nan"),
        (lambda: JointTarget("left paw", (0, 0, 0), 1), "no joint 'left paw'"),
        (lambda: JointTarget(9, (0, 0, 0), 1), "no joint 9"),
        (lambda: JointTarget("head", (None, None, None), 1), "no axis that is not free"),
        (lambda: JointTarget("head", (0, 1), 1), r"\(x, y, z\)"),
        (lambda: JointTarget("head", (0, 1, 0), (1, 2, 3)), "not 3 times"),
        (lambda: JointTarget("head", (0, 1, 0), (2, 1)), "ends at 1 s, before it begins at 2 s"),
        (lambda: JointTarget("head", (0, 1, 0), None), "must be seconds from 0 on, not None"),
        (lambda: JointTarget("head", (0, 10**400, 0), 1), "y of the target of head"),
        (lambda: Keyframe(1, np.zeros((21, 3))), r"shape \(21, 3\)"),
        (lambda: Keyframe(1, np.full((22, 3), np.nan)), "not finite"),
        (lambda: Keyframe(1, t_pose()[0], anywhere=1), "anywhere must be True or False"),
        (lambda: Keyframe.of(clip(), 3.5), "has 3 s and no pose at 3.5 s"),
        (lambda: Keyframe.from_rotations(1, IDENTITIES[:21], (0, 1, 0)), r"shape \(21, 4\)"),
        (lambda: Keyframe.from_rotations(1, np.zeros((22, 4)), (0, 1, 0)), "hold no rotation at index 0"),
        (lambda: Keyframe.from_rotations(1, -np.tile(np.eye(3), (22, 1, 1)), (0, 1, 0)), "no rotation at index 0"),
        (lambda: Keyframe.from_rotations(1, np.full((22, 3, 3), math.nan), (0, 1, 0)), "not finite"),
        (lambda: Keyframe.from_rotations(1, [[[[[]]]]], (0, 1, 0)), "have shape"),
        (lambda: Keyframe.from_rotations(1, IDENTITIES, (0, 1)), "the root of a keyframe have shape"),
        (lambda: Keyframe.from_rotations(1, IDENTITIES, (0, 1, 0), np.zeros((22, 2))), "rest_offsets"),
        (lambda: Keyframe.of(t_pose(), 0), "taken from a Clip"),
        (lambda: StartPose(t_pose(MAX_POSE_FRAMES + 1)), "1 to 40 frames, not 41"),
        (lambda: StartPose(np.zeros((0, 22, 3))), "not 0"),
        (lambda: StartPose("clip.npz"), "'clip.npz'"),
        (lambda: EndPose(np.zeros((4, 24, 3))), r"shape \(4, 24, 3\)"),
        (lambda: EndPose(t_pose(), fps=0), "fps must be 1 to 240"),
        (lambda: Loop(-0.5), "weight of a loop"),
    ],
)
def test_wrong_values_are_named(make: Any, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        make()


def test_rotations_pose_the_body_as_they_do_in_a_clip() -> None:
    joints = walk(30, turning=0.04)
    motion = rotations_from_positions(joints, 20.0)
    solved = forward_kinematics(motion.rest_offsets, motion.root, motion.rotations)
    turns, root = motion.rotations[17], motion.root[17]
    for given in (turns, to_matrix(turns), to_matrix(turns).tolist(), -turns):  # -q turns as q does
        keyframe = Keyframe.from_rotations(1.5, given, root, motion.rest_offsets, weight=2, anywhere=True)
        np.testing.assert_allclose(keyframe.joints, solved[17], atol=1e-6)
        np.testing.assert_allclose(keyframe.joints, joints[17], atol=motion.error.max() + 1e-6)
    assert (keyframe.seconds, keyframe.weight, keyframe.anywhere) == (1.5, 2, True)
    ours = Keyframe.from_rotations(1, IDENTITIES, (0.5, 0.95, 0))
    standing = rest_pose(REST_OFFSETS)
    np.testing.assert_allclose(ours.joints - ours.joints[0], standing - standing[0], atol=1e-6)
    assert ours.joints[PELVIS].tolist() == pytest.approx([0.5, 0.95, 0])


def test_arrays_are_copied_and_frozen() -> None:
    points, pose = np.array([[0.0, 0.0], [1.0, 2.0]]), t_pose()
    path, keyframe, start = Path(points), Keyframe(1, pose[0]), StartPose(pose)
    points[:], pose[:] = 9, 9
    assert path.points.tolist() == [[0, 0], [1, 2]]
    assert keyframe.joints.max() < 2 and start.joints.max() < 2
    for array in (path.points, keyframe.joints, start.joints):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


@pytest.mark.parametrize(
    ("written", "joint"),
    [("left hand", "left_wrist"), ("Right-Hand", "right_wrist"), ("left foot", "left_foot"), ("root", "pelvis")],
)
def test_joints_have_everyday_names(written: str, joint: str) -> None:
    assert joint_name(written) == joint
    assert JOINT_NAMES[JointTarget(written, (None, 1.0, None), 1).index] == joint


def test_a_path_without_times_has_an_even_pace() -> None:
    path = Path([(0, 0), (0, 1), (3, 1)])
    assert path.length == 4
    assert path.moments(8).tolist() == [0, 2, 8]
    times = np.linspace(0, 8, 81)
    steps = np.linalg.norm(np.diff(path.positions(times, 8), axis=0), axis=1)
    np.testing.assert_allclose(steps, 0.05, atol=1e-12)
    assert path.covers(times, 8).all()
    assert path.headings(times, 8) is None


def test_a_path_that_stands_still_has_no_direction() -> None:
    path = Path([(1, 1), (1, 1)], heading="along")
    times = np.linspace(0, 2, 5)
    assert path.positions(times, 2).tolist() == [[1, 1]] * 5
    assert path.headings(times, 2) is None


def test_a_path_with_times_is_free_outside_them() -> None:
    path = Path([(0, 0), (2, 0)], times=[1, 2])
    assert path.covers(np.array([0.95, 1.0, 1.5, 2.0, 2.05]), 4).tolist() == [0, 1, 1, 1, 0]
    assert path.positions(np.array([0.0, 1.25, 4.0]), 4).tolist() == [[0, 0], [0.5, 0], [2, 0]]


def test_headings_turn_to_the_left_with_positive_degrees() -> None:
    left = Path([(0, 0), (0, 1), (1, 1)], heading="along").headings(np.array([0.0, 0.5, 1.0, 1.5, 2.0]), 2)
    np.testing.assert_allclose(np.degrees(left), [0, 0, 90, 90, 90])
    around = Path([(0, 0), (0, 1)], heading=[170, -170]).headings(np.array([0.0, 1.0, 2.0]), 2)
    np.testing.assert_allclose(np.degrees(around), [170, 180, 190])  # the shorter way round
    # the body of the tests that turns by +90 degrees faces +X
    assert facing_angle(walk(1, heading=math.pi / 2))[0] == pytest.approx(math.pi / 2, abs=1e-5)


def test_a_keyframe_is_the_nearest_frame_of_a_clip() -> None:
    made = clip()
    keyframe = Keyframe.of(made, 1.01, at=2)
    assert keyframe.seconds == 2
    assert (keyframe.joints == made.joints[20]).all()
    assert Keyframe.of(made, 3.0).joints.tolist() == made.joints[-1].tolist()  # its end is its last frame


def test_poses_of_clips_are_their_ends() -> None:
    made = clip(fps=30)
    assert (StartPose(made).joints == made.joints[-6:]).all()
    assert (EndPose(made).joints == made.joints[:6]).all()
    assert StartPose(made).fps == 30


@pytest.mark.parametrize(("kind", "anchor"), [(StartPose, 0), (EndPose, -1)])
def test_poses_are_placed_at_the_origin_and_keep_their_height(kind: Any, anchor: int) -> None:
    frames = walk(8, heading=2.0, turning=0.5) + np.array([3.0, 0.4, -2.0], dtype=np.float32)
    placed = kind(frames).frames(20)
    assert placed.shape == frames.shape
    np.testing.assert_allclose(placed[anchor, PELVIS, [0, 2]], 0, atol=1e-6)
    assert facing_angle(placed[[anchor]])[0] == pytest.approx(0, abs=1e-5)
    np.testing.assert_allclose(placed[..., 1], frames[..., 1], atol=1e-6)
    distances = [np.linalg.norm(pose[:, :, None] - pose[:, None], axis=-1) for pose in (placed, frames)]
    np.testing.assert_allclose(*distances, atol=1e-5)


def test_poses_of_another_rate_are_resampled() -> None:
    assert len(StartPose(clip(fps=60)).frames(20)) == 4
    assert len(StartPose(t_pose(3)).frames(20)) == 3


KEY = Keyframe(1, t_pose()[0])


@pytest.mark.parametrize(
    ("constraints", "message"),
    [
        (Waypoint(1, (0, 1)), "put the Waypoint into one"),
        ("walk", "a list of Path"),
        ([Waypoint(1, (0, 1)), "walk"], r"constraints\[1\] is 'walk'"),
        ([Waypoint(1, (0, 1))] * (MAX_CONSTRAINTS + 1), "257 constraints; 256 at most"),
        ([KEY] * (MAX_KEYFRAMES + 1), "65 keyframes; 64 at most"),
        ([Waypoint(4.1, (0, 1))], r"constraints\[0\], waypoint at 4.1 s: 4.1 s is after the end"),
        ([JointTarget("head", (None, 1, None), (3, 5))], "5 s is after the end"),
        ([Path([(0, 0), (0, 1)], times=[0, 9])], "9 s is after the end"),
        ([Keyframe(5, t_pose()[0])], "5 s is after the end"),
        ([StartPose(t_pose(5), fps=1)], "it lasts 5 s, the clip 4 s"),
        ([Loop(), Loop()], "2 constraints are a Loop"),
        ([StartPose(t_pose()), StartPose(t_pose())], "2 constraints are a StartPose"),
        ([Waypoint(1, (0, 1)), Waypoint(1, (0, 2))], "want one joint at one moment 1 m apart"),
        ([Path([(0, 0), (0, 4)]), Waypoint(4, (0, 2))], "waypoint at 4 s, want one joint"),
        ([JointTarget("head", (None, 1, 0), (1, 3)), JointTarget("head", (None, 1.5, None), 2)], "0.5 m apart"),
        ([KEY, JointTarget("left hand", (0, 1.9, 0), 1)], "want one joint"),
        ([KEY, Waypoint(1, (2, 0))], "2 m apart"),
    ],
)
def test_what_cannot_be_meant_is_refused(constraints: Any, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        check_constraints(constraints, 80, 20)


@pytest.mark.parametrize(
    "constraints",
    [
        None,
        [],
        [Path([(0, 0), (0, 4)]), Waypoint(2, (0, 2.02))],  # a frame is not exactly 2 s
        [Waypoint(1, (0, 1)), Waypoint(1, (0, 2), weight=0)],
        [JointTarget("head", (None, 1.5, None), 1), JointTarget("head", (0, None, 0), 1)],
        [KEY, Keyframe(1, t_pose()[0] + 1, anywhere=True)],
        [Waypoint(4, (0, 2))],  # the end is the last frame
        [JointTarget("left hand", (0.5, 1.2, 0.3), 0)],
        [Loop(), StartPose(t_pose()), EndPose(t_pose())],
    ],
)
def test_what_can_be_done_passes_without_a_note(constraints: Any) -> None:
    assert check_constraints(constraints, 80, 20, strict=True) == (tuple(constraints or ()), ())


@pytest.mark.parametrize(
    ("constraints", "note"),
    [
        ([Waypoint(1, (0, 5.5))], "5.5 m from the origin, where clips start, 1 s earlier"),
        ([Waypoint(1, (0, 1)), Waypoint(1.5, (0, 4))], "3 m from where the person has to be 0.5 s earlier"),
        ([Path([(0, 0), (0, 20)])], "path of 20 m"),
        ([Path([(1, 0), (1, 2)])], "1 m from the origin"),
        ([Waypoint(1, (0, 0)), JointTarget("right hand", (0, 1, 3), 1)], "3 m from where"),
        ([JointTarget("head", (None, 3, None), 1)], "a height of 3 m is out of reach"),
        ([JointTarget("left foot", (None, -0.2, None), 1)], "a height of -0.2 m"),
    ],
)
def test_what_nobody_can_do_is_told_and_refused_when_strict(constraints: Any, note: str) -> None:
    checked, notes = check_constraints(constraints, 80, 20)
    assert checked == tuple(constraints)
    assert len(notes) == 1 and note in notes[0]
    with pytest.raises(InvalidInputError, match=note):
        check_constraints(constraints, 80, 20, strict=True)


def test_many_long_constraints_are_checked_quickly() -> None:
    targets = [JointTarget("head", (None, 1.5, None), (0, 9.8)) for _ in range(MAX_CONSTRAINTS - 1)]
    checked, notes = check_constraints([*targets, Path(np.linspace((0, 0), (0, 5), MAX_PATH_POINTS))], 196, 20)
    assert len(checked) == MAX_CONSTRAINTS and not notes


@pytest.mark.parametrize(
    ("constraint", "words"),
    [
        (Path([(0, 0), (0, 2.5)]), "path of 2.5 m"),
        (Waypoint(2.5, (0, 1)), "waypoint at 2.5 s"),
        (JointTarget("left hand", (0, 1, 0), 2), "left_wrist at 2 s"),
        (JointTarget("head", (0, 1, 0), (2, 3)), "head from 2 to 3 s"),
        (KEY, "keyframe at 1 s"),
        (StartPose(t_pose()), "start pose"),
        (EndPose(t_pose()), "end pose"),
        (Loop(), "loop"),
    ],
)
def test_constraints_are_described(constraint: Any, words: str) -> None:
    assert describe(constraint) == words


@pytest.mark.parametrize("frames", [0, 2.5, True])
def test_a_clip_has_frames(frames: Any) -> None:
    with pytest.raises(InvalidInputError, match="frames must be a whole number"):
        check_constraints([], frames, 20)


def test_the_nearest_frame() -> None:
    assert [frame_of(seconds, 80, 20) for seconds in (0, 0.024, 0.026, 4)] == [0, 0, 1, 79]
