"""`.glb`: the clip as a skinned body, glTF 2.0 in one binary file (Khronos, glTF 2.0 specification).

Metres, Y up, facing +Z as glTF requires; the rest pose is a T-pose that stands on the floor. The file has one skin and
one animation: a rotation track per joint and a translation track of the pelvis, with a key at every frame. Nodes 0 to
21 are the joints. With a root joint, that is node 22, and moves and turns too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.formats.glb_mesh import body_mesh
from kinegraph.formats.gltf import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, Buffer, container
from kinegraph.motion.kinematics import (
    CHILDREN,
    SkeletonMotion,
    rest_pose,
    rotations_from_positions,
    split_root,
)
from kinegraph.motion.skeleton import CONVENTIONS, DEFAULT_NAMES, JOINTS, PELVIS, ROOT_NAME

if TYPE_CHECKING:
    from kinegraph.clip import Clip

GENERATOR: Final = "kinegraph"
ROOT_NODE: Final = JOINTS
"""Node of the root joint, where there is one."""

_MATERIAL: Final = {
    "name": "body",
    "pbrMetallicRoughness": {"baseColorFactor": [0.42, 0.55, 0.78, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.7},
}


def encode(clip: Clip, names: str = DEFAULT_NAMES, root: bool = False) -> bytes:
    """Encode a clip as GLB.

    Args:
        clip: clip to encode.
        names: a key of `skeleton.CONVENTIONS`.
        root: add a joint on the floor that carries travel and heading (`kinematics.split_root`).
    """
    motion = rotations_from_positions(clip.joints, clip.fps, loops=clip.loops)
    rest = rest_pose(motion.rest_offsets)
    buffer = Buffer()
    mesh, skin = _mesh(buffer, rest), _skin(buffer, rest, root)
    nodes = _nodes(motion.rest_offsets, rest, CONVENTIONS[names], root)
    document = {
        "asset": {"version": "2.0", "generator": GENERATOR, "extras": provenance(clip)},
        "scene": 0,
        "scenes": [{"nodes": [skin["skeleton"], len(nodes)], "name": "clip"}],
        "nodes": [*nodes, {"name": "body", "mesh": 0, "skin": 0}],
        "meshes": [mesh],
        "materials": [_MATERIAL],
        "skins": [skin],
        "animations": [_animation(buffer, clip, _tracks(motion, clip, root))],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": buffer.size}],
    }
    return container(document, buffer)


def provenance(clip: Clip) -> dict[str, Any]:
    """List what is needed to generate the clip again, and whether it is a loop."""
    made = {"text": clip.text, "seed": str(clip.seed), "bundle": clip.bundle, "fps": clip.fps}
    return made | {"loops": True} if clip.loops else made


def _mesh(buffer: Buffer, rest: NDArray[Any]) -> dict[str, Any]:
    """Store the body around joints (22, 3) at rest; glTF skins have four joints per vertex, two of them used here."""
    body = body_mesh(rest)
    skin_joints = np.zeros((len(body.joints), 4), dtype=np.uint8)
    skin_joints[:, :2] = body.joints
    weights = np.zeros(skin_joints.shape, dtype=np.float32)
    weights[:, :2] = body.weights
    attributes = {
        "POSITION": buffer.add(body.positions.astype(np.float32), target=ARRAY_BUFFER, bounds=True),
        "NORMAL": buffer.add(body.normals.astype(np.float32), target=ARRAY_BUFFER),
        "JOINTS_0": buffer.add(skin_joints, target=ARRAY_BUFFER),
        "WEIGHTS_0": buffer.add(weights, target=ARRAY_BUFFER),
    }
    indices = buffer.add(body.triangles.ravel().astype(np.uint16), target=ELEMENT_ARRAY_BUFFER)
    return {"name": "body", "primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}


def _skin(buffer: Buffer, rest: NDArray[Any], root: bool) -> dict[str, Any]:
    """Store the inverse bind matrices of joints (22, 3) at rest: translations by -rest, as nothing is rotated."""
    joints = [*range(JOINTS), *([ROOT_NODE] if root else [])]
    # column-major, so the translation is in the last row; the root rests at the origin
    inverse = np.tile(np.eye(4, dtype=np.float32), (len(joints), 1, 1))
    inverse[:JOINTS, 3, :3] -= rest
    return {
        "name": "skeleton",
        "skeleton": ROOT_NODE if root else PELVIS,
        "joints": joints,
        "inverseBindMatrices": buffer.add(inverse),
    }


def _nodes(offsets: NDArray[Any], rest: NDArray[Any], names: tuple[str, ...], root: bool) -> list[dict[str, Any]]:
    """List the joints as nodes, in the rest pose and standing on the floor; the root is the last."""
    nodes = []
    for joint in range(JOINTS):
        at = rest[PELVIS] if joint == PELVIS else offsets[joint]
        node: dict[str, Any] = {"name": names[joint], "translation": [float(value) for value in at]}
        if CHILDREN[joint]:
            node["children"] = list(CHILDREN[joint])
        nodes.append(node)
    return [*nodes, {"name": ROOT_NAME, "children": [PELVIS]}] if root else nodes


def _tracks(motion: SkeletonMotion, clip: Clip, root: bool) -> list[tuple[str, int, NDArray[Any]]]:
    """List the tracks of a motion as path, node and values; quaternions are still w, x, y, z."""
    rotations = [("rotation", joint, motion.rotations[:, joint]) for joint in range(JOINTS)]
    if not root:
        return [("translation", PELVIS, motion.root), *rotations]
    split = split_root(motion, clip.joints)
    return [
        ("translation", ROOT_NODE, split.root),
        ("rotation", ROOT_NODE, split.root_rotations),
        ("translation", PELVIS, split.pelvis),
        ("rotation", PELVIS, split.pelvis_rotations),
        *rotations[1:],
    ]


def _animation(buffer: Buffer, clip: Clip, tracks: list[tuple[str, int, NDArray[Any]]]) -> dict[str, Any]:
    """Store the tracks, with a key at every frame."""
    times = buffer.add((np.arange(clip.frames) / clip.fps).astype(np.float32), bounds=True)
    samplers, channels = [], []
    for path, node, track in tracks:
        # glTF orders quaternions x, y, z, w
        values = track[:, [1, 2, 3, 0]] if path == "rotation" else track
        samplers.append({"input": times, "output": buffer.add(values.astype(np.float32)), "interpolation": "LINEAR"})
        channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": path}})
    return {"name": clip.text[:64] or "clip", "samplers": samplers, "channels": channels}
