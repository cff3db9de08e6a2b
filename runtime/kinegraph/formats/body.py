"""A person to look at: rounded limbs around the bones of a rest skeleton, each bound to one joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.motion.quaternions import between, normalised, rotate
from kinegraph.motion.skeleton import JOINT_INDEX, JOINT_NAMES, PARENTS

Floats = NDArray[np.floating[Any]]

AROUND: Final = 12
"""Vertices around a limb."""
CAP: Final = 4
"""Rings of each rounded end."""

RADII: Final[dict[str, tuple[float, float]]] = {
    "hip": (0.105, 0.095),
    "knee": (0.085, 0.058),
    "ankle": (0.055, 0.04),
    "foot": (0.045, 0.035),
    "spine1": (0.12, 0.115),
    "spine2": (0.115, 0.115),
    "spine3": (0.12, 0.11),
    "neck": (0.075, 0.05),
    "head": (0.048, 0.05),
    "collar": (0.075, 0.075),
    "shoulder": (0.07, 0.058),
    "elbow": (0.05, 0.04),
    "wrist": (0.04, 0.03),
}
"""Metres: of the limb that leads to a joint, where it begins and where it ends."""

ENDS: Final[dict[str, tuple[tuple[float, float, float], float, float]]] = {
    "head": ((0.0, 0.13, 0.02), 0.085, 0.095),
    "left_wrist": ((0.13, 0.0, 0.0), 0.034, 0.026),
    "right_wrist": ((-0.13, 0.0, 0.0), 0.034, 0.026),
    "left_foot": ((0.0, 0.0, 0.06), 0.035, 0.028),
    "right_foot": ((0.0, 0.0, 0.06), 0.035, 0.028),
}
"""What lies beyond the last joint: metres from the joint, and the radii."""


@dataclass(frozen=True)
class Body:
    """A triangle mesh in the rest pose, metres."""

    positions: Floats
    """(n, 3)."""
    normals: Floats
    """(n, 3) unit vectors outwards."""
    joints: NDArray[np.int64]
    """(n,) the joint that carries each vertex."""
    triangles: NDArray[np.int64]
    """(m, 3) vertex numbers, counter-clockwise seen from outside."""


def rest_body(places: Floats) -> Body:
    """The body around joints (22, 3) at rest."""
    limbs: list[tuple[Floats, Floats, float, float, int]] = []
    for joint in range(1, len(JOINT_NAMES)):
        name = JOINT_NAMES[joint]
        radii = RADII.get(name) or RADII[name.rpartition("_")[2]]
        limbs.append((places[PARENTS[joint]], places[joint], *radii, PARENTS[joint]))
    for name, (offset, first, last) in ENDS.items():
        joint = JOINT_INDEX[name]
        limbs.append((places[joint], places[joint] + np.array(offset), first, last, joint))
    positions, normals, joints, triangles, count = [], [], [], [], 0
    for start, end, first, last, joint in limbs:
        own, outward, faces = _capsule(np.asarray(start), np.asarray(end), first, last)
        positions.append(own)
        normals.append(outward)
        joints.append(np.full(len(own), joint))
        triangles.append(faces + count)
        count += len(own)
    return Body(*(np.concatenate(part) for part in (positions, normals, joints, triangles)))


def _capsule(start: Floats, end: Floats, first: float, last: float) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """A tapered tube with rounded ends: positions, normals, triangles."""
    angle = np.linspace(0.0, np.pi / 2, CAP + 1)
    # along the axis: the cap below the start, then the cap above the end
    along = np.concatenate([-np.cos(angle), np.sin(angle)])
    across = np.concatenate([np.sin(angle), np.cos(angle)])
    radius = np.repeat([first, last], CAP + 1)
    base = np.repeat([0.0, float(np.linalg.norm(end - start))], CAP + 1)
    turn = np.linspace(0.0, 2 * np.pi, AROUND, endpoint=False)
    ring = np.stack([np.cos(turn), np.zeros(AROUND), np.sin(turn)], axis=-1)
    outward = across[:, None, None] * ring + along[:, None, None] * np.array([0.0, 1.0, 0.0])
    local = radius[:, None, None] * outward + base[:, None, None] * np.array([0.0, 1.0, 0.0])
    aim = between(np.array([0.0, 1.0, 0.0]), end - start)
    rings = len(along)
    row, column = np.meshgrid(np.arange(rings - 1), np.arange(AROUND), indexing="ij")
    a, b = row * AROUND + column, row * AROUND + (column + 1) % AROUND
    faces = np.stack([a, a + AROUND, b, b, a + AROUND, b + AROUND], axis=-1).reshape(-1, 3)
    positions = start + rotate(aim, local.reshape(-1, 3))
    return positions, normalised(rotate(aim, outward.reshape(-1, 3))), faces[_has_area(positions, faces)]


def _has_area(positions: Floats, faces: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Triangles at the poles of a cap have two corners in one place."""
    corners = positions[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], axis=-1)
    return np.asarray(np.linalg.norm(normal, axis=-1) > 1e-12)
