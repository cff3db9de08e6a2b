"""The pose that a skin was bound in, for files whose nodes hold another one.

Programs export the nodes as they stand at the moment: in the middle of a jump, say. The skin still knows its bind pose:
a joint was at T B^-1 then, with B its inverse bind matrix and T the same for all joints of the skin (Khronos, glTF 2.0
specification, 3.7.3.3). If T from the topmost joint puts every joint where the nodes have it, they are in the bind
pose. Else T is the transform of the mesh, as exporters have it; or, where bones had other lengths by that, that of the
topmost joint after all.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from kinegraph.arrays import Floats
from kinegraph.errors import InvalidInputError
from kinegraph.formats.gltf import Document, read_array
from kinegraph.formats.gltf_rig import read_rig, with_parts
from kinegraph.motion.quaternions import to_matrix
from kinegraph.motion.rig import Rig

APART: Final = 0.05
"""Share of the skeleton's size by which a joint must be away from its bind pose for that to count."""


def in_bind_pose(document: Document, binary: bytes, rig: Rig) -> tuple[Document, Rig]:
    """Put the joints back into the pose that they were bound in, where the file has them elsewhere.

    Args:
        document: of the file; not changed.
        binary: its binary chunk.
        rig: of its nodes.

    Returns:
        The document with the joints in their bind pose, and its rig; what was given where they are in it already.
    """
    bound = _bind_transforms(document, binary, rig)
    if not bound:
        return document, rig
    world = rig.world.copy()
    nodes = list(document["nodes"])
    for node in rig.order:
        above = world[rig.parents[node]] if rig.parents[node] >= 0 else np.eye(4)
        if node not in bound:
            world[node] = above @ _local(rig, node)
            continue
        world[node] = bound[node]
        local = np.linalg.solve(above, bound[node])
        plain = {key: value for key, value in nodes[node].items() if key not in ("translation", "rotation", "scale")}
        nodes[node] = plain | {"matrix": local.T.reshape(-1).tolist()}
    placed = read_rig({**document, "nodes": nodes})
    for node in bound:
        nodes[node] = with_parts(nodes[node], placed, node)
    return {**document, "nodes": nodes}, placed


def _local(rig: Rig, node: int) -> Floats:
    """Build the (4, 4) transform of a node relative to its parent."""
    transform = np.eye(4)
    transform[:3, :3] = to_matrix(rig.rotations[node]) * rig.scales[node]
    transform[:3, 3] = rig.translations[node]
    return transform


def _bind_transforms(document: Document, binary: bytes, rig: Rig) -> dict[int, Floats]:
    """Compute where each joint was bound: joint -> (4, 4) in the world.

    Skins that are in their bind pose, or damaged, are left out.
    """
    bound: dict[int, Floats] = {}
    for number, skin in enumerate(document["skins"]):
        if "inverseBindMatrices" not in skin or not skin["joints"]:
            continue
        try:
            inverse = read_array(document, binary, skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
            binds = np.linalg.inv(inverse[: len(skin["joints"])].astype(np.float64))
        except (InvalidInputError, np.linalg.LinAlgError):
            continue  # the nodes say enough
        joints = dict(zip(skin["joints"], binds, strict=False))
        top = next(node for node in rig.order if node in joints)
        common = rig.world[top] @ np.linalg.inv(joints[top])
        if _near(rig, {node: common @ bind for node, bind in joints.items()}):
            continue
        mesh = next((index for index, node in enumerate(document["nodes"]) if node.get("skin") == number), -1)
        if mesh >= 0 and _same_lengths(rig, {node: rig.world[mesh] @ bind for node, bind in joints.items()}):
            common = rig.world[mesh]
        for node, bind in joints.items():
            bound.setdefault(node, common @ bind)
    return bound


def _near(rig: Rig, bound: dict[int, Floats]) -> bool:
    """Tell whether joints are where the nodes have them; so they are, too, where that cannot be told."""
    places = rig.positions[[*bound]]
    away = np.linalg.norm(np.stack([transform[:3, 3] for transform in bound.values()]) - places, axis=-1).max()
    size = float(np.linalg.norm(np.ptp(places, axis=0)))
    return not np.isfinite(away) or bool(away <= APART * size)


def _same_lengths(rig: Rig, bound: dict[int, Floats]) -> bool:
    """Tell whether the skeleton has the size that it has in the file: the sums of its bones' lengths agree."""
    bones = [(node, rig.parents[node]) for node in bound if rig.parents[node] in bound]
    then = sum(float(np.linalg.norm(bound[node][:3, 3] - bound[parent][:3, 3])) for node, parent in bones)
    now = sum(float(np.linalg.norm(rig.positions[node] - rig.positions[parent])) for node, parent in bones)
    return abs(then - now) <= APART * now
