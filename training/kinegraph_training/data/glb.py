"""GLB files: the nodes and the animation of a glTF 2.0 file (Khronos, glTF 2.0 specification), as a recording.

pygltflib reads the document; sampling follows Appendix C of the specification. External buffers are never opened.
"""

from __future__ import annotations

import struct
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from kinegraph.arrays import Floats
from kinegraph.errors import InvalidInputError, KinegraphError, MissingExtraError
from kinegraph.motion.quaternions import IDENTITY, normalised, slerp, to_matrix
from kinegraph_training.data.recording import MAX_FPS, MIN_FPS, Recording, check_size, nominal_fps, read_bytes

MAX_JSON: Final = 8 << 20
"""Bytes of the document; a character with 200 joints has 1 MB."""
SPARSE_FPS: Final = 30.0
"""Frames per second at which a file with few keys is sampled."""

_COMPONENTS: Final = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5126: "<f4"}
_WIDTHS: Final = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
_DEFAULTS: Final = {"translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0), "scale": (1.0, 1.0, 1.0)}
# What the library and Python raise for documents of another shape than the specification's.
_BROKEN: Final = (
    AttributeError, IndexError, KeyError, OSError, OverflowError, RecursionError, TypeError, ValueError, struct.error,
)  # fmt: skip


@dataclass(frozen=True)
class _Track:
    """Keys of one property of one node."""

    seconds: Floats
    """(keys,)."""
    values: Floats
    """(keys, 3 or 4), or (keys, 3, 3 or 4) for a cubic spline: tangent in, value, tangent out."""
    interpolation: str


@dataclass(frozen=True)
class _Node:
    name: str
    parent: int
    matrix: Floats | None
    """(4, 4) instead of the three properties."""
    rest: dict[str, Floats]
    """By property, quaternions x, y, z, w as in the file."""


def read_recording(path: Path) -> Recording:
    """Read a GLB file with one animation; its rest pose is that of the nodes.

    Raises:
        InvalidInputError: missing, too large, or no GLB file with one animation.
        MissingExtraError: pygltflib is not installed.
    """
    data = read_bytes(path)
    try:
        document = _parse(data)
        nodes, order = _read_nodes(document)
        tracks = _read_tracks(document, len(nodes))
        return _recording(document, nodes, order, tracks)
    except KinegraphError:
        raise
    except _BROKEN as error:
        raise InvalidInputError(
            f"no GLB file as glTF 2.0 has them ({str(error)[:200] or type(error).__name__})"
        ) from error


def _parse(data: bytes) -> Any:
    """Parse the container and its document."""
    try:
        from pygltflib import GLTF2
    except ImportError as error:
        raise MissingExtraError('.glb files need pygltflib: pip install "kinegraph[glb]"') from error
    if len(data) < 20 or data[:4] != b"glTF":
        raise InvalidInputError("no GLB file: it must start with glTF")
    if struct.unpack("<I", data[12:16])[0] > MAX_JSON:
        raise InvalidInputError(f"its document has more than {MAX_JSON >> 20} MB")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # chunks of other kinds
        document = GLTF2.load_from_bytes(data)
    if document is None or not document.animations:
        raise InvalidInputError("it has no animation; export the motion with the character")
    if len(document.animations) > 1:
        names = ", ".join(str(animation.name)[:40] for animation in document.animations[:10])
        raise InvalidInputError(
            f"it has {len(document.animations)} animations ({names}); export each as a file of its own"
        )
    return document


def _read_nodes(document: Any) -> tuple[list[_Node], list[int]]:
    """Read the nodes, and an order in which parents come before children."""
    check_size(1, len(document.nodes), "the file has")
    parents = [-1] * len(document.nodes)
    for index, node in enumerate(document.nodes):
        for child in node.children or ():
            if parents[child] >= 0 or child == index or child < 0:
                raise InvalidInputError(f"node {child} has two parents")
            parents[child] = index
    order = [index for index, parent in enumerate(parents) if parent < 0]
    for index in order:
        order.extend(document.nodes[index].children or ())
    if len(order) < len(parents):
        raise InvalidInputError("its nodes form a circle")
    nodes = []
    for node, parent in zip(document.nodes, parents, strict=True):
        # a mesh may be called Head too
        joint = node.mesh is None and node.camera is None
        matrix = np.array(node.matrix, dtype=np.float64).reshape(4, 4).T if node.matrix else None
        rest = {path: np.array(getattr(node, path) or default, dtype=np.float64) for path, default in _DEFAULTS.items()}
        nodes.append(_Node(str(node.name or "") if joint else "", parent, matrix, rest))
    return nodes, order


def _read_tracks(document: Any, nodes: int) -> dict[tuple[int, str], _Track]:
    """Read the keys of the animation, by node and property."""
    animation = document.animations[0]
    tracks: dict[tuple[int, str], _Track] = {}
    for channel in animation.channels:
        node, path = channel.target.node, channel.target.path
        if node is None or path not in _DEFAULTS:  # weights of morph targets move no joint
            continue
        if not 0 <= node < nodes:
            raise InvalidInputError(f"a track moves node {node}, which the file lacks")
        sampler = animation.samplers[channel.sampler]
        seconds = _read_accessor(document, sampler.input)[:, 0]
        values = _read_accessor(document, sampler.output)
        interpolation = sampler.interpolation or "LINEAR"
        if interpolation == "CUBICSPLINE":
            values = values.reshape(-1, 3, values.shape[-1])
        width = len(_DEFAULTS[path])
        if (
            len(values) != len(seconds)
            or not len(seconds)
            or values.shape[-1] != width
            or (np.diff(seconds) <= 0).any()
        ):
            raise InvalidInputError(f"the keys of node {node} do not fit their times")
        tracks[node, path] = _Track(seconds, values, interpolation)
    if not tracks:
        raise InvalidInputError("its animation moves no node")
    return tracks


def _read_accessor(document: Any, index: int) -> Floats:
    """Read an accessor as (count, width) numbers; whole numbers are normalised to -1 to 1, as for rotations."""
    accessor = document.accessors[index]
    if accessor.sparse is not None or accessor.bufferView is None:
        raise InvalidInputError("sparse tracks are not read; export with plain ones")
    view, blob = document.bufferViews[accessor.bufferView], document.binary_blob()
    if document.buffers[view.buffer].uri or blob is None or view.buffer != 0:
        raise InvalidInputError("its tracks are in another file; export a .glb that holds everything")
    kind, width, count = np.dtype(_COMPONENTS[accessor.componentType]), _WIDTHS[accessor.type], accessor.count
    check_size(count, 1, "a track has")
    start = (view.byteOffset or 0) + (accessor.byteOffset or 0)
    stride = view.byteStride or kind.itemsize * width
    if (
        count < 1
        or start < 0
        or stride < kind.itemsize * width
        or start + (count - 1) * stride + kind.itemsize * width > len(blob)
    ):
        raise InvalidInputError("a track is not in the file; it is cut short")
    values = np.ndarray((count, width), kind, blob, start, (stride, kind.itemsize)).astype(np.float64)
    if kind.kind != "f":
        values = np.maximum(values / np.iinfo(kind).max, -1.0)
    if not np.isfinite(values).all():
        raise InvalidInputError("a track holds numbers that are not finite")
    return values


def _recording(document: Any, nodes: list[_Node], order: list[int], tracks: dict[tuple[int, str], _Track]) -> Recording:
    """Put the recording together: frames at the rate of the densest track."""
    start = min(track.seconds[0] for track in tracks.values())
    end = max(track.seconds[-1] for track in tracks.values())
    densest = max((track.seconds for track in tracks.values()), key=len)
    step = float(np.median(np.diff(densest))) if len(densest) > 1 else 0.0
    notes: tuple[str, ...] = ()
    if step > 0 and MIN_FPS <= 1 / step <= MAX_FPS:
        fps = nominal_fps(1 / step)
    else:
        fps, notes = SPARSE_FPS, (f"its keys are sparse: sampled at {SPARSE_FPS:g} per second",)
    length = (end - start) * fps
    if not length < 1e12:
        raise InvalidInputError(f"it lasts {end - start:.4g} s")
    frames = int(length + 1e-3) + 1
    check_size(frames, len(nodes), "the file has")
    skinned = {joint for skin in document.skins or () for joint in skin.joints}
    kept = [index for index in range(len(nodes)) if nodes[index].name and (not skinned or index in skinned)]
    return Recording(
        names=tuple(nodes[index].name for index in kept),
        frames=frames,
        fps=fps,
        sample=lambda times: _positions(nodes, order, tracks, start + times / fps)[:, kept],
        rest=_positions(nodes, order, {}, np.zeros(1))[0, kept],
        warnings=notes,
    )


def _positions(nodes: list[_Node], order: list[int], tracks: dict[tuple[int, str], _Track], seconds: Floats) -> Floats:
    """Compute the places (times, nodes, 3) of all nodes at some times."""
    check_size(len(seconds), len(nodes), "resampled it has")
    places = np.zeros((len(seconds), len(nodes), 3))
    axes = np.zeros((len(seconds), len(nodes), 3, 3))
    for index in order:
        node = nodes[index]
        if node.matrix is not None:
            local, offset = np.broadcast_to(node.matrix[:3, :3], axes[:, 0].shape), node.matrix[:3, 3]
        else:
            moved = {path: _sample(tracks.get((index, path)), rest, seconds) for path, rest in node.rest.items()}
            turn = normalised(moved["rotation"][:, [3, 0, 1, 2]])
            local, offset = to_matrix(turn) * moved["scale"][:, None, :], moved["translation"]
        if node.parent < 0:
            axes[:, index], places[:, index] = local, offset
        else:
            above = axes[:, node.parent]
            axes[:, index] = above @ local
            places[:, index] = (
                places[:, node.parent] + (above @ np.broadcast_to(offset, places[:, 0].shape)[..., None])[..., 0]
            )
    return places


def _sample(track: _Track | None, rest: Floats, seconds: Floats) -> Floats:
    """Interpolate a track at some times: (times, 3 or 4); without a track the rest stays."""
    if track is None:
        return np.broadcast_to(rest, (len(seconds), len(rest)))
    keys = track.seconds
    after = np.clip(np.searchsorted(keys, seconds, side="right"), 1, max(1, len(keys) - 1))
    before, after = after - 1, np.minimum(after, len(keys) - 1)
    span = np.maximum(keys[after] - keys[before], 1e-12)
    share = np.clip((seconds - keys[before]) / span, 0.0, 1.0)
    if track.interpolation == "CUBICSPLINE":
        return _cubic(track.values[before], track.values[after], share[:, None], span[:, None])
    first, second = track.values[before], track.values[after]
    if track.interpolation == "STEP":
        # key times are rounded in the file: a moment that close to a key is that key
        return np.where((share >= 0.999)[:, None], second, first)
    if first.shape[-1] == len(IDENTITY):
        return slerp(normalised(first), normalised(second), share)
    return first + share[:, None] * (second - first)


def _cubic(first: Floats, second: Floats, share: Floats, span: Floats) -> Floats:
    """Interpolate by a cubic Hermite spline between keys (times, 3, n): tangent in, value, tangent out."""
    t, tt, ttt = share, share**2, share**3
    start, end = (2 * ttt - 3 * tt + 1) * first[:, 1], (3 * tt - 2 * ttt) * second[:, 1]
    return np.asarray(start + (ttt - 2 * tt + t) * span * first[:, 2] + end + (ttt - tt) * span * second[:, 0])
