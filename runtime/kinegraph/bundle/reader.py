"""Read a bundle: a folder with `manifest.json` and the files that it lists, each read once and hashed."""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

from kinegraph.arrays import FloatArray
from kinegraph.bundle.manifest import GRAPH_FILES, OPTIONAL_GRAPH_FILES, FileSpec, Manifest, decode_manifest
from kinegraph.bundle.onnx_inspect import check_self_contained
from kinegraph.bundle.tables import read_tables
from kinegraph.bundle.vocabulary import FILE as VOCABULARY
from kinegraph.bundle.vocabulary import Vocabulary, read_vocabulary
from kinegraph.errors import BundleError, BundleFormatError, BundleIntegrityError

MANIFEST: Final = "manifest.json"

DEFAULT_BUNDLE: Final = Path(__file__).parents[1] / "bundles" / "default"
"""Bundle that is installed with the package."""

MAX_MANIFEST_BYTES: Final = 1 << 20
MAX_FILE_BYTES: Final = 1 << 30
"""Below the 2 GiB limit of protobuf; the largest known text encoder takes half of it."""
MAX_BUNDLE_BYTES: Final = 1 << 32
"""The released GraphMotion in float32 has 3.4 GB."""

_OPEN_FLAGS: Final = (
    os.O_RDONLY
    # Windows lacks these flags; it has neither FIFOs in folders nor links that one follows by accident.
    | getattr(os, "O_NOFOLLOW", 0)
    | getattr(os, "O_NONBLOCK", 0)  # opening a FIFO must not wait for its writer
    | getattr(os, "O_CLOEXEC", 0)
    | getattr(os, "O_BINARY", 0)
)


@dataclass(frozen=True)
class Bundle:
    """A bundle in memory, every byte checked. It holds all files: drop it once the sessions are open."""

    path: Path
    manifest: Manifest
    files: Mapping[str, bytes]
    """File name -> content, without the graphs of `contract.OPTIONAL_GRAPHS`."""
    tables: Mapping[str, FloatArray]
    """Arrays of `tables.npz` that the bundle has (`tables.table_shapes`), read-only."""
    vocabulary: Vocabulary | None = None
    """Words and phrases that training showed; None if the bundle has no `vocabulary.npz`."""

    def read_optional(self, name: str) -> bytes:
        """Read and check the file of an optional graph now; who never uses it does not pay for it.

        Raises:
            BundleFormatError, BundleIntegrityError: as in `read_bundle`.
        """
        data = _read_listed(self.path, name, self.manifest.files[name])
        check_self_contained(data, name)
        return data


def read_bundle(path: Path | None = None) -> Bundle:
    """Read a bundle and check that it is complete and unaltered, without opening a session.

    Optional graphs only have to exist: they are read at their first use (`Bundle.read_optional`).

    Args:
        path: folder of the bundle; None takes the default bundle.

    Raises:
        BundleError: there is no such folder, or it cannot be read.
        BundleFormatError: the manifest, the tables, the vocabulary or a graph break the format.
        BundleIntegrityError: a file is missing, extra, not a regular file, or differs from the manifest.
    """
    folder = _folder(path)
    manifest = decode_manifest(_read(folder, MANIFEST, MAX_MANIFEST_BYTES))
    _check_listing(folder, manifest)
    _check_sizes(manifest.files)
    files = {
        name: _read_listed(folder, name, entry)
        for name, entry in manifest.files.items()
        if name not in OPTIONAL_GRAPH_FILES
    }
    for name in (name for name in GRAPH_FILES if name in files):
        check_self_contained(files[name], name)
    tables = read_tables(files["tables.npz"], manifest)
    vocabulary = read_vocabulary(files[VOCABULARY], manifest.text.width) if VOCABULARY in files else None
    return Bundle(folder, manifest, MappingProxyType(files), tables, vocabulary)


def _folder(path: Path | None) -> Path:
    if path is None and not DEFAULT_BUNDLE.is_dir():
        raise BundleError(
            "this installation carries no default bundle; install kinegraph again, or name a bundle's folder"
        )
    try:
        # Links on the path to the folder are the caller's choice; inside the folder none are allowed.
        folder = Path(DEFAULT_BUNDLE if path is None else path).resolve(strict=True)
    except (OSError, ValueError, RuntimeError) as error:  # ValueError: NUL; RuntimeError: a loop of links
        raise BundleError(f"no bundle at {str(path)!r}: {error}") from error
    if not folder.is_dir():
        raise BundleError(f"{str(path)!r} is not a folder; a bundle is a folder with a {MANIFEST}")
    return folder


def _check_listing(folder: Path, manifest: Manifest) -> None:
    try:
        with os.scandir(folder) as entries:
            # Names are compared exactly, so "Decoder.onnx" is an extra file on case-blind disks too.
            present = {entry.name for entry in entries}
    except OSError as error:
        raise BundleError(f"cannot list the bundle {str(folder)!r}: {error}") from error
    listed = {MANIFEST, *manifest.files}
    for name in sorted(listed - present):
        raise BundleIntegrityError(f"{name} is missing from the bundle {str(folder)!r}; fetch the bundle again")
    for name in sorted(present - listed):
        raise BundleIntegrityError(f"{name!r} in the bundle {str(folder)!r} is not listed in its {MANIFEST}; remove it")


def _check_sizes(files: Mapping[str, FileSpec]) -> None:
    for name, entry in files.items():
        if entry.bytes > MAX_FILE_BYTES:
            raise BundleFormatError(f"{name} has {entry.bytes} bytes; a file may have {MAX_FILE_BYTES} at most")
    total = sum(entry.bytes for entry in files.values())
    if total > MAX_BUNDLE_BYTES:
        raise BundleFormatError(f"the files have {total} bytes; a bundle may have {MAX_BUNDLE_BYTES} at most")


def _read_listed(folder: Path, name: str, entry: FileSpec) -> bytes:
    data = _read(folder, name, entry.bytes)
    if len(data) != entry.bytes:
        raise BundleIntegrityError(f"{name} has {len(data)} bytes instead of {entry.bytes}; fetch the bundle again")
    if hashlib.sha256(data).hexdigest() != entry.sha256:
        raise BundleIntegrityError(f"{name} differs from the manifest's SHA-256; fetch the bundle again")
    return data


def _read(folder: Path, name: str, most: int) -> bytes:
    """Read a regular file of at most `most` bytes, without following a link.

    Hard links are accepted on purpose: uv, Nix, OSTree and deduplicating stores install every file as one. They
    redirect nothing, and their content must still have the listed SHA-256.
    """
    path = folder / name
    try:
        # O_NOFOLLOW refuses links without a race where it exists. This test adds a clear message, and covers Windows.
        if path.is_symlink():
            raise BundleIntegrityError(f"{name} is a link; the files of a bundle must be regular files")
        descriptor = os.open(path, _OPEN_FLAGS)
    except FileNotFoundError as error:
        raise BundleIntegrityError(f"{name} is missing from the bundle {str(folder)!r}") from error
    except OSError as error:
        raise BundleIntegrityError(f"{name} cannot be opened: {error.strerror}") from error
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise BundleIntegrityError(f"{name} is not a regular file")
        if status.st_size > most:
            raise BundleIntegrityError(f"{name} is too large: {status.st_size} bytes instead of at most {most}")
        with open(descriptor, "rb", closefd=False) as file:
            return file.read(status.st_size + 1)
    except OSError as error:
        raise BundleIntegrityError(f"{name} cannot be read: {error.strerror}") from error
    finally:
        os.close(descriptor)
