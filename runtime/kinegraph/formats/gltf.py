"""glTF 2.0 in one binary file: its chunks, its arrays, read and written (Khronos, glTF 2.0 specification).

Files of strangers are read with every index and length checked. Their JSON stays as it is, key for key, so that what
this program does not know is still there when the file is written again.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import Floats
from kinegraph.errors import InvalidInputError

FLOAT, UNSIGNED_BYTE, UNSIGNED_SHORT = 5126, 5121, 5123
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
_TYPES: Final = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
_COMPONENTS: Final = {"float32": FLOAT, "uint8": UNSIGNED_BYTE, "uint16": UNSIGNED_SHORT}
_DTYPES: Final = {5120: "<i1", UNSIGNED_BYTE: "<u1", 5122: "<i2", UNSIGNED_SHORT: "<u2", 5125: "<u4", FLOAT: "<f4"}
_WIDTHS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_MAX_JSON: Final = 1 << 26
"""Bytes of the JSON chunk of a stranger's file."""

Document = dict[str, Any]
"""The JSON of a file."""


class Buffer:
    """Binary chunk of a file, with the buffer views and accessors that describe its arrays."""

    def __init__(
        self, data: bytes = b"", views: Sequence[dict[str, Any]] = (), accessors: Sequence[dict[str, Any]] = ()
    ) -> None:
        """Start empty, or with what a file has already."""
        self.parts: list[bytes] = []
        self.size = 0
        self.views = list(views)
        self.accessors = list(accessors)
        self._append(data)

    def _append(self, data: bytes) -> None:
        padding = b"\0" * (-len(data) % 4)
        self.parts += [data, padding] if padding else [data]
        self.size += len(data) + len(padding)

    def add(self, array: NDArray[Any], *, target: int | None = None, bounds: bool = False) -> int:
        """Append an array and return the index of its accessor.

        Args:
            array: (count, ...) of a component type that glTF knows.
            target: what the GPU uses the view for, `ARRAY_BUFFER` or `ELEMENT_ARRAY_BUFFER`.
            bounds: store the minimum and maximum; glTF requires them for positions and times.
        """
        view = {"buffer": 0, "byteOffset": self.size, "byteLength": array.nbytes}
        self.views.append(view if target is None else {**view, "target": target})
        self._append(array.tobytes())
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


def add_animation(
    buffer: Buffer, name: str, fps: float, translations: Mapping[int, Floats], rotations: Mapping[int, Floats]
) -> Document:
    """Store tracks with a key at every frame, and return the animation.

    Args:
        buffer: gains one array of times and one of each track.
        name: of the animation.
        fps: keys per second.
        translations: node -> (frames, 3).
        rotations: node -> (frames, 4) quaternions w, x, y, z.
    """
    # glTF orders quaternions x, y, z, w
    turns = np.stack(list(rotations.values()))[..., [1, 2, 3, 0]].astype(np.float32)
    tracks = [("translation", node, track.astype(np.float32)) for node, track in translations.items()]
    tracks += [("rotation", node, turn) for node, turn in zip(rotations, turns, strict=True)]
    times = buffer.add((np.arange(len(tracks[0][2])) / fps).astype(np.float32), bounds=True)
    samplers, channels = [], []
    for path, node, values in tracks:
        samplers.append({"input": times, "output": buffer.add(values), "interpolation": "LINEAR"})
        channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": path}})
    return {"name": name, "samplers": samplers, "channels": channels}


class DocumentText:
    """The JSON of a document that is written again and again, each time with more in it: what stays is encoded once."""

    def __init__(self, document: Document) -> None:
        """Encode a document, value by value."""
        self._texts = {key: _encode(value) for key, value in document.items()}

    def changed(self, replaced: Document, appended: Mapping[str, list[Document]]) -> str:
        """Return the JSON of the document with some of its values replaced, and its lists longer."""
        texts = self._texts | {key: _encode(value) for key, value in replaced.items()}
        for key, items in appended.items():
            before = texts.get(key, "[]")[1:-1]
            texts[key] = f"[{before}{',' if before and items else ''}{_encode(items)[1:-1]}]"
        return f"{{{','.join(f'{_encode(key)}:{text}' for key, text in texts.items())}}}"


def _encode(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False)


def container(document: Document | str, buffer: Buffer) -> bytes:
    """Assemble header, JSON chunk and binary chunk, each padded to four bytes; a document may be JSON already."""
    text = (document if isinstance(document, str) else _encode(document)).encode()
    text += b" " * (-len(text) % 4)
    header = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + buffer.size)
    binary = struct.pack("<I4s", buffer.size, b"BIN\0")
    return b"".join([header, struct.pack("<I4s", len(text), b"JSON"), text, binary, *buffer.parts])


def split_container(data: bytes) -> tuple[Document, bytes]:
    """Split a file into its JSON document and its binary chunk, which may be missing.

    Raises:
        InvalidInputError: no binary glTF 2.0, cut short, or damaged.
    """
    if len(data) < 20 or data[:4] != b"glTF":
        raise InvalidInputError("it is no binary glTF (.glb) file")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise InvalidInputError(f"it is glTF {version}; export it again as glTF 2.0")
    chunks: dict[bytes, bytes] = {}
    start = 12
    while start + 8 <= min(length, len(data)):
        size, kind = struct.unpack_from("<I4s", data, start)
        if start + 8 + size > len(data):
            break
        chunks.setdefault(kind, data[start + 8 : start + 8 + size])
        start += 8 + size
    if length != len(data) or start != length or b"JSON" not in chunks:
        raise InvalidInputError("it is cut short or damaged")
    return parse_document(chunks[b"JSON"]), chunks.get(b"BIN\0", b"")


def parse_document(text: bytes) -> Document:
    """Parse the JSON of a file.

    Raises:
        InvalidInputError: too large, or damaged.
    """
    if len(text) > _MAX_JSON:
        raise InvalidInputError(f"its JSON is larger than {_MAX_JSON >> 20} MiB")
    try:
        document = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise InvalidInputError(f"its JSON is damaged ({str(error)[:200]})") from error
    if not isinstance(document, dict):
        raise InvalidInputError("its JSON is no object")
    return document


def item(document: Document, kind: str, index: object) -> Document:
    """Look up an entry of a list of the document, for example ("accessors", 3).

    Raises:
        InvalidInputError: there is none.
    """
    entries = document.get(kind, [])
    if isinstance(index, bool) or not isinstance(index, int) or not isinstance(entries, list):
        raise InvalidInputError(f"it refers to {kind} by something that is no index")
    if not 0 <= index < len(entries) or not isinstance(entries[index], dict):
        raise InvalidInputError(f"it refers to number {str(index)[:20]} of {len(entries)} {kind}")
    entry: Document = entries[index]
    return entry


def read_array(document: Document, binary: bytes, index: object) -> NDArray[Any]:
    """Read the (count, width) numbers of an accessor of the binary chunk; normalised integers become floats.

    Raises:
        InvalidInputError: sparse, compressed or outside the chunk.
        KeyError, TypeError, ValueError: the accessor is not one.
    """
    accessor = item(document, "accessors", index)
    view = item(document, "bufferViews", accessor.get("bufferView"))
    if "sparse" in accessor or view.get("buffer", 0) != 0:
        raise InvalidInputError(f"accessor {index} is sparse or in another buffer")
    dtype = np.dtype(_DTYPES[accessor["componentType"]])
    count, width = accessor["count"], _WIDTHS[accessor["type"]]
    offset = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    stride = view.get("byteStride", dtype.itemsize * width)
    if not all(isinstance(number, int) and number >= 0 for number in (count, offset, stride)):
        raise InvalidInputError(f"accessor {index} has lengths that are no whole numbers")
    if count > 1 and stride < dtype.itemsize * width:
        raise InvalidInputError(f"accessor {index} has elements that overlap")
    if count and offset + stride * (count - 1) + dtype.itemsize * width > len(binary):
        raise InvalidInputError(f"accessor {index} is not in the file")
    flat = np.ndarray((count, width), dtype, binary, offset, (stride, dtype.itemsize))
    if accessor.get("normalized") and dtype.kind in "iu":
        return np.maximum(flat.astype(np.float64) / np.iinfo(dtype).max, -1.0)
    return flat


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no JSON")
