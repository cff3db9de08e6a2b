"""Files of constraints: ours are read as they were written, kimodo's mean what they mean there, others are refused."""

from __future__ import annotations

import json
import math
from dataclasses import fields
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pytest

from kinegraph import EndPose, InvalidInputError, JointTarget, Keyframe, Loop, Path, StartPose, Waypoint
from kinegraph.formats import constraints_json, kimodo_json
from kinegraph.formats.constraints_json import decode, encode, parse, read
from kinegraph.motion.kinematics import forward_kinematics, rotations_from_positions
from kinegraph.motion.skeleton import JOINT_INDEX, facing_angle
from support.motions import walk

ALL = (
    Path([(0, 0), (0.1, 2)], times=[0, 2.5], heading=[0, 90], weight=2),
    Path([(0, 0), (1, 2)], heading="along"),
    Path([(0, 0), (1, 2)]),
    Waypoint(2.5, (1, 2), heading=-45),
    Waypoint(0.1, (1 / 3, 2)),
    JointTarget("left hand", (0.3, None, 0.4), 2),
    JointTarget("head", (None, 1.5, None), (1, 2), weight=0.5),
    Keyframe(1, walk(3)[2], anywhere=True),
    StartPose(walk(4), fps=30),
    EndPose(walk(2)),
    Loop(3),
)


def same(first: Any, second: Any) -> bool:
    """Whether two constraints have equal fields, arrays included."""
    pairs = [(getattr(first, field.name), getattr(second, field.name)) for field in fields(first)]
    return type(first) is type(second) and all(np.array_equal(*pair) for pair in pairs)


def test_a_file_is_read_as_it_was_written(tmp_path: FilePath) -> None:
    file = tmp_path / "constraints.json"
    file.write_bytes(encode(ALL))
    again = read(file)
    assert len(again) == len(ALL) and all(map(same, again, ALL))
    assert encode(again) == encode(ALL)


def test_every_kind_can_be_written() -> None:
    assert {type(constraint) for constraint in ALL} == set(constraints_json.TYPES.values())


def test_what_has_its_default_is_left_out() -> None:
    assert json.loads(encode([Waypoint(1, (0, 2))])) == [{"type": "waypoint", "seconds": 1.0, "position": [0.0, 2.0]}]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "not valid JSON"),
        (b"\xff", "not valid JSON"),
        (b"{}", "must be a list of objects"),
        (b"[1]", r"constraints\[0\]: it must be an object with a type, not 1"),
        (b'[{"type": "loop"}, {}]', r"constraints\[1\]: there is no type None"),
        (b'[{"type": "dance"}]', "no type 'dance'; the types are path, waypoint"),
        (b'[{"type": ["loop"]}]', "no type"),
        (b'[{"type": "loop", "type": "loop"}]', "a key twice"),
        (b'[{"type": "loop", "weight": NaN}]', "NaN is not a number"),
        (b'[{"type": "loop", "weight": 1e999}]', "weight of a loop must be"),
        (b'[{"type": "loop", "weight": -1}]', r"constraints\[0\]: the weight of a loop"),
        (b'[{"type": "loop", "often": 2}]', "unknown key 'often'; a loop has weight"),
        (b'[{"type": "waypoint", "seconds": 1}]', "a waypoint needs the key 'position'"),
        (b'[{"type": "waypoint", "seconds": "1", "position": [0, 1]}]', "seconds from 0 on, not '1'"),
        (b'[{"type": "path", "points": [[0, 0], [true, 1]]}]', "true or false"),
        (b'[{"type": "path", "points": [[0, 0], [null, 1]]}]', "real numbers"),
        (b'[{"type": "path", "points": 7}]', "must be an array"),
        (b'[{"type": "keyframe", "seconds": 1, "joints": [[0, 0, 0]]}]', r"shape \(1, 3\)"),
        (b'[{"type": "start", "joints": {"fps": 20}}]', "must be an array"),
        (b'[{"type": "loop"}]' * 2, "not valid JSON"),
        (b"[" * 100_000, "not valid JSON"),
        (b"[" * 400_000, "at most 300,000 lists"),
        (b" " * 8_000_001, "at most 8 MB"),
        (b"[" + b",".join([b'{"type": "loop"}'] * 257) + b"]", "257 constraints; 256 at most"),
        (b'[{"type": "waypoint", "seconds": ' + b"9" * 5000 + b', "position": [0, 1]}]', "not valid JSON"),
    ],
)
def test_other_files_are_refused(data: bytes, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        decode(parse(data))


def test_messages_name_the_file(tmp_path: FilePath) -> None:
    for path in (tmp_path / "none.json", tmp_path):
        with pytest.raises(InvalidInputError, match="there is no file of constraints"):
            read(path)
    for odd in ("a\0b.json", 7, None):
        with pytest.raises(InvalidInputError):
            read(odd)  # type: ignore[arg-type]
    file = tmp_path / "bad.json"
    file.write_text("[{}]")
    with pytest.raises(InvalidInputError, match=r"bad\.json'?: constraints\[0\]"):
        read(file)


def rest(joints: int, frames: int = 1, **turns: tuple[float, float, float]) -> dict[str, Any]:
    """Poses as kimodo stores them, with some of its joints turned by a rotation vector."""
    vectors = np.zeros((frames, joints, 3))
    for index, vector in turns.items():
        vectors[:, int(index[1:])] = vector
    return {
        "frame_indices": list(range(0, 30 * frames, 30)),
        "local_joints_rot": vectors.tolist(),
        "root_positions": [[0.0, 1.0, 0.0]] * frames,
    }


def test_frames_of_a_path_that_follow_one_another_are_a_path_and_others_waypoints() -> None:
    heading = [[1, 0], [0, 1], [1, 0], [-1, 0]]
    entry = {
        "type": "root2d",
        "frame_indices": [60, 0, 1, 2],
        "smooth_root_2d": [[1, 2], [0, 0], [0, 0.1], [0, 0.2]],
        "global_root_heading": heading,
    }
    waypoint, path = sorted(decode([entry]), key=lambda made: isinstance(made, Path))
    assert isinstance(waypoint, Waypoint) and isinstance(path, Path)
    assert (waypoint.seconds, waypoint.position, waypoint.heading) == (2, (1, 2), 0)
    assert path.points.tolist() == [[0, 0], [0, 0.1], [0, 0.2]]
    np.testing.assert_allclose(path.times, [0, 1 / 30, 2 / 30])
    np.testing.assert_allclose(path.heading, [90, 0, 180])  # cosine and sine from +Z towards +X


@pytest.mark.parametrize("joints", [22, 30, 77])
def test_a_pose_without_rotations_is_our_t_pose(joints: int) -> None:
    (keyframe,) = decode([{"type": "fullbody", **rest(joints)}])
    assert isinstance(keyframe, Keyframe) and keyframe.seconds == 0
    pose = keyframe.joints
    names = JOINT_INDEX
    assert pose[names["left_wrist"], 0] > 0.7 and pose[names["right_wrist"], 0] < -0.7
    assert pose[names["head"], 1] > 1.5
    assert abs(pose[[names["left_foot"], names["right_foot"]], 1]).max() < 0.03  # stands on the floor
    assert facing_angle(pose[None])[0] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(("joints", "arm", "knee"), [(22, 16, 4), (30, 11, 23), (77, 12, 68)])
def test_rotations_of_all_bodies_turn_the_same_joints(joints: int, arm: int, knee: int) -> None:
    turns: Any = {"_0": (0.0, math.pi / 2, 0.0), f"_{arm}": (0, 0, -math.pi / 2), f"_{knee}": (math.pi / 2, 0, 0)}
    (keyframe,) = decode([{"type": "fullbody", **rest(joints, **turns)}])
    assert isinstance(keyframe, Keyframe)
    pose = keyframe.joints
    assert facing_angle(pose[None])[0] == pytest.approx(math.pi / 2, abs=1e-6)  # turned to the left
    shoulder, wrist = pose[JOINT_INDEX["left_shoulder"]], pose[JOINT_INDEX["left_wrist"]]
    np.testing.assert_allclose(wrist - shoulder, [0, -0.528, 0], atol=1e-6)  # the arm hangs
    shin = pose[JOINT_INDEX["left_ankle"]] - pose[JOINT_INDEX["left_knee"]]
    np.testing.assert_allclose(shin, [-0.429, 0, 0], atol=1e-6)  # bent backwards


def test_both_joints_of_their_neck_turn_ours() -> None:
    (keyframe,) = decode([{"type": "fullbody", **rest(30, _4=(0.5, 0, 0), _5=(0.25, 0, 0))}])
    assert isinstance(keyframe, Keyframe)
    up = keyframe.joints[JOINT_INDEX["head"]] - keyframe.joints[JOINT_INDEX["neck"]]
    assert math.atan2(up[2], up[1]) == pytest.approx(0.75, abs=1e-6)


@pytest.mark.parametrize(
    ("kind", "joints"),
    [
        ("left-hand", ["left_wrist"]),
        ("right-foot", ["right_ankle", "right_foot"]),
    ],
)
def test_a_limb_holds_its_joints_and_the_root(kind: str, joints: list[str]) -> None:
    entry = {"type": kind, **rest(22, frames=2), "smooth_root_2d": [[0, 0], [0.5, 1]]}
    made = decode([entry])
    assert [constraint.joint for constraint in made if isinstance(constraint, JointTarget)] == joints * 2
    roots = [constraint for constraint in made if isinstance(constraint, Waypoint)]
    assert [(root.seconds, root.position) for root in roots] == [(0, (0, 0)), (1, (0.5, 1))]


def test_end_effectors_are_named() -> None:
    made = decode([{"type": "end-effector", **rest(77), "joint_names": ["RightHand", "Hips"]}])
    targets = [constraint for constraint in made if isinstance(constraint, JointTarget)]
    assert [target.joint for target in targets] == ["right_wrist", "pelvis"]
    assert targets[1].position[1] == pytest.approx(0.95)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frame_indices": []}, "1 to 1000 frames"),
        ({"frame_indices": [0.5]}, "whole numbers from 0 on, not 0.5"),
        ({"frame_indices": [-1]}, "not -1"),
        ({"frame_indices": [0, 0]}, "a frame twice"),
        ({"frame_indices": [0, 30]}, "root_positions must be numbers of shape"),
        ({"root_positions": [[0, 1]]}, "root_positions must be numbers of shape"),
        ({"root_positions": [[0, 1, 1e9]]}, "finite numbers in metres"),
        ({"local_joints_rot": np.zeros((1, 34, 3)).tolist()}, "34 joints; it must be of SMPL-X"),
        ({"local_joints_rot": [[["x"] * 3] * 22]}, "local_joints_rot must be numbers"),
        ({"local_joints_rot": [[[0, 0, 0]], [[0]]]}, "local_joints_rot must be numbers"),
        ({"fps": 30}, "unknown key 'fps'"),
        ({"joint_names": []}, "list of LeftHand"),
        ({"joint_names": ["LeftPaw"]}, "not 'LeftPaw'"),
        ({"joint_names": None}, "list of LeftHand"),
    ],
)
def test_wrong_entries_of_kimodo_are_named(change: dict[str, Any], message: str) -> None:
    entry = {"type": "end-effector", **rest(22), "joint_names": ["LeftHand"], **change}
    with pytest.raises(InvalidInputError, match=rf"constraints\[0\]: .*{message}"):
        decode([entry])


def test_missing_keys_of_kimodo_are_named() -> None:
    with pytest.raises(InvalidInputError, match="a root2d needs the key 'smooth_root_2d'"):
        decode([{"type": "root2d", "frame_indices": [0]}])


def test_a_keyframe_can_be_rotations() -> None:
    motion = rotations_from_positions(walk(12), 20.0)
    entry = {
        "type": "keyframe",
        "seconds": 1,
        "rotations": motion.rotations[5].tolist(),
        "root": motion.root[5].tolist(),
    }
    (posed,) = decode([entry | {"rest_offsets": motion.rest_offsets.tolist(), "anywhere": True}])
    assert isinstance(posed, Keyframe) and posed.anywhere
    solved = forward_kinematics(motion.rest_offsets, motion.root, motion.rotations)
    np.testing.assert_allclose(posed.joints, solved[5], atol=1e-6)
    assert len(decode([entry])) == 1
    for change, message in (({"joints": []}, "unknown key .joints."), ({"root": [0, 1]}, "the root of a keyframe")):
        with pytest.raises(InvalidInputError, match=message):
            decode([entry | change])
    with pytest.raises(InvalidInputError, match=r"needs the key .root\W"):
        decode([{key: value for key, value in entry.items() if key != "root"}])


def test_more_places_than_a_clip_may_have_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="it holds 300 places; 256 at most"):
        decode([{"type": "left-foot", **rest(22, frames=100)}])


def test_rotation_vectors_are_those_of_rodrigues() -> None:
    vectors = np.array([[0.0, 0.0, 0.0], [0.3, -0.2, 0.9], [1e-9, 0, 0]])
    quaternions = kimodo_json._from_rotation_vectors(vectors)
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=-1), 1)
    angle = np.linalg.norm(vectors[1])
    np.testing.assert_allclose(quaternions[1], [np.cos(angle / 2), *(vectors[1] / angle * np.sin(angle / 2))])
    assert quaternions[0].tolist() == [1, 0, 0, 0]
