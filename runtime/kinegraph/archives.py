"""Reading of `.npz` archives from anybody: nothing is allocated that the file does not really hold.

`numpy.load` believes an array's header, allocates what it announces, and unpacks a member whatever its size. Here the
sizes are compared first, with limits of the caller. A leaf: bundles, the parser and clips read through it.
"""

from __future__ import annotations

import io
import math
import sys
import zipfile
import zlib
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

HEADER_BYTES: Final = 4096
"""Upper limit on the `.npy` header of an array of a bundle."""
MAX_MEMBERS: Final = 64
"""Members of an archive; a directory of millions would take gigabytes of objects."""
UNREADABLE: Final = (
    *(OSError, EOFError, ValueError, KeyError, TypeError, AttributeError, RecursionError),
    *(NotImplementedError, RuntimeError, zlib.error, zipfile.BadZipFile),
)
"""Exceptions of NumPy and zipfile for what is no archive, cut short, encrypted, pickled, or compressed otherwise."""

_DIRECTORY_ENTRY: Final = b"PK\x01\x02"
_COMPRESSIONS: Final = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""What NumPy writes; the memory that others take to unpack is chosen by the file."""


def open_archive(data: bytes) -> zipfile.ZipFile:
    """Open an archive in memory.

    Raises:
        ValueError: more than `MAX_MEMBERS`, or two of one name.
        Others of `UNREADABLE`: the bytes are no archive.
    """
    if data.count(_DIRECTORY_ENTRY) > MAX_MEMBERS:
        raise ValueError(f"it has more than {MAX_MEMBERS} members")
    archive = zipfile.ZipFile(io.BytesIO(data))
    names = archive.namelist()
    if len(set(names)) != len(names):
        raise ValueError("it holds a member more than once")
    return archive


def read_arrays(data: bytes, limits: Mapping[str, int]) -> dict[str, NDArray[Any]]:
    """Read the arrays of an archive that may hold nothing else.

    Args:
        data: content of the file.
        limits: most bytes of each array, by name.

    Returns:
        Name -> array, for those of `limits` that the archive holds.

    Raises:
        ValueError: another member, or an array above its limit.
        Others of `UNREADABLE`: damaged, encrypted, pickled, or no archive.
    """
    with open_archive(data) as archive:
        found = archive.namelist()
        foreign = sorted(set(found) - {f"{name}.npy" for name in limits})
        if foreign:
            raise ValueError(f"it may hold {sorted(limits)}, found {foreign[0][:80]!r} too")
        present = [name for name in limits if f"{name}.npy" in found]
        return {name: read_array(archive, name, limits[name] + HEADER_BYTES) for name in present}


def read_array(archive: zipfile.ZipFile, name: str, most: int) -> NDArray[Any]:
    """Read one array of at most `most` bytes, its header included.

    Raises:
        ValueError: too large, objects, or another size than the header says.
        Others of `UNREADABLE`: no such member, damaged, or not in the `.npy` format.
    """
    entry = archive.getinfo(f"{name}.npy")
    if entry.compress_type not in _COMPRESSIONS:
        raise ValueError(f"{name} is compressed in a way that NumPy does not write")
    if entry.file_size > most:
        raise ValueError(f"{name} unpacks to {entry.file_size} bytes; {most} are allowed")
    content = io.BytesIO(archive.read(entry))
    version = np.lib.format.read_magic(content)
    if version != (1, 0):
        raise ValueError(f"{name} is stored in version {version} of the format; kinegraph writes (1, 0)")
    try:
        shape, by_columns, dtype = np.lib.format.read_array_header_1_0(content)
    except MemoryError as error:  # the parser of Python's literals, for one that is nested too deep
        raise ValueError(f"{name} has a header that cannot be read") from error
    count = math.prod(shape)
    holds = count * dtype.itemsize == len(content.getbuffer()) - content.tell() and (dtype.itemsize or count < 2)
    if dtype.hasobject or not holds or min(shape, default=0) < 0:
        raise ValueError(f"{name} does not hold the numbers that its header announces")
    values = content.read()
    if dtype.kind == "U" and (np.frombuffer(values, "<u4") > sys.maxunicode).any():
        raise ValueError(f"{name} holds what is no text")
    return np.ndarray(shape, dtype, values, order="F" if by_columns else "C")
