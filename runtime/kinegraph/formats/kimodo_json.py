"""Entries of kimodo's files of constraints, so that what is authored there works here.

    root2d                                       places of the root on the floor, with an optional heading
    fullbody                                     poses of the whole body
    left-hand, right-hand, left-foot, right-foot, end-effector    poses of which one or more limbs count

Frame indices are at 30 frames per second. Frames of `root2d` that follow one another are a `Path`, single ones are
waypoints. Poses are rotations of their bodies' joints (SOMA with 30 or 77, SMPL-X with 22); they are taken over onto
our body, so hands and feet are where a person of our build has them in that pose. An entry of a limb also holds the
root on the floor, as there. The rotation of a hand or foot itself has no place in our skeleton and is not held.

Source: the documentation of nv-tlabs/kimodo, "Constraints JSON Format" and "Skeletons" (2026).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from kinegraph.arrays import DoubleArray
from kinegraph.constraints import Constraint, JointTarget, Keyframe, Path, Waypoint
from kinegraph.errors import InvalidInputError
from kinegraph.limits import MAX_CONSTRAINTS, MAX_PATH_POINTS
from kinegraph.motion.kinematics import REST_OFFSETS, forward_kinematics
from kinegraph.motion.quaternions import multiply
from kinegraph.motion.skeleton import JOINT_INDEX, JOINT_NAMES, JOINTS
from kinegraph.validation import short_repr, whole_number

FPS: Final = 30.0
"""Frames per second of their frame indices."""
_LIMBS: Final[dict[str, tuple[str, ...]]] = {
    "LeftHand": ("left_wrist",),
    "RightHand": ("right_wrist",),
    "LeftFoot": ("left_ankle", "left_foot"),
    "RightFoot": ("right_ankle", "right_foot"),
    "Hips": ("pelvis",),
}
"""Their name of an end effector -> our joints."""
_LIMB_OF_TYPE: Final = {
    "left-hand": "LeftHand",
    "right-hand": "RightHand",
    "left-foot": "LeftFoot",
    "right-foot": "RightFoot",
}
TYPES: Final = ("root2d", "fullbody", *_LIMB_OF_TYPE, "end-effector")
_KEYS: Final[dict[str, tuple[tuple[str, ...], tuple[str, ...]]]] = {
    "root2d": (("frame_indices", "smooth_root_2d"), ("global_root_heading",)),
    "end-effector": (("frame_indices", "local_joints_rot", "root_positions", "joint_names"), ("smooth_root_2d",)),
}
"""Type -> required and optional keys; the others have `_POSE_KEYS`."""
_POSE_KEYS: Final = (("frame_indices", "local_joints_rot", "root_positions"), ("smooth_root_2d",))

_SOMA_BODY: Final = ("pelvis", "spine1", "spine2", "spine3", "neck")
_SOMA_ARM: Final = ("collar", "shoulder", "elbow", "wrist")
_SOMA_LEG: Final = ("hip", "knee", "ankle", "foot")


def _soma(left_arm: int, right_arm: int, left_leg: int, right_leg: int) -> dict[str, int]:
    """List the joints of SOMA: the spine comes first, limbs are chains from the given indices on."""
    table = {name: index for index, name in enumerate(_SOMA_BODY)}
    arms = [("left", _SOMA_ARM, left_arm), ("right", _SOMA_ARM, right_arm)]
    legs = [("left", _SOMA_LEG, left_leg), ("right", _SOMA_LEG, right_leg)]
    for side, parts, first in arms + legs:
        table |= {f"{side}_{part}": first + offset for offset, part in enumerate(parts)}
    return table | {"head": 6}


_SECOND_NECK: Final = 5
"""Joint of SOMA between neck and head, of which our neck takes the rotation, too."""
_BODIES: Final[dict[int, dict[str, int]]] = {
    22: JOINT_INDEX,
    30: _soma(10, 16, 22, 26),
    77: _soma(11, 39, 67, 72),
}
"""Number of joints of a body -> our joint -> its index there."""

_HEIGHT_RATIO: Final = 0.95
"""Height of our pelvis over that of their bodies, 0.95 m to 1 m when standing."""


def decode_entry(entry: Mapping[str, Any]) -> list[Constraint]:
    """Make our constraints of one of their entries.

    Args:
        entry: parsed JSON with a type of `TYPES`.

    Raises:
        InvalidInputError: missing or unknown keys, other shapes, or another body.
    """
    kind = str(entry["type"])
    required, optional = _KEYS.get(kind, _POSE_KEYS)
    for key in entry:
        if key not in ("type", *required, *optional):
            raise InvalidInputError(f"unknown key {short_repr(key)}; a {kind} has {', '.join(required + optional)}")
    for key in required:
        if key not in entry:
            raise InvalidInputError(f"a {kind} needs the key {key!r}")
    frames = _frame_indices(entry["frame_indices"])
    if kind == "root2d":
        return _root_constraints(entry, frames)
    poses = _poses(entry, len(frames))
    if kind == "fullbody":
        return [Keyframe(frame / FPS, pose) for frame, pose in zip(frames, poses, strict=True)]
    limbs = [_LIMB_OF_TYPE[kind]] if kind in _LIMB_OF_TYPE else _limb_names(entry["joint_names"])
    return _limb_constraints(entry, frames, poses, limbs)


def _root_constraints(entry: Mapping[str, Any], frames: Sequence[int]) -> list[Constraint]:
    """Make paths of frames that follow one another, and waypoints of the others."""
    places = _numbers(entry["smooth_root_2d"], "smooth_root_2d", (len(frames), 2))
    degrees = None
    if "global_root_heading" in entry:
        cos_sin = _numbers(entry["global_root_heading"], "global_root_heading", (len(frames), 2))
        degrees = np.degrees(np.arctan2(cos_sin[:, 1], cos_sin[:, 0]))
    order = np.argsort(frames)
    times = np.array(frames)[order]
    made: list[Constraint] = []
    for run in np.split(order, np.flatnonzero(np.diff(times) > 1) + 1):
        if len(run) == 1:
            index = int(run[0])
            x, z = places[index].tolist()
            heading = None if degrees is None else float(degrees[index])
            made.append(Waypoint(frames[index] / FPS, (x, z), heading))
        else:
            seconds = np.array(frames)[run] / FPS
            made.append(Path(places[run], seconds, None if degrees is None else degrees[run]))
    return made


def _limb_constraints(
    entry: Mapping[str, Any], frames: Sequence[int], poses: DoubleArray, limbs: Sequence[str]
) -> list[Constraint]:
    """Make targets of the limbs' joints, and waypoints of the root."""
    roots = poses[:, 0, [0, 2]]
    if "smooth_root_2d" in entry:
        roots = _numbers(entry["smooth_root_2d"], "smooth_root_2d", (len(frames), 2))
    joints = [joint for limb in limbs for joint in _LIMBS[limb]]
    made: list[Constraint] = []
    for frame, pose, (x, z) in zip(frames, poses, roots.tolist(), strict=True):
        made.append(Waypoint(frame / FPS, (x, z)))
        made += [JointTarget(joint, tuple(pose[JOINT_INDEX[joint]].tolist()), frame / FPS) for joint in joints]
    if len(made) > MAX_CONSTRAINTS:
        raise InvalidInputError(f"it holds {len(made)} places; {MAX_CONSTRAINTS} at most for one clip")
    return made


def _poses(entry: Mapping[str, Any], frames: int) -> DoubleArray:
    """Pose our body with the rotations of theirs: (frames, 22, 3) metres."""
    roots = _numbers(entry["root_positions"], "root_positions", (frames, 3)) * (1, _HEIGHT_RATIO, 1)
    turns = _numbers(entry["local_joints_rot"], "local_joints_rot", (frames, -1, 3))
    count = turns.shape[1]
    if count not in _BODIES:
        raise InvalidInputError(
            f"local_joints_rot has {count} joints; it must be of SMPL-X (22 joints) or SOMA (30 or 77)"
        )
    rotations = _from_rotation_vectors(turns)
    ours = rotations[:, [_BODIES[count][name] for name in JOINT_NAMES]]
    if count != JOINTS:
        neck = JOINT_INDEX["neck"]
        ours[:, neck] = multiply(ours[:, neck], rotations[:, _SECOND_NECK])
    return np.asarray(forward_kinematics(REST_OFFSETS, roots, ours), dtype=np.float64)


def _from_rotation_vectors(vectors: DoubleArray) -> DoubleArray:
    """Convert axis times angle (..., 3) in radians to quaternions w, x, y, z (..., 4)."""
    angle = np.linalg.norm(vectors, axis=-1, keepdims=True)
    # np.sinc(t) is sin(pi t) / (pi t), and 1 at 0
    return np.concatenate([np.cos(angle / 2), vectors * np.sinc(angle / (2 * np.pi)) / 2], axis=-1)


def _frame_indices(value: object) -> list[int]:
    """Check frame indices.

    Raises:
        InvalidInputError: not a list of different whole numbers from 0 on.
    """
    if not isinstance(value, list) or not 1 <= len(value) <= MAX_PATH_POINTS:
        raise InvalidInputError(f"frame_indices must be a list of 1 to {MAX_PATH_POINTS} frames")
    frames = [whole_number(frame) for frame in value]
    for frame, given in zip(frames, value, strict=True):
        if frame is None or not 0 <= frame < 10**6:
            raise InvalidInputError(f"frame_indices must be whole numbers from 0 on, not {short_repr(given)}")
    if len(set(frames)) != len(frames):
        raise InvalidInputError("frame_indices has a frame twice")
    return [frame for frame in frames if frame is not None]


def _limb_names(value: object) -> list[str]:
    """Check the names of end effectors.

    Raises:
        InvalidInputError: not a list of names of `_LIMBS`.
    """
    if not isinstance(value, list) or not value:
        raise InvalidInputError(f"joint_names must be a list of {', '.join(_LIMBS)}")
    for name in value:
        if not isinstance(name, str) or name not in _LIMBS:
            raise InvalidInputError(f"joint_names are of {', '.join(_LIMBS)}, not {short_repr(name)}")
    return list(dict.fromkeys(value))


def _numbers(value: object, name: str, shape: tuple[int, ...]) -> DoubleArray:
    """Convert nested lists to an array.

    Args:
        value: parsed JSON.
        name: key, for messages.
        shape: wanted, -1 for any number.

    Raises:
        InvalidInputError: not finite numbers of that shape.
    """
    wanted = ", ".join("joints" if size < 0 else str(size) for size in shape)
    try:
        array = np.asarray(value)
    except (ValueError, OverflowError):
        array = np.asarray(None)
    fits = array.dtype.kind in "fiu" and array.ndim == len(shape)
    if not fits or any(size not in (-1, own) for size, own in zip(shape, array.shape, strict=True)):
        raise InvalidInputError(f"{name} must be numbers of shape ({wanted}): one row for each of frame_indices")
    if not np.isfinite(array).all() or np.abs(array).max(initial=0) > 10**6:
        raise InvalidInputError(f"{name} must be finite numbers in metres or radians")
    return array.astype(np.float64)
