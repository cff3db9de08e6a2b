"""Reader of `.glb` files that `formats.glb` wrote: its nodes, its tracks, one binary chunk.

Strict on purpose: other files have other skeletons, interpolations and node transforms. Tracks are single precision, so
joints come back to 0.01 mm.
"""

from __future__ import annotations

import json
import struct
from typing import Any, Final

import numpy as np

from kinegraph.arrays import Floats
from kinegraph.errors import InvalidInputError
from kinegraph.formats.glb import GENERATOR, ROOT_NODE
from kinegraph.formats.gltf import FLOAT
from kinegraph.formats.json import parse_seed
from kinegraph.limits import MAX_READ_FRAMES
from kinegraph.motion.kinematics import CHILDREN, RootMotion, forward_kinematics, join_root
from kinegraph.motion.quaternions import IDENTITY, normalised
from kinegraph.motion.skeleton import CONVENTIONS, JOINTS, PELVIS, ROOT_NAME
from kinegraph.validation import check_fps

_MAX_JSON: Final = 1 << 20
"""Bytes of the JSON chunk; ours has 20 kB and the text."""
_WIDTHS: Final = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}

Tracks = dict[tuple[int, str], Floats]
"""(node, "translation" or "rotation") -> values (frames, 3 or 4)."""


def decode(data: bytes) -> dict[str, Any]:
    """Decode a file into the fields of its clip; it stores no graph.

    Raises:
        InvalidInputError: not a GLB file that `formats.glb.encode` could have written.
    """
    document, binary = _chunks(data)
    try:
        generator, extras = document["asset"]["generator"], document["asset"]["extras"]
        if generator != GENERATOR:
            raise InvalidInputError(f"it was written by {str(generator)[:60]!r}; only files of kinegraph are read")
        offsets, root = _read_nodes(document["nodes"])
        tracks, times = _read_tracks(document, binary)
        fps, seed = extras["fps"], parse_seed(extras["seed"])
        check_fps(fps)
        if not np.allclose(times, np.arange(len(times)) / fps, rtol=1e-5, atol=1e-4):
            raise InvalidInputError(f"its keys are not at every frame of {fps} per second")
        joints = _joints(offsets, tracks, root)
        told = {"text": extras["text"], "bundle": extras["bundle"], "loops": extras.get("loops", False)}
        return {"joints": joints, "fps": fps, "seed": seed, **told}
    except InvalidInputError:
        raise
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InvalidInputError(f"its parts are not those of a GLB file of kinegraph ({repr(error)[:200]})") from error


def _chunks(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Split a file into its JSON document and its binary chunk.

    Raises:
        InvalidInputError: no binary glTF 2.0, or cut short.
    """
    if len(data) < 28 or data[:8] != b"glTF\x02\0\0\0":
        raise InvalidInputError("it is no binary glTF 2.0 file")
    length, size, kind = struct.unpack_from("<II4s", data, 8)
    end = 20 + size
    if length != len(data) or kind != b"JSON" or end + 8 > length:
        raise InvalidInputError("it is cut short or damaged")
    size_binary, kind_binary = struct.unpack_from("<I4s", data, end)
    if kind_binary != b"BIN\0" or end + 8 + size_binary != length or size > _MAX_JSON:
        raise InvalidInputError("its chunks are not one of JSON, of at most a megabyte, and one of binary data")
    try:
        document = json.loads(data[20:end])
    except (ValueError, RecursionError) as error:
        raise InvalidInputError(f"its JSON is damaged ({error})") from error
    if not isinstance(document, dict):
        raise InvalidInputError("its JSON is no object")
    return document, data[end + 8 :]


def _read_nodes(nodes: list[dict[str, Any]]) -> tuple[Floats, bool]:
    """Read offsets (22, 3) metres of the joints, and whether there is a root joint.

    Raises:
        InvalidInputError: other joints.
        KeyError, TypeError, ValueError: a node lacks something.
    """
    joints, others = nodes[:JOINTS], [node["name"] for node in nodes[JOINTS:]]
    known = tuple(node["name"] for node in joints) in CONVENTIONS.values()
    linked = [tuple(node.get("children", ())) for node in joints] == list(CHILDREN)
    if not known or not linked or others not in (["body"], [ROOT_NAME, "body"]):
        starts = " or ".join(names[PELVIS] for names in CONVENTIONS.values())
        raise InvalidInputError(f"its nodes are not the joints of kinegraph, which start with {starts}")
    offsets = np.array([node["translation"] for node in joints], dtype=np.float64)
    if offsets.shape != (JOINTS, 3) or not np.isfinite(offsets).all():
        raise InvalidInputError("the translation of a joint is not three finite numbers")
    return offsets, len(others) == 2


def _read_tracks(document: dict[str, Any], binary: bytes) -> tuple[Tracks, Floats]:
    """Read all tracks of the one animation, and the times of their keys in seconds.

    Raises:
        InvalidInputError: keys at different times.
        KeyError, IndexError, TypeError, ValueError: other accessors than ours.
    """
    (animation,) = document["animations"]
    samplers = animation["samplers"]
    (times,) = {sampler["input"] for sampler in samplers}
    seconds = _read_accessor(document, binary, times)[:, 0]
    tracks: Tracks = {}
    for channel in animation["channels"]:
        target, sampler = channel["target"], samplers[channel["sampler"]]
        if sampler["interpolation"] != "LINEAR":
            raise InvalidInputError(f"its keys are joined by {str(sampler['interpolation'])[:60]!r}, not LINEAR")
        values = _read_accessor(document, binary, sampler["output"])
        if len(values) != len(seconds):
            raise InvalidInputError(f"a track has {len(values)} keys, not {len(seconds)}")
        tracks[target["node"], target["path"]] = values
    return tracks, seconds


def _read_accessor(document: dict[str, Any], binary: bytes, index: int) -> Floats:
    """Read the (count, width) numbers of an accessor, as doubles.

    Raises:
        InvalidInputError: outside the binary chunk, or not finite.
        KeyError, IndexError, TypeError, ValueError: another accessor than ours.
    """
    accessor = document["accessors"][index]
    view = document["bufferViews"][accessor["bufferView"]]
    count, width, start = accessor["count"], _WIDTHS[accessor["type"]], view["byteOffset"]
    if accessor["componentType"] != FLOAT or "sparse" in accessor or "byteStride" in view or "byteOffset" in accessor:
        raise InvalidInputError("a track is not stored as plain floats")
    if not (1 <= count <= MAX_READ_FRAMES and start >= 0 and start + 4 * count * width <= len(binary)):
        raise InvalidInputError(f"a track of {count} keys is not in the file")
    values = np.frombuffer(binary, "<f4", count * width, start).reshape(count, width).astype(np.float64)
    if not np.isfinite(values).all():
        raise InvalidInputError("a track holds numbers that are not finite")
    return values


def _joints(offsets: Floats, tracks: Tracks, root: bool) -> Floats:
    """Compute joints (frames, 22, 3) metres.

    Raises:
        InvalidInputError: tracks of other joints.
        ValueError: a track has the wrong width.
    """
    moving = (PELVIS, ROOT_NODE) if root else (PELVIS,)
    expected = {(node, "rotation") for node in range(JOINTS + root)} | {(node, "translation") for node in moving}
    if tracks.keys() != expected:
        raise InvalidInputError("its tracks are not a rotation of every joint and the travel of the pelvis")
    frames = len(tracks[PELVIS, "translation"])
    rotations = np.empty((frames, JOINTS, 4))
    for joint in range(JOINTS):
        rotations[:, joint] = _rotation(tracks, joint)
    root_position = tracks[ROOT_NODE, "translation"] if root else np.zeros((frames, 3))
    root_rotations = _rotation(tracks, ROOT_NODE) if root else np.tile(np.array(IDENTITY), (frames, 1))
    split = RootMotion(root_position, root_rotations, tracks[PELVIS, "translation"], rotations[:, PELVIS])
    pelvis, rotations[:, PELVIS] = join_root(split)
    return forward_kinematics(offsets, pelvis, rotations)


def _rotation(tracks: Tracks, node: int) -> Floats:
    """Return the rotation track of a node as unit quaternions w, x, y, z; glTF orders them x, y, z, w."""
    return normalised(tracks[node, "rotation"][:, [3, 0, 1, 2]])
