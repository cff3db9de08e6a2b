"""`.npz`: the clip as NumPy arrays, without pickle; the format that `read_npz` reads back.

Holds `joints` (frames, 22, 3) float32 metres, `fps`, `seed`, `text`, `joint_names`, `bundle`, and `graph`, the JSON of
the semantic graph where the clip has one.
"""

from __future__ import annotations

import io
import os
import zipfile
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.errors import InvalidGraphError, InvalidInputError
from kinegraph.graph import SemanticGraph
from kinegraph.motion.skeleton import JOINT_NAMES

if TYPE_CHECKING:
    from kinegraph.clip import Clip

_EPOCH: Final = (1980, 1, 1, 0, 0, 0)
"""Earliest time that ZIP can store; used for every entry."""
_UNIX: Final = 3
"""Code of the system in a ZIP entry; the default would differ on Windows."""
_UNREADABLE: Final = (
    *(OSError, EOFError, ValueError, KeyError, TypeError, AttributeError),
    *(NotImplementedError, RuntimeError, zlib.error, zipfile.BadZipFile),
)
"""Exceptions of NumPy and zipfile for files that are no archive, cut short, encrypted or pickled."""

_NAMES: Final = ("joints", "fps", "seed", "text", "joint_names", "bundle")
_GRAPH: Final = "graph"


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
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name in arrays:
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=_EPOCH)
            entry.create_system = _UNIX
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, _npy(arrays[name]))
    return buffer.getvalue()


def read_npz(path: str | os.PathLike[str]) -> Clip:
    """Read a clip that was saved as `.npz`.

    Args:
        path: file to read.

    Raises:
        InvalidInputError: no such file, or not a clip.
    """
    from kinegraph.clip import Clip

    try:
        with np.load(Path(path), allow_pickle=False) as archive:
            fields = {name: archive[name] for name in (*_NAMES, *({_GRAPH} & {*archive.files}))}
    except FileNotFoundError as error:
        raise InvalidInputError(f"there is no file {str(path)!r}; name a clip saved as .npz") from error
    except _UNREADABLE as error:
        raise InvalidInputError(f"{str(path)!r} is no clip that kinegraph saved ({error})") from error
    if tuple(fields["joint_names"].ravel().tolist()) != JOINT_NAMES:
        raise InvalidInputError(f"{str(path)!r} has other joints; kinegraph reads {', '.join(JOINT_NAMES)}")
    scalars = {name: fields[name] for name in ("fps", "seed", "text", "bundle", _GRAPH) if name in fields}
    not_scalar = [name for name, value in scalars.items() if value.shape != ()]
    if not_scalar:
        raise InvalidInputError(f"{', '.join(not_scalar)} of {str(path)!r} must be a single value each")
    values = {name: value.item() for name, value in scalars.items()}
    try:
        graph = SemanticGraph.from_json(values.pop(_GRAPH)) if _GRAPH in values else None
    except (InvalidGraphError, TypeError) as error:  # TypeError: not a string
        raise InvalidInputError(f"{str(path)!r}: {error}") from error
    return Clip(joints=fields["joints"], graph=graph, **values)


def _npy(array: NDArray[Any]) -> bytes:
    """Encode one array in the `.npy` format."""
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, array, version=(1, 0), allow_pickle=False)
    return buffer.getvalue()
