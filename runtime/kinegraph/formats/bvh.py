"""`.bvh`: a skeleton with joint rotations, for animation programs.

Centimetres, Y up, degrees. The rest pose is a T-pose that faces +Z; every joint rotates by `R = Rz Rx Ry` (channel
order Z, X, Y). Only the root moves. Its OFFSET is zero, so that programs which add it to the position and those which
do not agree.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from kinegraph.arrays import Floats
from kinegraph.motion.kinematics import CHILDREN, rotations_from_positions
from kinegraph.motion.quaternions import to_matrix
from kinegraph.motion.skeleton import CONVENTIONS, DEFAULT_NAMES, JOINT_NAMES, PELVIS

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


def encode(clip: Clip, names: str = DEFAULT_NAMES) -> bytes:
    """Encode a clip as BVH; `names` is a key of `skeleton.CONVENTIONS`."""
    motion = rotations_from_positions(clip.joints, clip.fps, loops=clip.loops)
    order = _depth_first(PELVIS)
    angles = np.degrees(euler_zxy(to_matrix(motion.rotations)))[:, order]
    rows = np.concatenate([motion.root * CENTIMETRES, angles.reshape(clip.frames, -1)], axis=1)
    lines = ["HIERARCHY", *_hierarchy_lines(PELVIS, motion.rest_offsets, CONVENTIONS[names], "")]
    lines += ["MOTION", f"Frames: {clip.frames}", f"Frame Time: {1.0 / clip.fps:.8f}"]
    # adding 0.0 turns -0.0 into 0.0
    lines += [" ".join(f"{value:.6f}" for value in row) for row in np.round(rows, 6) + 0.0]
    return ("\n".join(lines) + "\n").encode("ascii")


def euler_zxy(matrices: Floats) -> Floats:
    """Convert rotation matrices to Euler angles about Z, X, Y that are continuous over frames.

    Each rotation has two sets of angles, and any angle may have whole turns added. The set nearest to the frame before
    is taken, so that programs which interpolate the angles show no spin.

    Args:
        matrices: (frames, n, 3, 3), each `Rz Rx Ry`.

    Returns:
        (frames, n, 3) radians in the order Z, X, Y.
    """
    m = matrices
    x = np.arcsin(np.clip(m[..., 2, 1], -1.0, 1.0))
    # gimbal lock: at x = +-90 degrees only z +- y is known, so y is set to 0
    locked = np.hypot(m[..., 0, 1], m[..., 1, 1]) < 1e-7
    z = np.where(locked, np.arctan2(m[..., 1, 0], m[..., 0, 0]), np.arctan2(-m[..., 0, 1], m[..., 1, 1]))
    y = np.where(locked, 0.0, np.arctan2(-m[..., 2, 0], m[..., 2, 2]))
    first = np.stack([z, x, y], axis=-1)
    second = np.stack([z + np.pi, np.pi - x, y + np.pi], axis=-1)
    angles = np.empty_like(first)
    previous = np.zeros_like(first[0])
    for frame in range(len(first)):
        candidates = np.stack([first[frame], second[frame]])
        candidates -= 2 * np.pi * np.round((candidates - previous) / (2 * np.pi))
        nearer = np.abs(candidates - previous).sum(-1).argmin(axis=0)
        previous = angles[frame] = np.where(nearer[:, None] == 0, candidates[0], candidates[1])
    return angles


def _depth_first(joint: int) -> list[int]:
    """List the joints below and including `joint` in the order of a BVH file's hierarchy and channels."""
    return [joint, *(below for child in CHILDREN[joint] for below in _depth_first(child))]


def _hierarchy_lines(joint: int, offsets: Floats, names: tuple[str, ...], indent: str) -> list[str]:
    """Format a joint and all joints below it as lines of the HIERARCHY section."""
    inner = indent + "\t"
    name = names[joint]
    rotations = "Zrotation Xrotation Yrotation"
    if joint == PELVIS:
        head, channels = f"ROOT {name}", f"CHANNELS 6 Xposition Yposition Zposition {rotations}"
    else:
        head, channels = f"JOINT {name}", f"CHANNELS 3 {rotations}"
    lines = [
        f"{indent}{head}",
        f"{indent}{{",
        f"{inner}OFFSET {_vector(offsets[joint])}",
        f"{inner}{channels}",
    ]
    for child in CHILDREN[joint]:
        lines += _hierarchy_lines(child, offsets, names, inner)
    if not CHILDREN[joint]:
        end = np.array(END_SITES[JOINT_NAMES[joint]])
        lines += [f"{inner}End Site", f"{inner}{{", f"{inner}\tOFFSET {_vector(end)}", f"{inner}}}"]
    return [*lines, f"{indent}}}"]


def _vector(metres: Floats) -> str:
    """Format a vector in centimetres."""
    return " ".join(f"{value:.6f}" for value in np.round(metres * CENTIMETRES, 6) + 0.0)
