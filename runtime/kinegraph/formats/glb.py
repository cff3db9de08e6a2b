"""`.glb`: the clip as a skinned body, glTF 2.0 in one binary file (Khronos, glTF 2.0 specification).

Metres, Y up, facing +Z as glTF requires; the rest pose is a T-pose. The file has one skin and one animation: a rotation
track per joint and a translation track of the root, with a key at every frame.
"""

from __future__ import annotations

import json
import struct
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.formats.glb_mesh import body_mesh
from kinegraph.motion.kinematics import CHILDREN, forward_kinematics, rotations_from_positions
from kinegraph.motion.quaternions import IDENTITY
from kinegraph.motion.skeleton import CONVENTIONS, DEFAULT_NAMES, JOINTS

if TYPE_CHECKING:
    from kinegraph.clip import Clip

FLOAT, UNSIGNED_BYTE, UNSIGNED_SHORT = 5126, 5121, 5123
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
_TYPES: Final = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
_COMPONENTS: Final = {"float32": FLOAT, "uint8": UNSIGNED_BYTE, "uint16": UNSIGNED_SHORT}

_MATERIAL: Final = {
    "name": "body",
    "pbrMetallicRoughness": {"baseColorFactor": [0.42, 0.55, 0.78, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.7},
}


def encode(clip: Clip, names: str = DEFAULT_NAMES) -> bytes:
    """Encode a clip as GLB; `names` is a key of `skeleton.CONVENTIONS`."""
    motion = rotations_from_positions(clip.joints, clip.fps, loops=clip.loops)
    unrotated = np.tile(np.array(IDENTITY), (1, JOINTS, 1))
    rest = forward_kinematics(motion.rest_offsets, np.zeros((1, 3)), unrotated)[0]
    buffer = _Buffer()
    mesh, skin = _mesh(buffer, rest), _skin(buffer, rest)
    nodes = _nodes(motion.rest_offsets, rest, CONVENTIONS[names])
    document = {
        "asset": {"version": "2.0", "generator": "kinegraph", "extras": _provenance(clip)},
        "scene": 0,
        "scenes": [{"nodes": [0, JOINTS], "name": "clip"}],
        "nodes": [*nodes, {"name": "body", "mesh": 0, "skin": 0}],
        "meshes": [mesh],
        "materials": [_MATERIAL],
        "skins": [skin],
        "animations": [_animation(buffer, clip, motion.root, motion.rotations)],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.data)}],
    }
    return _container(document, bytes(buffer.data))


class _Buffer:
    """Binary chunk of the file, with the buffer views and accessors that describe its arrays."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, array: NDArray[Any], *, target: int | None = None, bounds: bool = False) -> int:
        """Append an array and return the index of its accessor.

        Args:
            array: (count, ...) of a component type that glTF knows.
            target: what the GPU uses the view for, `ARRAY_BUFFER` or `ELEMENT_ARRAY_BUFFER`.
            bounds: store the minimum and maximum; glTF requires them for positions and times.
        """
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": array.nbytes}
        self.views.append(view if target is None else {**view, "target": target})
        self.data += np.ascontiguousarray(array).tobytes()
        self.data += b"\0" * (-len(self.data) % 4)
        accessor = {
            "bufferView": len(self.views) - 1,
            "componentType": _COMPONENTS[array.dtype.name],
            "count": len(array),
            "type": _TYPES[array.shape[1:]],
        }
        if bounds:
            accessor |= {"min": np.atleast_1d(array.min(0)).tolist(), "max": np.atleast_1d(array.max(0)).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def _provenance(clip: Clip) -> dict[str, Any]:
    """List what is needed to generate the clip again."""
    return {"text": clip.text, "seed": str(clip.seed), "bundle": clip.bundle, "fps": clip.fps}


def _mesh(buffer: _Buffer, rest: NDArray[Any]) -> dict[str, Any]:
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


def _skin(buffer: _Buffer, rest: NDArray[Any]) -> dict[str, Any]:
    """Store the inverse bind matrices of joints (22, 3) at rest: translations by -rest, as nothing is rotated."""
    # column-major, so the translation is in the last row
    inverse = np.tile(np.eye(4, dtype=np.float32), (JOINTS, 1, 1))
    inverse[:, 3, :3] = -rest
    return {
        "name": "skeleton",
        "skeleton": 0,
        "joints": list(range(JOINTS)),
        "inverseBindMatrices": buffer.add(inverse),
    }


def _nodes(offsets: NDArray[Any], rest: NDArray[Any], names: tuple[str, ...]) -> list[dict[str, Any]]:
    """List the joints as nodes, in the rest pose and standing on the floor."""
    nodes = []
    for joint in range(JOINTS):
        node: dict[str, Any] = {"name": names[joint], "translation": [float(value) for value in offsets[joint]]}
        if CHILDREN[joint]:
            node["children"] = list(CHILDREN[joint])
        nodes.append(node)
    nodes[0]["translation"] = [0.0, float(-rest[:, 1].min()), 0.0]
    return nodes


def _animation(buffer: _Buffer, clip: Clip, root: NDArray[Any], rotations: NDArray[Any]) -> dict[str, Any]:
    """Store one track per joint rotation and one of the root translation, a key at every frame."""
    times = buffer.add((np.arange(clip.frames) / clip.fps).astype(np.float32), bounds=True)
    tracks = [("translation", 0, root)]
    # glTF orders quaternions x, y, z, w
    tracks += [("rotation", joint, rotations[:, joint, [1, 2, 3, 0]]) for joint in range(JOINTS)]
    samplers, channels = [], []
    for path, joint, values in tracks:
        samplers.append({"input": times, "output": buffer.add(values.astype(np.float32)), "interpolation": "LINEAR"})
        channels.append({"sampler": len(samplers) - 1, "target": {"node": joint, "path": path}})
    return {"name": clip.text[:64] or "clip", "samplers": samplers, "channels": channels}


def _container(document: dict[str, Any], binary: bytes) -> bytes:
    """Assemble header, JSON chunk and binary chunk, each padded to four bytes."""
    text = json.dumps(document, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
