"""A person to look at: closed shapes of elliptical rings around the bones of a rest skeleton, skinned to its joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import Floats
from kinegraph.motion.quaternions import normalised
from kinegraph.motion.skeleton import JOINT_INDEX

AROUND: Final = 14
"""Vertices of a ring."""
BETWEEN: Final = 2
"""Rings from one of a part's table to the next."""
DOME: Final = (0.45, 0.85, 1.2)
"""Radians up the rounded end of a part at which it has a ring."""
BLEND: Final = 0.03
"""Metres to both sides of a joint over which the skin passes from one bone to the next."""

X, Y, Z = 0, 1, 2

Ring = tuple[str, tuple[float, float, float], tuple[float, float]]
"""A joint, the ring's middle as seen from it, and the radii along the two axes across; metres."""


@dataclass(frozen=True)
class Part:
    """One closed shape, rings stacked along an axis of the T-pose."""

    axis: int
    bones: tuple[str, ...]
    """Joints that carry it, in the direction of the rings: each takes over where it is."""
    rings: tuple[Ring, ...]


MIDDLE: Final = (
    Part(
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
    Part(
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
LEFT: Final = (
    Part(
        X,
        ("left_collar",),
        (
            ("left_collar", (-0.03, 0.012, -0.004), (0.06, 0.066)),
            ("left_shoulder", (0.0, 0.0, 0.0), (0.054, 0.058)),
        ),
    ),
    Part(
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
    Part(
        X,
        ("left_wrist",),
        (
            ("left_wrist", (0.005, 0.0, 0.0), (0.022, 0.028)),
            ("left_wrist", (0.05, -0.004, 0.004), (0.024, 0.042)),
            ("left_wrist", (0.1, -0.006, 0.004), (0.02, 0.04)),
            ("left_wrist", (0.15, -0.01, 0.002), (0.014, 0.028)),
        ),
    ),
    Part(
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
    Part(
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


def _mirrored(part: Part) -> Part:
    """The part of the right side: x the other way."""

    def name(joint: str) -> str:
        return joint.replace("left", "right")

    rings = tuple((name(joint), (-x, y, z), radii) for joint, (x, y, z), radii in part.rings)
    return Part(part.axis, tuple(map(name, part.bones)), rings)


PARTS: Final = (*MIDDLE, *LEFT, *map(_mirrored, LEFT))


@dataclass(frozen=True)
class Body:
    """A triangle mesh in the rest pose, metres."""

    positions: Floats
    """(n, 3)."""
    normals: Floats
    """(n, 3) unit vectors outwards."""
    joints: NDArray[np.int64]
    """(n, 2) the joints that carry each vertex; 0 beside a weight of 0."""
    weights: NDArray[np.float32]
    """(n, 2) how much each of them does; they sum to 1."""
    triangles: NDArray[np.int64]
    """(m, 3) vertex numbers, counter-clockwise seen from outside."""


def body_mesh(places: Floats) -> Body:
    """The body around joints (22, 3) at rest."""
    positions: list[Floats] = []
    normals: list[Floats] = []
    joints, weights, triangles, count = [], [], [], 0
    for part in PARTS:
        own, faces = _shape(part, places)
        carried, shares = _skin(part, places, own)
        positions.append(own)
        normals.append(_outwards(own, faces))
        joints.append(carried)
        weights.append(shares)
        triangles.append(faces + count)
        count += len(own)
    return Body(
        np.concatenate(positions),
        np.concatenate(normals),
        np.concatenate(joints),
        np.concatenate(weights),
        np.concatenate(triangles),
    )


def _shape(part: Part, places: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Vertices and outward triangles of one part: its rings, a dome of rings at each end, and two poles."""
    middles = _curve(np.array([places[JOINT_INDEX[joint]] + offset for joint, offset, _ in part.rings]))
    radii = _curve(np.array([radii for _, _, radii in part.rings]))
    along = np.eye(3)[part.axis] * np.sign(middles[-1] - middles[0])[part.axis]
    across = np.eye(3)[[axis for axis in (X, Y, Z) if axis != part.axis]]
    rise, shrink = np.sin(DOME), np.cos(DOME)
    first, last = radii[0].mean(), radii[-1].mean()
    stacked = np.concatenate(
        [
            middles[0] - first * np.outer(rise[::-1], along),
            middles,
            middles[-1] + last * np.outer(rise, along),
        ]
    )
    sizes = np.concatenate([np.outer(shrink[::-1], radii[0]), radii, np.outer(shrink, radii[-1])])
    turn = np.linspace(0.0, 2 * np.pi, AROUND, endpoint=False)
    around = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    rings = stacked[:, None] + np.einsum("ak,rk,kd->rad", around, sizes, across)
    poles = [middles[0] - first * along, middles[-1] + last * along]
    positions = np.concatenate([rings.reshape(-1, 3), poles])
    faces = _faces(len(stacked))
    corners = positions[faces]
    inside_out = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) < 0
    return positions, faces[:, ::-1] if inside_out else faces


def _curve(table: Floats) -> Floats:
    """A Catmull-Rom curve through the rows of a table, `BETWEEN` rows for each, the last one included."""
    ends = np.concatenate([[2 * table[0] - table[1]], table, [2 * table[-1] - table[-2]]])
    before, start, stop, after = ends[:-3], ends[1:-2], ends[2:-1], ends[3:]
    rows = []
    for t in np.arange(BETWEEN) / BETWEEN:
        bend = (2 * before - 5 * start + 4 * stop - after) * t**2 + (3 * (start - stop) + after - before) * t**3
        rows.append(start + 0.5 * ((stop - before) * t + bend))
    return np.concatenate([np.stack(rows, axis=1).reshape(-1, table.shape[1]), table[-1:]])


def _faces(rings: int) -> NDArray[np.int64]:
    """Triangles of stacked rings, and fans to the two poles behind them."""
    row, column = np.meshgrid(np.arange(rings - 1), np.arange(AROUND), indexing="ij")
    following = (column + 1) % AROUND
    a, b = row * AROUND + column, row * AROUND + following
    sides = np.stack([a, b, a + AROUND, b, b + AROUND, a + AROUND], axis=-1).reshape(-1, 3)
    step = np.arange(AROUND)
    top = (rings - 1) * AROUND
    low = np.stack([np.full(AROUND, rings * AROUND), (step + 1) % AROUND, step], axis=-1)
    high = np.stack([np.full(AROUND, rings * AROUND + 1), top + step, top + (step + 1) % AROUND], axis=-1)
    return np.concatenate([sides, low, high])


def _outwards(positions: Floats, faces: NDArray[np.int64]) -> Floats:
    """Unit normals of vertices: those of the triangles around each, larger ones counting more."""
    corners = positions[faces]
    normals = np.zeros_like(positions)
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    for corner in range(3):
        np.add.at(normals, faces[:, corner], facing)
    return normalised(normals)


def _skin(part: Part, places: Floats, positions: Floats) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """The joints (n, 2) that carry the vertices (n, 3) of a part, and their shares."""
    bones = np.array([JOINT_INDEX[bone] for bone in part.bones])
    starts = places[bones, part.axis]
    way = -1.0 if starts[-1] < starts[0] else 1.0
    beyond = (way * (positions[:, part.axis, None] - starts[1:]) + BLEND) / (2 * BLEND)
    taken = np.column_stack([np.ones(len(positions)), np.clip(beyond, 0.0, 1.0)])
    # the last bone that has begun, and the one before it
    own = (taken > 0).sum(axis=1) - 1
    share = taken[np.arange(len(own)), own].astype(np.float32)
    joints = np.stack([bones[own], bones[np.maximum(own - 1, 0)]], axis=-1)
    weights = np.stack([share, np.float32(1.0) - share], axis=-1)
    return np.where(weights > 0, joints, 0), weights
