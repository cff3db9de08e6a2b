"""`.bvh`: a skeleton with joint rotations, for animation programs.

Centimetres, Y up, degrees. The rest pose is a T-pose that stands on the floor and faces +Z; every joint rotates by
`R = Rz Rx Ry` (channel order Z, X, Y). Only the pelvis moves, and the root joint above it where there is one.

Position channels are measured from the parent and replace the OFFSET, as Blender reads and writes them. (Some readers
add the two; for those the pelvis would have to rest at the origin, below the floor.)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from kinegraph.arrays import Floats
from kinegraph.motion.kinematics import CHILDREN, rest_pose, rotations_from_positions, split_root
from kinegraph.motion.quaternions import to_matrix
from kinegraph.motion.skeleton import CONVENTIONS, DEFAULT_NAMES, JOINT_NAMES, PELVIS, ROOT_NAME

if TYPE_CHECKING:
    from kinegraph.clip import Clip


CENTIMETRES: Final = 100.0
"""Per metre."""
END_SITES: Final[dict[str, tuple[float, float, float]]] = {
    "head": (0.0, 0.18, 0.0),
    "left_wrist": (0.15, 0.0, 0.0),
    "right_wrist": (-0.15, 0.0, 0.0),
    "left_foot": (0.0, 0.0, 0.06),
    "right_foot": (0.0, 0.0, 0.06),
}
"""Metres from the last joint of a chain to the end of the body."""
_TURNING: Final = "CHANNELS 3 Zrotation Xrotation Yrotation"
_MOVING: Final = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"


def encode(clip: Clip, names: str = DEFAULT_NAMES, root: bool = False) -> bytes:
    """Encode a clip as BVH.

    Args:
        clip: clip to encode.
        names: a key of `skeleton.CONVENTIONS`.
        root: add a joint on the floor that carries travel and heading (`kinematics.split_root`).
    """
    motion = rotations_from_positions(clip.joints, clip.fps, loops=clip.loops)
    positions, rotations = motion.root, motion.rotations
    columns = []
    if root:
        split = split_root(motion, clip.joints)
        columns = [split.root * CENTIMETRES, _angles(split.root_rotations[:, None])]
        positions = split.pelvis
        rotations = np.concatenate([split.pelvis_rotations[:, None], rotations[:, 1:]], axis=1)
    columns += [positions * CENTIMETRES, _angles(rotations[:, depth_first(PELVIS)])]
    offsets = np.concatenate([rest_pose(motion.rest_offsets)[:1], motion.rest_offsets[1:]])
    lines = [*hierarchy_lines(offsets, names, root), f"Frames: {clip.frames}", f"Frame Time: {1.0 / clip.fps:.8f}"]
    # adding 0.0 turns -0.0 into 0.0
    rows = np.round(np.concatenate(columns, axis=1), 6) + 0.0
    lines += [" ".join(f"{value:.6f}" for value in row) for row in rows]
    return ("\n".join(lines) + "\n").encode("ascii")


def euler_zxy(matrices: Floats) -> Floats:
    """Convert rotation matrices to Euler angles about Z, X, Y, the order of our files; see `euler_angles`."""
    return euler_angles(matrices, (2, 0, 1))


def euler_angles(matrices: Floats, axes: Sequence[int]) -> Floats:
    """Convert rotation matrices to Euler angles that are continuous over frames.

    Each rotation has two sets of angles, and any angle may have whole turns added. The set nearest to the frame before
    is taken, so that programs which interpolate the angles show no spin.

    Args:
        matrices: (frames, n, 3, 3), each `Ri Rj Rk` for the axes i, j, k.
        axes: three different ones, 0, 1, 2 for x, y, z: (2, 0, 1) is `Rz Rx Ry`.

    Returns:
        (frames, n, 3) radians in the order of the axes.
    """
    m, (i, j, k) = matrices, axes
    # +1 for an even permutation of x, y, z
    parity = 1.0 if (j - i) % 3 == 1 else -1.0
    middle = np.arcsin(np.clip(parity * m[..., i, k], -1.0, 1.0))
    # gimbal lock: at a middle angle of +-90 degrees only the sum of the others is known, so the last is set to 0
    locked = np.hypot(m[..., j, k], m[..., k, k]) < 1e-7
    first_unlocked = np.arctan2(-parity * m[..., j, k], m[..., k, k])
    z = np.where(locked, np.arctan2(parity * m[..., k, j], m[..., j, j]), first_unlocked)
    y = np.where(locked, 0.0, np.arctan2(-parity * m[..., i, j], m[..., i, i]))
    first = np.stack([z, middle, y], axis=-1)
    second = np.stack([z + np.pi, np.pi - middle, y + np.pi], axis=-1)
    angles = np.empty_like(first)
    previous = np.zeros_like(first[0])
    for frame in range(len(first)):
        candidates = np.stack([first[frame], second[frame]])
        candidates -= 2 * np.pi * np.round((candidates - previous) / (2 * np.pi))
        nearer = np.abs(candidates - previous).sum(-1).argmin(axis=0)
        previous = angles[frame] = np.where(nearer[:, None] == 0, candidates[0], candidates[1])
    return angles


def depth_first(joint: int) -> list[int]:
    """List the joints below and including `joint` in the order of a BVH file's hierarchy and channels."""
    return [joint, *(below for child in CHILDREN[joint] for below in depth_first(child))]


def hierarchy_lines(offsets: Floats, names: str, root: bool) -> list[str]:
    """Format a file's lines from HIERARCHY to MOTION.

    Args:
        offsets: (22, 3) metres from the parent at rest; that of the pelvis is its position.
        names: a key of `skeleton.CONVENTIONS`.
        root: whether a joint on the floor stands above the pelvis.
    """
    joints = _joint_lines(PELVIS, offsets, CONVENTIONS[names], "JOINT" if root else "ROOT", "\t" if root else "")
    if root:
        joints = [f"ROOT {ROOT_NAME}", "{", f"\tOFFSET {_vector(np.zeros(3))}", f"\t{_MOVING}", *joints, "}"]
    return ["HIERARCHY", *joints, "MOTION"]


def _joint_lines(joint: int, offsets: Floats, names: tuple[str, ...], key: str, indent: str) -> list[str]:
    """Format a joint and all joints below it as lines of the HIERARCHY section."""
    inner = indent + "\t"
    lines = [
        f"{indent}{key} {names[joint]}",
        f"{indent}{{",
        f"{inner}OFFSET {_vector(offsets[joint])}",
        f"{inner}{_MOVING if joint == PELVIS else _TURNING}",
    ]
    for child in CHILDREN[joint]:
        lines += _joint_lines(child, offsets, names, "JOINT", inner)
    if not CHILDREN[joint]:
        end = np.array(END_SITES[JOINT_NAMES[joint]])
        lines += [f"{inner}End Site", f"{inner}{{", f"{inner}\tOFFSET {_vector(end)}", f"{inner}}}"]
    return [*lines, f"{indent}}}"]


def _angles(rotations: Floats) -> Floats:
    """Convert quaternions (frames, n, 4) to the channel values of n joints: (frames, 3 n) degrees."""
    return np.degrees(euler_zxy(to_matrix(rotations))).reshape(len(rotations), -1)


def _vector(metres: Floats) -> str:
    """Format a vector in centimetres."""
    return " ".join(f"{value:.6f}" for value in np.round(metres * CENTIMETRES, 6) + 0.0)
