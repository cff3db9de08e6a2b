"""Read a bundle: a folder with `manifest.json` and the files that it lists, each hashed whenever it is read.

Bundles that are installed with the package lie in `BUNDLES`, in folders of their names. They share the files that they
have in common, which lie once in `BUNDLES / "shared"`:

    bundles/shared/    text_encoder.onnx  tokenizer.json  parser.bin  arguments.npz
    bundles/studio/    manifest.json, and all other files that it lists
    bundles/open/      the same

Each manifest lists and hashes the shared files that its bundle uses like its own.
"""

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
from kinegraph.bundle.contract import graph_files, optional_graph_files
from kinegraph.bundle.manifest import FileSpec, Manifest, decode_manifest
from kinegraph.bundle.onnx_inspect import check_self_contained
from kinegraph.bundle.tables import read_tables
from kinegraph.bundle.vocabulary import FILE as VOCABULARY
from kinegraph.bundle.vocabulary import Vocabulary, read_vocabulary
from kinegraph.errors import BundleError, BundleFormatError, BundleIntegrityError
from kinegraph.validation import short_repr

MANIFEST: Final = "manifest.json"

BUNDLES: Final = Path(__file__).parents[1] / "bundles"
"""Folder of the bundles that are installed with the package."""
DEFAULT_NAME: Final = "studio"
DEFAULT_BUNDLE: Final = BUNDLES / DEFAULT_NAME
"""Installed bundle that is loaded where none is named."""
SHARED: Final = "shared"
"""Folder beside installed bundles that holds `SHARED_FILES`; no bundle has this name."""
SHARED_FILES: Final[frozenset[str]] = frozenset(("text_encoder.onnx", "tokenizer.json", "parser.bin", "arguments.npz"))
"""Files that installed bundles may share: what reads text, which training does not change."""

MAX_MANIFEST_BYTES: Final = 1 << 20
MAX_FILE_BYTES: Final = 1 << 30
"""Below the 2 GiB limit of protobuf; the largest known text encoder takes half of it."""
MAX_BUNDLE_BYTES: Final = 1 << 32
"""The released GraphMotion in float32 has 3.4 GB."""
LARGE_FILE: Final = 1 << 26
"""Bytes from which on a file is read when its session is opened: released denoisers, of which one at a time is held."""

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
    """A bundle in memory, every byte checked. Drop it once the sessions are open: they have copies of what it holds."""

    path: Path
    manifest: Manifest
    files: Mapping[str, bytes]
    """File name -> content, without optional graphs and files of `LARGE_FILE` and more (`read_later`)."""
    tables: Mapping[str, FloatArray]
    """Arrays of `tables.npz` that the bundle has (`tables.table_shapes`), read-only."""
    vocabulary: Vocabulary | None = None
    """Words and phrases that training showed; None if the bundle has no `vocabulary.npz`."""
    shared: frozenset[str] = frozenset()
    """Files that lie beside the bundle (`SHARED`)."""

    def read_later(self, name: str) -> bytes:
        """Read and check now the file of a graph that `files` lacks; nothing of it is kept.

        Who never uses an optional graph does not pay for it, and large files are not in memory together.

        Raises:
            BundleFormatError, BundleIntegrityError: as in `read_bundle`.
        """
        data = _read_listed(_place(self.path, name, self.shared), name, self.manifest.files[name])
        check_self_contained(data, name)
        return data

    def read_graph(self, name: str) -> bytes:
        """Return the checked file of a graph, from `files` or from disk."""
        return self.files[name] if name in self.files else self.read_later(name)


def installed_bundles() -> dict[str, Path]:
    """List the folders of the bundles that are installed with the package, by name."""
    if not BUNDLES.is_dir():
        return {}
    folders = sorted(path for path in BUNDLES.iterdir() if path.name != SHARED and (path / MANIFEST).is_file())
    return {folder.name: folder for folder in folders}


def text_files_folder() -> Path:
    """Return the folder that holds the files of installed bundles that read text (`SHARED_FILES`)."""
    shared = BUNDLES / SHARED
    return shared if shared.is_dir() else DEFAULT_BUNDLE


def read_manifest(path: Path) -> Manifest:
    """Read the manifest of a bundle's folder, and none of its other files.

    Raises:
        BundleFormatError, BundleIntegrityError: as in `read_bundle`.
    """
    return decode_manifest(_read(path, MANIFEST, MAX_MANIFEST_BYTES))


def manifest_digest(path: str | Path | None = None) -> str:
    """Digest the manifest of a bundle, which has the digests of all its files: SHA-256 in hexadecimal digits.

    Args:
        path: as in `read_bundle`.

    Raises:
        BundleError, BundleFormatError: as in `read_bundle`.
    """
    return hashlib.sha256(_read(_folder(path), MANIFEST, MAX_MANIFEST_BYTES)).hexdigest()


def read_bundle(path: str | Path | None = None) -> Bundle:
    """Read a bundle and check that it is complete and unaltered, without opening a session.

    Optional graphs and large ones only have to exist: they are read and checked when they are used
    (`Bundle.read_later`), which for large ones is when sessions are opened.

    Args:
        path: folder of the bundle; None takes the default bundle. A text that is the name of an installed bundle is
            that bundle, wherever the process runs; a folder of that name here is "./NAME", or a `Path`.

    Raises:
        BundleError: there is no such folder, or it cannot be read.
        BundleFormatError: the manifest, the tables, the vocabulary or a graph break the format.
        BundleIntegrityError: a file is missing, extra, not a regular file, or differs from the manifest.
    """
    folder = _folder(path)
    manifest = read_manifest(folder)
    shared = _check_listing(folder, manifest)
    _check_sizes(manifest.files)
    graphs = frozenset(graph_files(manifest.format_version, manifest.family))
    large = {name for name in graphs if manifest.files[name].bytes >= LARGE_FILE}
    later = optional_graph_files(manifest.format_version) | large
    files = {
        name: _read_listed(_place(folder, name, shared), name, entry)
        for name, entry in manifest.files.items()
        if name not in later
    }
    for name in graphs - large:
        check_self_contained(files[name], name)
    tables = read_tables(files["tables.npz"], manifest)
    vocabulary = read_vocabulary(files[VOCABULARY], manifest.text.width) if VOCABULARY in files else None
    return Bundle(folder, manifest, MappingProxyType(files), tables, vocabulary, shared)


def _place(folder: Path, name: str, shared: frozenset[str]) -> Path:
    """Return the folder that a file of a bundle lies in."""
    return folder.parent / SHARED if name in shared else folder


def _folder(path: str | Path | None) -> Path:
    if isinstance(path, str):
        path = installed_bundles().get(path, path)
    if path is None and not DEFAULT_BUNDLE.is_dir():
        raise BundleError(
            "this installation carries no default bundle; install kinegraph again, or name a bundle's folder"
        )
    if not isinstance(path, str | os.PathLike | None):
        raise BundleError(f"a bundle is named by the path of a folder, not by {short_repr(path)}")
    try:
        # Links on the path to the folder are the caller's choice; inside the folder none are allowed.
        folder = Path(DEFAULT_BUNDLE if path is None else path).resolve(strict=True)
    except (OSError, ValueError, RuntimeError) as error:  # ValueError: NUL; RuntimeError: a loop of links
        names = ", ".join(installed_bundles()) or "none"
        raise BundleError(f"no bundle at {str(path)!r} (installed are: {names}): {error}") from error
    if not folder.is_dir():
        raise BundleError(f"{str(path)!r} is not a folder; a bundle is a folder with a {MANIFEST}")
    return folder


def _check_listing(folder: Path, manifest: Manifest) -> frozenset[str]:
    """Check that a bundle has the files that its manifest lists and no others; returns those that it shares."""
    present = _list_names(folder)
    listed = {MANIFEST, *manifest.files}
    shared = _shared_names(folder) & (listed - present)
    for name in sorted(listed - present - shared):
        # Text files of an installed bundle stay behind where its folder is copied.
        copied = (
            f" (of a copied one, copy what lies in {SHARED!r} beside the original too)" if name in SHARED_FILES else ""
        )
        raise BundleIntegrityError(f"{name} is missing from the bundle {str(folder)!r}; fetch the bundle again{copied}")
    for name in sorted(present - listed):
        raise BundleIntegrityError(f"{name!r} in the bundle {str(folder)!r} is not listed in its {MANIFEST}; remove it")
    return shared


def _list_names(folder: Path) -> set[str]:
    try:
        with os.scandir(folder) as entries:
            # Names are compared exactly, so "Decoder.onnx" is an extra file on case-blind disks too.
            return {entry.name for entry in entries}
    except OSError as error:
        raise BundleError(f"cannot list the bundle {str(folder)!r}: {error}") from error


def _shared_names(folder: Path) -> frozenset[str]:
    """List the files that lie beside an installed bundle for all of them; none for a bundle anywhere else."""
    shared = folder.parent / SHARED
    if folder.parent != BUNDLES.resolve() or not (shared.is_dir() or shared.is_symlink()):
        return frozenset()
    if shared.is_symlink():
        raise BundleIntegrityError(f"{str(shared)!r} is a link; install kinegraph again")
    return SHARED_FILES & _list_names(shared)


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
