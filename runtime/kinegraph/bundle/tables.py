"""`tables.npz`: what a run measured on its clips. The weights that tell a clip's length (`kinegraph.conditioning`),
and the
bones of the one body the bundle knows; a bundle need not have either.
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
EXTRA: Final = 3
"""Inputs of the duration model besides the sentence's features: number of actions, number of nodes, and 1."""

_HEADER_BYTES: Final = 4096
"""More than any .npy header of a two-dimensional array."""


def table_shapes(manifest: Manifest) -> dict[str, tuple[int, int]]:
    """Name -> shape of every array that `tables.npz` may hold, all float32."""
    return {DURATION: (1, manifest.text.width + EXTRA), BONE_LENGTHS: (1, JOINTS - 1)}


def bones_of(tables: Mapping[str, FloatArray]) -> FloatArray | None:
    """(21,) metres of the one body that is known; None where there is none."""
    return tables[BONE_LENGTHS][0] if BONE_LENGTHS in tables else None


def read_tables(data: bytes, manifest: Manifest) -> Mapping[str, FloatArray]:
    """Read the tables from memory, without pickle.

    Returns:
        Those arrays of `table_shapes` that are there, read-only.

    Raises:
        BundleFormatError: an array is unknown, of another shape or type, or not finite.
    """
    shapes = table_shapes(manifest)
    try:
        _check_members(data, shapes)
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            found = {name: shape for name, shape in shapes.items() if name in archive.files}
            return MappingProxyType({name: _table(archive[name], name, shape) for name, shape in found.items()})
    except (zipfile.BadZipFile, zlib.error, ValueError, OSError, EOFError, KeyError, RuntimeError) as error:
        # RuntimeError: an encrypted member; NotImplementedError (a RuntimeError): an unknown compression.
        raise BundleFormatError(f"{FILE} is not an npz archive of plain arrays: {error}") from error


def _check_members(data: bytes, shapes: Mapping[str, tuple[int, int]]) -> None:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        found = {member.filename: member.file_size for member in archive.infolist()}
        count = len(archive.infolist())
    if set(found) - {f"{name}.npy" for name in shapes} or count != len(found):
        raise BundleFormatError(f"{FILE} may hold {sorted(shapes)}, once each, found {sorted(found)}")
    for name, (rows, width) in shapes.items():
        # Before unpacking: a small archive can unpack to any size.
        if found.get(f"{name}.npy", 0) > rows * width * 4 + _HEADER_BYTES:
            raise BundleFormatError(f"{FILE}: {name} is larger than its shape {(rows, width)} needs")


def _table(array: object, name: str, shape: tuple[int, int]) -> FloatArray:
    if not isinstance(array, np.ndarray) or array.dtype != np.float32 or array.shape != shape:
        found = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        raise BundleFormatError(f"{FILE}: {name} must be float32 {shape}, found {found}")
    if not np.isfinite(array).all():
        raise BundleFormatError(f"{FILE}: {name} holds NaN or infinity")
    array.setflags(write=False)
    return array
