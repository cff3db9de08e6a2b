"""The skin of a character at rest: where its soles are, and points spread over it.

Vertices are skinned by the rule of the standard: the weighted sum of joint matrix times inverse bind matrix (Khronos,
glTF 2.0 specification, 3.7.3.3).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import Floats, IntArray
from kinegraph.errors import InvalidInputError
from kinegraph.formats.gltf import Document, item, read_array
from kinegraph.motion.humanoid import SIDES, Humanoid
from kinegraph.motion.rig import Rig

POINTS: Final = 20_000
"""Points spread over the skin."""
MAX_TRIANGLES: Final = 20_000
"""Triangles of one primitive that are looked at; of more, every second, third ..."""
MAX_PRIMITIVES: Final = 32
_TRIANGLES: Final = 4
_GOLDEN: Final = (0.7548776662466927, 0.5698402909980532)
"""Steps of the sequence that covers a square evenly (Roberts, 2018: powers of 1 / 1.3247, the plastic number)."""


@dataclass(frozen=True, eq=False)
class Primitive:
    """A part of a skinned mesh."""

    positions: NDArray[Any]
    """(vertices, 3) in the frame of the mesh."""
    joints: IntArray
    """(vertices, 4) places in `nodes`."""
    weights: NDArray[Any]
    """(vertices, 4)."""
    nodes: IntArray
    """Node of each joint of the skin."""
    matrices: Floats
    """(joints, 4, 4) from the frame of the mesh to the world, at rest."""
    triangles: IntArray
    """(triangles, 3) vertices; empty for lines and points."""

    def at_rest(self, vertices: IntArray) -> Floats:
        """Skin some vertices (n,): (n, 3) in the world."""
        weights = self.weights[vertices].astype(np.float64)
        weights = weights / np.maximum(weights.sum(axis=-1, keepdims=True), 1e-9)
        points = np.column_stack([self.positions[vertices], np.ones(len(vertices))])
        joints = self.joints[vertices]
        skinned = np.zeros((len(vertices), 3))
        for influence in range(joints.shape[1]):
            placed = np.einsum("nij,nj->ni", self.matrices[joints[:, influence], :3], points)
            skinned += weights[:, influence, None] * placed
        return skinned


def find_floor(document: Document, binary: bytes, rig: Rig, humanoid: Humanoid) -> float:
    """Find the height of the soles at rest: the lowest vertex of the feet, or else by the joints."""
    feet = {
        humanoid.bones[f"{side}_{joint}"]
        for side in SIDES
        for joint in ("ankle", "foot")
        if f"{side}_{joint}" in humanoid.bones
    }
    low = float(rig.positions[list(feet), 1].min())
    knee = float(np.mean([rig.positions[humanoid.bones[f"{side}_knee"], 1] for side in SIDES]))
    heights = []
    for part in _primitives(document, binary, rig):
        below = np.array([any(above in feet for above in rig.ancestors(node)) for node in part.nodes])
        # vertices that hang on the feet for the most part
        share = (part.weights * below[part.joints]).sum(axis=-1)
        chosen = np.flatnonzero(share > 0.5 * part.weights.sum(axis=-1))
        if len(chosen):
            heights.append(float(part.at_rest(chosen)[:, 1].min()))
    heights = [height for height in heights if low - (knee - low) < height]
    if heights:
        return min(heights)
    return 0.0 if 0.0 <= low < 0.3 * (knee - low) else low


def spread_points(document: Document, binary: bytes, rig: Rig) -> tuple[Floats, IntArray]:
    """Spread points over the skin at rest, evenly by area; equal files give equal points.

    Returns:
        (n, 3) in the world, and the node (n,) that each is bound to for the most part; none without triangles.
    """
    corners: list[Floats] = []
    nodes: list[IntArray] = []
    areas: list[Floats] = []
    for part in _primitives(document, binary, rig):
        step = -(-len(part.triangles) // MAX_TRIANGLES) or 1
        chosen = part.triangles[::step]
        if not len(chosen) or chosen.min() < 0 or chosen.max() >= len(part.positions) or len(corners) == MAX_PRIMITIVES:
            continue
        points = part.at_rest(chosen.reshape(-1)).reshape(-1, 3, 3)
        strongest = part.weights[chosen].argmax(axis=-1)
        joints = np.take_along_axis(part.joints[chosen], strongest[..., None], axis=-1)[..., 0]
        corners.append(points)
        nodes.append(part.nodes[joints])
        normals = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
        areas.append(step * np.linalg.norm(normals, axis=-1))
    if not corners:
        return np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    return _spread(np.concatenate(corners), np.concatenate(nodes), np.concatenate(areas))


def _spread(corners: Floats, nodes: IntArray, areas: Floats) -> tuple[Floats, IntArray]:
    """Choose `POINTS` points on triangles (n, 3, 3) in proportion to their areas (n,)."""
    sums = np.cumsum(areas)
    if not np.isfinite(sums[-1]) or sums[-1] <= 0:
        return np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    counts = np.arange(POINTS)
    triangle = np.minimum(np.searchsorted(sums, (counts + 0.5) / POINTS * sums[-1]), len(sums) - 1)
    u, v = (np.modf((counts + 1) * step)[0] for step in _GOLDEN)
    # fold the square on to the triangle
    over = u + v > 1
    u, v = np.where(over, 1 - u, u), np.where(over, 1 - v, v)
    shares = np.stack([1 - u - v, u, v], axis=-1)
    points = (shares[..., None] * corners[triangle]).sum(axis=1)
    return points, nodes[triangle, shares.argmax(axis=-1)]


def _primitives(document: Document, binary: bytes, rig: Rig) -> Iterator[Primitive]:
    """Yield the skinned parts of all meshes; those that are not read (sparse, or in another buffer) are left out."""
    for node in document["nodes"]:
        if "skin" not in node or "mesh" not in node:
            continue
        skin = item(document, "skins", node["skin"])
        nodes = np.array(skin["joints"], dtype=np.int64)
        bind = np.tile(np.eye(4), (len(nodes), 1, 1))
        if "inverseBindMatrices" in skin:
            bind = read_array(document, binary, skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
        matrices = rig.world[nodes] @ bind[: len(nodes)]
        for primitive in item(document, "meshes", node["mesh"])["primitives"]:
            attributes = primitive["attributes"]
            if not {"POSITION", "JOINTS_0", "WEIGHTS_0"} <= attributes.keys():
                continue
            try:
                positions, joints, weights = (
                    read_array(document, binary, attributes[name]) for name in ("POSITION", "JOINTS_0", "WEIGHTS_0")
                )
                triangles = _triangles(document, binary, primitive, len(positions))
            except InvalidInputError:
                continue  # the joints say enough
            yield Primitive(positions, joints.astype(np.int64), weights, nodes, matrices, triangles)


def _triangles(document: Document, binary: bytes, primitive: Document, vertices: int) -> IntArray:
    """Read the triangles (n, 3) of a primitive; none where it is drawn in another way."""
    if primitive.get("mode", _TRIANGLES) != _TRIANGLES:
        return np.zeros((0, 3), dtype=np.int64)
    if "indices" in primitive:
        order = read_array(document, binary, primitive["indices"])[:, 0]
    else:
        order = np.arange(vertices)
    return order[: len(order) // 3 * 3].reshape(-1, 3).astype(np.int64)
