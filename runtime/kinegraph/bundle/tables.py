"""`tables.npz`: optional tables that a training run measured on its clips.

They are the weights of the duration model (`kinegraph.conditioning`) and the bone lengths of the bundle's one body. A
bundle with released networks has the text encoder's states of an empty caption, which their guidance leads away from.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.archives import UNREADABLE, read_arrays
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
        arrays = read_arrays(data, {name: rows * width * 4 for name, (rows, width) in shapes.items()})
    except UNREADABLE as error:
        raise BundleFormatError(f"{FILE} is not an npz archive of plain arrays: {error}") from error
    if EMPTY_CAPTION in shapes and EMPTY_CAPTION not in arrays:
        raise BundleFormatError(f"{FILE} lacks {EMPTY_CAPTION}, which networks of this family need")
    return MappingProxyType({name: _table(array, name, shapes[name]) for name, array in arrays.items()})


def _table(array: NDArray[Any], name: str, shape: tuple[int, int]) -> FloatArray:
    if array.dtype != np.float32 or array.shape != shape:
        raise BundleFormatError(f"{FILE}: {name} must be float32 {shape}, found {array.dtype} {array.shape}")
    if not np.isfinite(array).all():
        raise BundleFormatError(f"{FILE}: {name} holds NaN or infinity")
    array.setflags(write=False)
    return array
