"""`.npz`: the clip as NumPy arrays, without pickle; the format that keeps everything.

Holds `joints` (frames, 22, 3) float32 metres, `fps`, `seed`, `text`, `joint_names`, `bundle`, and as JSON `graph`,
`unknown`, `notes` and `misses` where the clip has them. Versions before 0.7 read it without its misses.
"""

from __future__ import annotations

import io
import json
import os
import zipfile
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.archives import UNREADABLE, open_archive, read_array
from kinegraph.errors import InvalidInputError
from kinegraph.graph import SemanticGraph
from kinegraph.motion.skeleton import JOINT_NAMES
from kinegraph.unknown import Unknown, read_list

if TYPE_CHECKING:
    from kinegraph.clip import Clip
    from kinegraph.constraints import Miss

_EPOCH: Final = (1980, 1, 1, 0, 0, 0)
"""Earliest time that ZIP can store; used for every entry."""
_UNIX: Final = 3
"""Code of the system in a ZIP entry; the default would differ on Windows."""
MAX_ARRAY_BYTES: Final = 1 << 27
"""Size of one array that is read, unpacked."""

_NAMES: Final = ("joints", "fps", "seed", "text", "joint_names", "bundle")
_GRAPH: Final = "graph"
_UNKNOWN: Final = "unknown"
_NOTES: Final = "notes"
_MISSES: Final = "misses"
_LOOPS: Final = "loops"
_OPTIONAL: Final = (_GRAPH, _UNKNOWN, _NOTES, _MISSES, _LOOPS)
"""JSON texts, and whether it is a loop, that a file may lack; those of older versions do."""


def encode(clip: Clip) -> bytes:
    """Encode a clip as NPZ; equal clips give equal bytes.

    `numpy.savez` would store the time of day.
    """
    arrays: dict[str, NDArray[Any]] = {
        "joints": clip.joints.astype("<f4"),
        "fps": np.array(clip.fps, dtype="<f8"),
        "seed": np.array(clip.seed, dtype="<i8"),
        "text": np.array(clip.text),
        "joint_names": np.array(JOINT_NAMES),
        "bundle": np.array(clip.bundle),
    }
    if clip.graph is not None:
        arrays[_GRAPH] = np.array(clip.graph.to_json())
    if clip.unknown:
        arrays[_UNKNOWN] = np.array(_to_json([words.to_dict() for words in clip.unknown]))
    if clip.notes:
        arrays[_NOTES] = np.array(_to_json(clip.notes))
    if clip.misses:
        arrays[_MISSES] = np.array(_to_json([miss.to_dict() for miss in clip.misses]))
    if clip.loops:
        arrays[_LOOPS] = np.array(True)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name in arrays:
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=_EPOCH)
            entry.create_system = _UNIX
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, _npy(arrays[name]))
    return buffer.getvalue()


def read_npz(path: str | os.PathLike[str]) -> Clip:
    """Read a clip that was saved as `.npz`, whatever the file is called; see `formats.read`.

    Args:
        path: file to read.

    Raises:
        InvalidInputError: no such file, or not a clip.
    """
    from kinegraph.formats import read

    return read(path, suffix=".npz")


def decode(data: bytes) -> dict[str, Any]:
    """Decode a file into the fields of its clip.

    Raises:
        InvalidInputError: not an NPZ file that `encode` could have written.
    """
    try:
        with open_archive(data) as archive:
            stored = {*archive.namelist()}
            names = (*_NAMES, *(name for name in _OPTIONAL if f"{name}.npy" in stored))
            fields = {name: read_array(archive, name, MAX_ARRAY_BYTES) for name in names}
        if tuple(fields.pop("joint_names").ravel().tolist()) != JOINT_NAMES:
            raise InvalidInputError(f"it has other joints; kinegraph reads {', '.join(JOINT_NAMES)}")
        joints = fields.pop("joints")
        not_scalar = [name for name, value in fields.items() if value.shape != ()]
        if not_scalar:
            raise InvalidInputError(f"{', '.join(not_scalar)} must be a single value each")
        values = {name: value.item() for name, value in fields.items()}
        graph = SemanticGraph.from_json(values.pop(_GRAPH)) if _GRAPH in values else None
        lists = {name: read_list(json.loads(values.pop(name, "[]")), name) for name in (_UNKNOWN, _NOTES, _MISSES)}
        words, misses = tuple(map(Unknown.from_dict, lists[_UNKNOWN])), read_misses(lists[_MISSES])
    except InvalidInputError:
        raise
    except UNREADABLE as error:
        raise InvalidInputError(str(error)) from error
    notes = tuple(lists[_NOTES])
    return {"joints": joints, "graph": graph, "unknown": words, "notes": notes, "misses": misses, **values}


def read_misses(values: Sequence[object]) -> tuple[Miss, ...]:
    """Read misses from parsed JSON; their type is loaded only where there are any.

    Raises:
        InvalidInputError: they are something else.
    """
    if not values:
        return ()
    from kinegraph.constraints import Miss

    return tuple(map(Miss.from_dict, values))


def _to_json(value: Sequence[Any]) -> str:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"))


def _npy(array: NDArray[Any]) -> bytes:
    """Encode one array in the `.npy` format."""
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, array, version=(1, 0), allow_pickle=False)
    return buffer.getvalue()
