"""Checks of output paths, and atomic writes: a file appears complete or not at all.

A leaf: formats, the command line, training and benchmarks all write through it.

A process that is killed while it writes leaves a temporary file behind. Its lock dies with it, so the next write to the
folder can tell such files from those of living writers, and removes them.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import secrets
import stat
from collections.abc import Collection
from pathlib import Path
from typing import BinaryIO, Final

from kinegraph.errors import OutputError
from kinegraph.validation import short_repr

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_TEMPORARY: Final = re.compile(r"\.kinegraph-[0-9a-f]{16}\.tmp")
_MAX_LISTED: Final = 10_000
"""Names of a folder that are looked at for temporary files: a few milliseconds."""
_ATTEMPTS: Final = 10


def check_target(path: str | os.PathLike[str], force: bool, suffixes: Collection[str]) -> None:
    """Refuse a path that could not be written, before anything is computed for it.

    Args:
        path: file to write; its suffix chooses the format.
        force: whether an existing file may be replaced.
        suffixes: known formats.

    Raises:
        OutputError: unknown suffix, missing or unwritable folder, a directory or device, or an existing file
            without `force`. Nothing has been written.
    """
    if not isinstance(path, str | os.PathLike):
        raise OutputError(f"a file is written to a path, not to {short_repr(path)}")
    target = Path(path)
    name = repr(str(target))
    mode = _mode(target)
    if mode is not None and stat.S_ISDIR(mode):
        raise OutputError(f"{name} is a directory; name a file, for example {str(target / 'clip.npz')!r}")
    suffix_of(target, suffixes)
    _check_folder(target)
    if mode is None:
        return
    if not stat.S_ISREG(mode):
        raise OutputError(f"{name} is a device or pipe, not a file; name a file")
    if not force:
        raise OutputError(_exists(name))
    if not os.access(target, os.W_OK):
        raise OutputError(f"{name} is write-protected; make it writable or choose another name")


def suffix_of(path: str | os.PathLike[str], suffixes: Collection[str]) -> str:
    """Return the suffix of a file name, in lower case.

    Args:
        path: file name.
        suffixes: known formats.

    Raises:
        OutputError: the suffix is none of `suffixes`.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in suffixes:
        known = ", ".join(sorted(suffixes))
        actual = f"the suffix {suffix!r}" if suffix else "no suffix"
        raise OutputError(f"{str(path)!r} has {actual}; it can be saved as {known}")
    return suffix


def write_atomically(path: str | os.PathLike[str], data: bytes, *, force: bool = True) -> None:
    """Write a file under a temporary name in the same folder, then rename it.

    A link is followed: the file it names is replaced, not the link. Temporary files that killed processes left in the
    folder are removed.

    Args:
        path: file to write.
        data: content of the file.
        force: replace an existing file, also one that appeared while `data` was computed.

    Raises:
        OutputError: the disk is full, the folder cannot be written, or the file exists without `force`. The target
            is then as it was before.
    """
    target = Path(os.path.realpath(path))
    _remove_abandoned(target.parent)
    temporary = target.parent / f".kinegraph-{secrets.token_hex(8)}.tmp"
    try:
        with _created(temporary) as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
            if fcntl is not None:  # still locked; Windows renames closed files only
                _rename(temporary, target, force)
        if fcntl is None:
            _rename(temporary, target, force)
    except FileExistsError as error:
        raise OutputError(_exists(repr(str(path)))) from error
    except OSError as error:
        raise OutputError(
            f"{str(path)!r} cannot be written ({_reason(error)}); free some space or choose another folder"
        ) from error
    finally:
        # Remove the temporary file after any failure, even Ctrl-C; after the rename it is gone already. On a read-only
        # file system there is nothing to remove, and the error above says why.
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _created(temporary: Path) -> BinaryIO:
    """Create a file and lock it, where files can be locked."""
    for _ in range(_ATTEMPTS):
        # not tempfile: its files are private (0600), and a clip should have the permissions of any new file
        handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
        file = os.fdopen(handle, "wb")
        if fcntl is None or not _lock(handle, wait=True):
            return file
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(temporary.stat(), os.fstat(handle)):
                return file
        file.close()  # taken for abandoned, and removed, before it was locked
    raise OSError("temporary files vanish from the folder")


def _lock(handle: int, *, wait: bool) -> bool:
    """Lock an open file; False if that cannot be done, or not now."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        return False
    return True


def _remove_abandoned(folder: Path) -> None:
    """Remove the temporary files of processes that died; others are locked."""
    if fcntl is None:
        return
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in itertools.islice(entries, _MAX_LISTED):
            if _TEMPORARY.fullmatch(entry.name):
                with contextlib.suppress(OSError):
                    _remove_unlocked(Path(entry.path))


def _remove_unlocked(path: Path) -> None:
    """Remove a regular file of this user that nobody has locked."""
    handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    try:
        status = os.fstat(handle)
        if stat.S_ISREG(status.st_mode) and status.st_uid == os.geteuid() and _lock(handle, wait=False):
            path.unlink()
    finally:
        os.close(handle)


def _rename(temporary: Path, target: Path, force: bool) -> None:
    """Rename a file; without `force` in one atomic step that fails if the target exists."""
    if not force:
        try:
            os.link(temporary, target)
            return
        except FileExistsError:
            raise
        except (OSError, AttributeError, NotImplementedError):  # no hard links on this system or file system
            if target.exists():
                raise FileExistsError(str(target)) from None
    temporary.replace(target)


def _exists(name: str) -> str:
    return f"{name} exists; choose another name, or replace it with force (--force)"


def _mode(path: Path) -> int | None:
    """Return the file type and permissions at a path, None where nothing exists.

    Raises:
        OutputError: the system refuses the path.
    """
    try:
        return path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        raise OutputError(f"{str(path)!r} is no usable path ({_reason(error)}); choose another name") from error


def _check_folder(target: Path) -> None:
    """Refuse a target whose folder is missing or cannot be written to."""
    folder = target.parent
    mode = _mode(folder)
    if mode is None or not stat.S_ISDIR(mode):
        problem = "does not exist" if mode is None else "is not a folder"
        raise OutputError(f"the folder {str(folder)!r} {problem}; make it first or choose another one")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OutputError(f"the folder {str(folder)!r} cannot be written to; choose another one")


def _reason(error: OSError | ValueError) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
