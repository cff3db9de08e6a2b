"""The body that `.glb` files show: closed shapes of elliptical rings around the bones, skinned to the joints.

Coordinates are those of the rest pose: a T-pose that faces +Z, Y up, metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import Floats
from kinegraph.motion.quaternions import normalised
from kinegraph.motion.skeleton import JOINT_INDEX

RING_VERTICES: Final = 14
"""Vertices around a ring."""
RINGS_PER_SEGMENT: Final = 2
"""Rings from one row of a part's table to the next."""
DOME_ANGLES: Final = (0.45, 0.85, 1.2)
"""Radians above the end of a part at which its rounded cap has a ring."""
SKIN_BLEND: Final = 0.03
"""Metres to each side of a joint over which skin weights pass from one bone to the next."""

X, Y, Z = 0, 1, 2

Ring = tuple[str, tuple[float, float, float], tuple[float, float]]
"""A joint, the centre of the ring relative to it, and the radii along the two axes across; metres."""


@dataclass(frozen=True)
class BodyPart:
    """A closed shape: rings stacked along a coordinate axis."""

    axis: int
    bones: tuple[str, ...]
    """Joints it is skinned to, in the direction of the rings; each takes over at its position."""
    rings: tuple[Ring, ...]


MIDLINE_PARTS: Final = (
    BodyPart(
        Y,
        ("pelvis", "spine1", "spine2", "spine3", "neck", "head"),
        (
            ("pelvis", (0.0, -0.09, 0.0), (0.09, 0.075)),
            ("pelvis", (0.0, -0.02, -0.005), (0.15, 0.105)),
            ("spine1", (0.0, -0.01, 0.0), (0.13, 0.09)),
            ("spine2", (0.0, 0.0, 0.003), (0.122, 0.086)),
            ("spine3", (0.0, 0.0, 0.008), (0.142, 0.1)),
            ("spine3", (0.0, 0.085, 0.008), (0.152, 0.102)),
            ("neck", (0.0, -0.025, -0.003), (0.13, 0.082)),
            ("neck", (0.0, 0.005, -0.004), (0.08, 0.062)),
            ("neck", (0.0, 0.035, 0.0), (0.05, 0.05)),
            ("head", (0.0, 0.02, 0.004), (0.047, 0.05)),
        ),
    ),
    BodyPart(
        Y,
        ("head",),
        (
            ("head", (0.0, 0.015, 0.03), (0.042, 0.05)),
            ("head", (0.0, 0.05, 0.026), (0.06, 0.075)),
            ("head", (0.0, 0.09, 0.018), (0.071, 0.088)),
            ("head", (0.0, 0.13, 0.013), (0.073, 0.091)),
        ),
    ),
)
LEFT_PARTS: Final = (
    BodyPart(
        X,
        ("left_collar",),
        (
            ("left_collar", (-0.03, 0.012, -0.004), (0.06, 0.066)),
            ("left_shoulder", (0.0, 0.0, 0.0), (0.054, 0.058)),
        ),
    ),
    BodyPart(
        X,
        ("left_shoulder", "left_elbow"),
        (
            ("left_shoulder", (0.005, 0.0, 0.0), (0.053, 0.056)),
            ("left_shoulder", (0.09, -0.002, 0.0), (0.047, 0.048)),
            ("left_elbow", (-0.07, 0.0, 0.0), (0.041, 0.043)),
            ("left_elbow", (0.0, 0.0, 0.0), (0.037, 0.039)),
            ("left_elbow", (0.06, 0.0, 0.0), (0.039, 0.042)),
            ("left_wrist", (-0.07, 0.0, 0.0), (0.029, 0.033)),
            ("left_wrist", (0.0, 0.0, 0.0), (0.023, 0.029)),
        ),
    ),
    BodyPart(
        X,
        ("left_wrist",),
        (
            ("left_wrist", (0.005, 0.0, 0.0), (0.022, 0.028)),
            ("left_wrist", (0.05, -0.004, 0.004), (0.024, 0.042)),
            ("left_wrist", (0.1, -0.006, 0.004), (0.02, 0.04)),
            ("left_wrist", (0.15, -0.01, 0.002), (0.014, 0.028)),
        ),
    ),
    BodyPart(
        Y,
        ("left_hip", "left_knee"),
        (
            ("left_hip", (0.012, 0.0, -0.004), (0.085, 0.092)),
            ("left_hip", (0.012, -0.1, 0.0), (0.082, 0.088)),
            ("left_knee", (0.004, 0.15, 0.0), (0.07, 0.075)),
            ("left_knee", (0.0, 0.04, 0.002), (0.056, 0.06)),
            ("left_knee", (0.0, -0.03, 0.002), (0.052, 0.056)),
            ("left_knee", (0.0, -0.12, -0.012), (0.054, 0.06)),
            ("left_knee", (0.0, -0.25, -0.008), (0.043, 0.046)),
            ("left_ankle", (0.0, 0.03, -0.004), (0.034, 0.04)),
        ),
    ),
    BodyPart(
        Z,
        ("left_ankle", "left_foot"),
        (
            ("left_ankle", (0.0, -0.008, -0.035), (0.034, 0.04)),
            ("left_ankle", (0.0, -0.004, 0.0), (0.037, 0.046)),
            ("left_ankle", (0.0, -0.017, 0.06), (0.042, 0.034)),
            ("left_foot", (0.0, 0.026, 0.0), (0.045, 0.024)),
            ("left_foot", (0.0, 0.02, 0.05), (0.038, 0.017)),
        ),
    ),
)


def _mirrored(part: BodyPart) -> BodyPart:
    """Reflect a part of the left side to the right one."""

    def name(joint: str) -> str:
        return joint.replace("left", "right")

    rings = tuple((name(joint), (-x, y, z), radii) for joint, (x, y, z), radii in part.rings)
    return BodyPart(part.axis, tuple(map(name, part.bones)), rings)


PARTS: Final = (*MIDLINE_PARTS, *LEFT_PARTS, *map(_mirrored, LEFT_PARTS))


@dataclass(frozen=True)
class BodyMesh:
    """A skinned triangle mesh in the rest pose."""

    positions: Floats
    """(n, 3) metres."""
    normals: Floats
    """(n, 3) unit vectors that point outwards."""
    joints: NDArray[np.int64]
    """(n, 2) joints that each vertex is skinned to; 0 where the weight is 0."""
    weights: NDArray[np.float32]
    """(n, 2) skin weights, which sum to 1."""
    triangles: NDArray[np.int64]
    """(m, 3) vertex indices, counter-clockwise seen from outside."""


def body_mesh(rest: Floats) -> BodyMesh:
    """Build the body around a rest pose.

    Args:
        rest: (22, 3) metres, joints of the T-pose.
    """
    positions: list[Floats] = []
    normals: list[Floats] = []
    joints, weights, triangles, count = [], [], [], 0
    for part in PARTS:
        vertices, faces = _shape(part, rest)
        skin_joints, skin_weights = _skin(part, rest, vertices)
        positions.append(vertices)
        normals.append(_vertex_normals(vertices, faces))
        joints.append(skin_joints)
        weights.append(skin_weights)
        triangles.append(faces + count)
        count += len(vertices)
    return BodyMesh(
        np.concatenate(positions),
        np.concatenate(normals),
        np.concatenate(joints),
        np.concatenate(weights),
        np.concatenate(triangles),
    )


def _shape(part: BodyPart, rest: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Build the vertices (n, 3) and triangles (m, 3) of a part: its rings, a dome of rings at each end, two poles."""
    centres = _curve(np.array([rest[JOINT_INDEX[joint]] + offset for joint, offset, _ in part.rings]))
    radii = _curve(np.array([radii for _, _, radii in part.rings]))
    along = np.eye(3)[part.axis] * np.sign(centres[-1] - centres[0])[part.axis]
    across = np.eye(3)[[axis for axis in (X, Y, Z) if axis != part.axis]]
    # the ends of a part are rounded: rings along a hemisphere of the mean radius
    rise, shrink = np.sin(DOME_ANGLES), np.cos(DOME_ANGLES)
    first, last = radii[0].mean(), radii[-1].mean()
    stacked = np.concatenate(
        [
            centres[0] - first * np.outer(rise[::-1], along),
            centres,
            centres[-1] + last * np.outer(rise, along),
        ]
    )
    sizes = np.concatenate([np.outer(shrink[::-1], radii[0]), radii, np.outer(shrink, radii[-1])])
    angle = np.linspace(0.0, 2 * np.pi, RING_VERTICES, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    rings = stacked[:, None] + np.einsum("ak,rk,kd->rad", circle, sizes, across)
    poles = [centres[0] - first * along, centres[-1] + last * along]
    positions = np.concatenate([rings.reshape(-1, 3), poles])
    faces = _faces(len(stacked))
    corners = positions[faces]
    # a negative enclosed volume (divergence theorem) means that the triangles face inwards
    inside_out = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) < 0
    return positions, faces[:, ::-1] if inside_out else faces


def _curve(table: Floats) -> Floats:
    """Interpolate the rows of a table by a Catmull-Rom spline, `RINGS_PER_SEGMENT` rows per segment."""
    ends = np.concatenate([[2 * table[0] - table[1]], table, [2 * table[-1] - table[-2]]])
    before, start, stop, after = ends[:-3], ends[1:-2], ends[2:-1], ends[3:]
    rows = []
    for t in np.arange(RINGS_PER_SEGMENT) / RINGS_PER_SEGMENT:
        bend = (2 * before - 5 * start + 4 * stop - after) * t**2 + (3 * (start - stop) + after - before) * t**3
        rows.append(start + 0.5 * ((stop - before) * t + bend))
    return np.concatenate([np.stack(rows, axis=1).reshape(-1, table.shape[1]), table[-1:]])


def _faces(rings: int) -> NDArray[np.int64]:
    """List the triangles (m, 3) of stacked rings, with fans to the two poles stored after them."""
    count = RING_VERTICES
    row, column = np.meshgrid(np.arange(rings - 1), np.arange(count), indexing="ij")
    a, b = row * count + column, row * count + (column + 1) % count
    sides = np.stack([a, b, a + count, b, b + count, a + count], axis=-1).reshape(-1, 3)
    step = np.arange(count)
    top = (rings - 1) * count
    low = np.stack([np.full(count, rings * count), (step + 1) % count, step], axis=-1)
    high = np.stack([np.full(count, rings * count + 1), top + step, top + (step + 1) % count], axis=-1)
    return np.concatenate([sides, low, high])


def _vertex_normals(positions: Floats, faces: NDArray[np.int64]) -> Floats:
    """Compute unit normals (n, 3) of vertices: the area-weighted mean of the triangles around each."""
    corners = positions[faces]
    normals = np.zeros_like(positions)
    # length of the cross product: twice the area
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    for corner in range(3):
        np.add.at(normals, faces[:, corner], face_normals)
    return normalised(normals)


def _skin(part: BodyPart, rest: Floats, positions: Floats) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Assign the vertices (n, 3) of a part to joints (n, 2) with skin weights (n, 2)."""
    bones = np.array([JOINT_INDEX[bone] for bone in part.bones])
    starts = rest[bones, part.axis]
    sign = -1.0 if starts[-1] < starts[0] else 1.0
    # progress of each vertex past the start of each bone: 0 to 1 within `SKIN_BLEND` of it
    beyond = (sign * (positions[:, part.axis, None] - starts[1:]) + SKIN_BLEND) / (2 * SKIN_BLEND)
    progress = np.column_stack([np.ones(len(positions)), np.clip(beyond, 0.0, 1.0)])
    # weights are shared by the last bone that has begun and the one before it
    current = (progress > 0).sum(axis=1) - 1
    share = progress[np.arange(len(current)), current].astype(np.float32)
    joints = np.stack([bones[current], bones[np.maximum(current - 1, 0)]], axis=-1)
    weights = np.stack([share, np.float32(1.0) - share], axis=-1)
    return np.where(weights > 0, joints, 0), weights
