"""GLB files in the form of Mixamo characters that went through Blender, built by hand from the known motion."""

from __future__ import annotations

import json
import struct

import numpy as np

from kinegraph.motion.quaternions import from_matrix
from kinegraph.motion.skeleton import JOINT_NAMES, PARENTS
from support.exporters import EXPORTERS, METRES, rest_a, true_motion

NAMES = EXPORTERS["Mixamo"].names


def container(document: dict, binary: bytes) -> bytes:
    """Join the two chunks of a GLB file."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def mixamo_glb(
    frames: int = 31, fps: float = 30.0, *, interpolation: str = "LINEAR", short: bool = False, keys: int = 1
) -> bytes:
    """Write the walk: an armature turned and scaled by 0.01, joints in centimetres with a rest pose of their own.

    Args:
        frames: of the animation.
        fps: frames per second.
        interpolation: of the tracks.
        short: store rotations as normalised 16-bit numbers.
        keys: keep every so many frames only.
    """
    document, blob = mixamo_parts(frames, fps, interpolation=interpolation, short=short, keys=keys)
    return container(document, blob)


def mixamo_parts(
    frames: int = 31, fps: float = 30.0, *, interpolation: str = "LINEAR", short: bool = False, keys: int = 1
) -> tuple[dict, bytes]:
    """The document and the binary chunk of `mixamo_glb`."""
    times = np.arange(0, frames, keys) / fps
    places, axes = true_motion(times)
    # Blender turns Z up to Y up in a node above, so the joints themselves are in a Z-up world of centimetres
    world = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
    rest = rest_a()
    bones = world @ axes @ np.swapaxes(rest, -1, -2)
    blob, views, accessors = bytearray(), [], []

    def add(values: np.ndarray, kind: str) -> int:
        component = {"float32": 5126, "int16": 5122}[values.dtype.name]
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": values.nbytes})
        blob.extend(values.tobytes() + b"\0" * (-values.nbytes % 4))
        accessors.append({"bufferView": len(views) - 1, "componentType": component, "count": len(times), "type": kind})
        accessors[-1] |= {"normalized": True} if component == 5122 else {}
        if interpolation == "CUBICSPLINE" and kind != "SCALAR":
            accessors[-1]["count"] = 3 * len(times)
        return len(accessors) - 1

    def spline(values: np.ndarray) -> np.ndarray:
        if interpolation != "CUBICSPLINE":
            return values
        tangent = np.gradient(values, times, axis=0)
        return np.stack([tangent, values, tangent], axis=1).reshape(-1, values.shape[-1])

    seconds = add(times.astype(np.float32), "SCALAR")
    nodes: list[dict] = [{"name": "Armature", "rotation": [-(0.5**0.5), 0, 0, 0.5**0.5], "scale": [0.01] * 3}]
    nodes[0]["children"] = [1, len(JOINT_NAMES) + 1]
    samplers, channels = [], []
    for joint, label in enumerate(JOINT_NAMES):
        parent = PARENTS[joint]
        above = bones[:, parent] if parent >= 0 else np.tile(np.eye(3), (len(times), 1, 1))
        turns = from_matrix(np.swapaxes(above, -1, -2) @ bones[:, joint])
        turns[1:] *= np.cumprod(np.where((turns[1:] * turns[:-1]).sum(-1) < 0, -1, 1))[:, None]
        stored = spline(turns[:, [1, 2, 3, 0]])
        values = np.round(stored * 32767).astype(np.int16) if short else stored.astype(np.float32)
        samplers.append({"input": seconds, "output": add(values, "VEC4"), "interpolation": interpolation})
        channels.append({"sampler": len(samplers) - 1, "target": {"node": joint + 1, "path": "rotation"}})
        offset = 100 * rest[parent] @ METRES[joint] if parent >= 0 else 100 * world @ [0, 0.95, 0]
        children = [child + 1 for child in range(22) if PARENTS[child] == joint]
        nodes.append(
            {"name": NAMES[label], "translation": offset.tolist()} | ({"children": children} if children else {})
        )
        if joint == 0:
            nodes[-1]["rotation"] = [0.5**0.5, 0, 0, 0.5**0.5]
    travel = spline(100 * places[:, 0] @ world.T).astype(np.float32)
    samplers.append({"input": seconds, "output": add(travel, "VEC3"), "interpolation": interpolation})
    channels.append({"sampler": len(samplers) - 1, "target": {"node": 1, "path": "translation"}})
    # a mesh that is called like a joint, and no joint
    nodes.append({"name": "Head", "mesh": 0, "translation": [0, 0, 500]})
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": {}}]}],
        "skins": [{"joints": list(range(1, 23))}],
        "animations": [{"name": "Walk", "samplers": samplers, "channels": channels}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(blob)}],
    }
    return document, bytes(blob)
