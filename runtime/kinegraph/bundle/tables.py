"""`tables.npz`: optional tables that a training run measured on its clips.

They are the weights of the duration model (`kinegraph.conditioning`) and the bone lengths of the bundle's one body. A
bundle with released networks has the text encoder's states of an empty caption, which their guidance leads away from.
"""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.bundle.manifest import Manifest
from kinegraph.errors import BundleFormatError
from kinegraph.motion.skeleton import JOINTS

FILE: Final = "tables.npz"
DURATION: Final = "duration"
BONE_LENGTHS: Final = "bone_lengths"
EMPTY_CAPTION: Final = "empty_caption"
EXTRA_INPUTS: Final = 3
"""Inputs of the duration model besides the sentence embedding: number of actions, number of nodes, and 1."""

_HEADER_BYTES: Final = 4096
"""Upper limit on the .npy header of a two-dimensional array."""


def table_shapes(manifest: Manifest) -> dict[str, tuple[int, int]]:
    """Return name -> shape of every array that `tables.npz` may hold, all float32."""
    shapes = {DURATION: (1, manifest.text.width + EXTRA_INPUTS), BONE_LENGTHS: (1, JOINTS - 1)}
    if manifest.family == "kinegraph":
        return shapes
    # the sentence feature, then the hidden states of all positions
    return shapes | {EMPTY_CAPTION: (1 + manifest.text.max_pieces, manifest.text.width)}


def bones_of(tables: Mapping[str, FloatArray]) -> FloatArray | None:
    """Return the bone lengths of the bundle's body, (21,) in metres; None if the bundle has none."""
    return tables[BONE_LENGTHS][0] if BONE_LENGTHS in tables else None


def read_tables(data: bytes, manifest: Manifest) -> Mapping[str, FloatArray]:
    """Read the tables from memory, without pickle.

    Returns:
        Name -> read-only array, for those of `table_shapes` that the file holds.

    Raises:
        BundleFormatError: an array is unknown, has another shape or type, or is not finite.
    """
    shapes = table_shapes(manifest)
    try:
        _check_members(data, shapes)
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            present = {name: shape for name, shape in shapes.items() if name in archive.files}
            if EMPTY_CAPTION in shapes and EMPTY_CAPTION not in present:
                raise BundleFormatError(f"{FILE} lacks {EMPTY_CAPTION}, which networks of this family need")
            return MappingProxyType({name: _table(archive[name], name, shape) for name, shape in present.items()})
    except (zipfile.BadZipFile, zlib.error, ValueError, OSError, EOFError, KeyError, RuntimeError) as error:
        # RuntimeError: an encrypted member; NotImplementedError (a RuntimeError): an unknown compression.
        raise BundleFormatError(f"{FILE} is not an npz archive of plain arrays: {error}") from error


def _check_members(data: bytes, shapes: Mapping[str, tuple[int, int]]) -> None:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        sizes = {member.filename: member.file_size for member in archive.infolist()}
        count = len(archive.infolist())
    if set(sizes) - {f"{name}.npy" for name in shapes} or count != len(sizes):
        raise BundleFormatError(f"{FILE} may hold {sorted(shapes)}, once each, found {sorted(sizes)}")
    for name, (rows, width) in shapes.items():
        # Checked before unpacking: a small archive can unpack to any size.
        if sizes.get(f"{name}.npy", 0) > rows * width * 4 + _HEADER_BYTES:
            raise BundleFormatError(f"{FILE}: {name} is larger than its shape {(rows, width)} needs")


def _table(array: object, name: str, shape: tuple[int, int]) -> FloatArray:
    if not isinstance(array, np.ndarray) or array.dtype != np.float32 or array.shape != shape:
        kind = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        raise BundleFormatError(f"{FILE}: {name} must be float32 {shape}, found {kind}")
    if not np.isfinite(array).all():
        raise BundleFormatError(f"{FILE}: {name} holds NaN or infinity")
    array.setflags(write=False)
    return array
