"""Nodes, skins and the humanoid map of a glTF file as a `Rig`."""

from __future__ import annotations

from typing import Final

import numpy as np

from kinegraph.arrays import Floats
from kinegraph.errors import InvalidInputError
from kinegraph.formats.gltf import Document, item
from kinegraph.motion.quaternions import from_matrix, normalised
from kinegraph.motion.rig import Rig

MAX_NODES: Final = 10_000


def read_rig(document: Document) -> Rig:
    """Read nodes and skins.

    Raises:
        InvalidInputError: no skin, too many nodes, or a node with two parents.
    """
    nodes = document.get("nodes", [])
    skins = document.get("skins", [])
    if not skins:
        raise InvalidInputError("it has no skin; a character is a mesh that is bound to a skeleton")
    if len(nodes) > MAX_NODES:
        raise InvalidInputError(f"it has {len(nodes)} nodes; at most {MAX_NODES} are read")
    parents = [-1] * len(nodes)
    for index, node in enumerate(nodes):
        for child in node.get("children", ()):
            item(document, "nodes", child)
            if parents[child] >= 0:
                raise InvalidInputError(f"node {child} is below two others")
            parents[child] = index
    transforms = [_transform(node) for node in nodes]
    for skin in skins:
        for joint in skin["joints"]:
            item(document, "nodes", joint)
    return Rig(
        names=tuple(str(node.get("name", f"node {index}")) for index, node in enumerate(nodes)),
        parents=tuple(parents),
        translations=np.array([translation for translation, _, _ in transforms]),
        rotations=np.array([rotation for _, rotation, _ in transforms]),
        scales=np.array([scale for _, _, scale in transforms]),
        skins=tuple(frozenset(skin["joints"]) for skin in skins),
    )


def _transform(node: Document) -> tuple[Floats, Floats, Floats]:
    """Read translation, rotation (w, x, y, z) and scale of a node; a matrix is taken apart.

    Raises:
        InvalidInputError: other than finite numbers.
    """
    if "matrix" in node:
        matrix = np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
        if not np.isfinite(matrix).all():
            raise InvalidInputError("a node's matrix is not finite")
        scale = np.linalg.norm(matrix[:3, :3], axis=0)
        scale[0] *= -1.0 if np.linalg.det(matrix[:3, :3]) < 0 else 1.0
        turn = matrix[:3, :3] / np.where(scale == 0, 1.0, scale)
        return matrix[:3, 3], from_matrix(turn), scale
    values = [node.get("translation", (0, 0, 0)), node.get("rotation", (0, 0, 0, 1)), node.get("scale", (1, 1, 1))]
    translation, rotation, scale = (np.array(value, dtype=np.float64) for value in values)
    if (len(translation), len(rotation), len(scale)) != (3, 4, 3):
        raise InvalidInputError("a node's transform has the wrong length")
    if not np.isfinite(np.concatenate([translation, rotation, scale])).all() or not rotation.any():
        raise InvalidInputError("a node's transform is not finite, or its rotation is zero")
    return translation, normalised(rotation[[3, 0, 1, 2]]), scale


def with_parts(node: Document, rig: Rig, index: int) -> Document:
    """Write a node's matrix as translation, rotation and scale, as animated nodes must have them."""
    if "matrix" not in node:
        return node
    w, x, y, z = rig.rotations[index].tolist()
    plain = {key: value for key, value in node.items() if key != "matrix"}
    parts = {"translation": rig.translations[index].tolist(), "rotation": [x, y, z, w]}
    return plain | parts | {"scale": rig.scales[index].tolist()}


def vrm_bones(document: Document) -> dict[str, int] | None:
    """Read the humanoid of a VRM file, version 0 or 1: bone -> node; None where there is none."""
    extensions = document.get("extensions", {})
    if "VRMC_vrm" in extensions:
        bones = {bone: entry["node"] for bone, entry in extensions["VRMC_vrm"]["humanoid"]["humanBones"].items()}
    elif "VRM" in extensions:
        bones = {entry["bone"]: entry["node"] for entry in extensions["VRM"]["humanoid"]["humanBones"]}
    else:
        return None
    for node in bones.values():
        item(document, "nodes", node)
    return bones
