"""`.bvh`: the clip as a skeleton that turns, for animation programs.

Centimetres, Y up, degrees; the joints of `skeleton` in a T-pose that faces +Z, rotations in the order Z, X,
Y as in `R = Rz Rx Ry` for every joint. Only the root moves. The root has no OFFSET, so that programs which
add it to the position and those which do not agree.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from kinegraph.arrays import Floats
from kinegraph.motion.kinematics import CHILDREN, rotations_from_positions
from kinegraph.motion.quaternions import to_matrix
from kinegraph.motion.skeleton import CONVENTIONS, DEFAULT_NAMES, JOINT_INDEX, JOINT_NAMES

if TYPE_CHECKING:
    from kinegraph.clip import Clip


CENTIMETRES: Final = 100.0
END_SITES: Final[dict[str, tuple[float, float, float]]] = {
    "head": (0.0, 0.18, 0.0),
    "left_wrist": (0.15, 0.0, 0.0),
    "right_wrist": (-0.15, 0.0, 0.0),
    "left_foot": (0.0, 0.0, 0.06),
    "right_foot": (0.0, 0.0, 0.06),
}
"""Metres from the last joint of a chain to the end of the body."""


def encode(clip: Clip, names: str = DEFAULT_NAMES) -> bytes:
    """The file of a clip; `names` is one of `joint_names.CONVENTIONS`."""
    motion = rotations_from_positions(clip.joints, clip.fps, loops=clip.loops)
    order = _depth_first(0)
    angles = np.degrees(euler_zxy(to_matrix(motion.rotations)))[:, order]
    rows = np.concatenate([motion.root * CENTIMETRES, angles.reshape(clip.frames, -1)], axis=1)
    lines = ["HIERARCHY", *_joint_lines(0, motion.rest_offsets, CONVENTIONS[names], "")]
    lines += ["MOTION", f"Frames: {clip.frames}", f"Frame Time: {1.0 / clip.fps:.8f}"]
    # Adding 0.0 turns -0.0 into 0.0.
    lines += [" ".join(f"{value:.6f}" for value in row) for row in np.round(rows, 6) + 0.0]
    return ("\n".join(lines) + "\n").encode("ascii")


def euler_zxy(matrices: Floats) -> Floats:
    """Angles (frames, n, 3) about Z, X, Y in radians, with `Rz Rx Ry` = matrices (frames, n, 3, 3).

    Each turn can be written in two ways, and with whole turns added; the one nearest to the frame before is
    taken, so that programs which interpolate the angles show no spin.
    """
    m = matrices
    x = np.arcsin(np.clip(m[..., 2, 1], -1.0, 1.0))
    # At x = +-90 degrees only z +- y is known; y is put to 0.
    locked = np.hypot(m[..., 0, 1], m[..., 1, 1]) < 1e-7
    z = np.where(locked, np.arctan2(m[..., 1, 0], m[..., 0, 0]), np.arctan2(-m[..., 0, 1], m[..., 1, 1]))
    y = np.where(locked, 0.0, np.arctan2(-m[..., 2, 0], m[..., 2, 2]))
    first = np.stack([z, x, y], axis=-1)
    second = np.stack([z + np.pi, np.pi - x, y + np.pi], axis=-1)
    angles = np.empty_like(first)
    before = np.zeros_like(first[0])
    for frame in range(len(first)):
        ways = np.stack([first[frame], second[frame]])
        ways -= 2 * np.pi * np.round((ways - before) / (2 * np.pi))
        nearer = np.abs(ways - before).sum(-1).argmin(axis=0)
        before = angles[frame] = np.where(nearer[:, None] == 0, ways[0], ways[1])
    return angles


def _depth_first(joint: int) -> list[int]:
    """The order in which a BVH file names its joints, and with it the order of the numbers of a frame."""
    return [joint, *(below for child in CHILDREN[joint] for below in _depth_first(child))]


def _joint_lines(joint: int, offsets: Floats, names: tuple[str, ...], indent: str) -> list[str]:
    inner = indent + "\t"
    name = names[joint]
    rotations = "Zrotation Xrotation Yrotation"
    if joint == JOINT_INDEX["pelvis"]:
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
        lines += _joint_lines(child, offsets, names, inner)
    if not CHILDREN[joint]:
        end = np.array(END_SITES[JOINT_NAMES[joint]])
        lines += [f"{inner}End Site", f"{inner}{{", f"{inner}\tOFFSET {_vector(end)}", f"{inner}}}"]
    return [*lines, f"{indent}}}"]


def _vector(metres: Floats) -> str:
    return " ".join(f"{value:.6f}" for value in np.round(metres * CENTIMETRES, 6) + 0.0)
