"""Where a file may be written, and writing it so that it appears complete or not at all."""

from __future__ import annotations

import contextlib
import os
import secrets
import stat
from collections.abc import Collection
from pathlib import Path

from kinegraph.errors import OutputError


def check_target(path: str | os.PathLike[str], force: bool, suffixes: Collection[str]) -> None:
    """Refuse a target that could not be written, before anything is computed for it.

    Args:
        path: file to write; its suffix chooses the format.
        force: whether an existing file may be replaced.
        suffixes: the formats that there are.

    Raises:
        OutputError: unknown suffix, missing or unwritable folder, a directory or device, or an existing file
            without `force`. Nothing has been written.
    """
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
    """Return the one of `suffixes` that a file name ends in.

    Raises:
        OutputError: there is no such format.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in suffixes:
        known = ", ".join(sorted(suffixes))
        said = f"the suffix {suffix!r}" if suffix else "no suffix"
        raise OutputError(f"{str(path)!r} has {said}; it can be saved as {known}")
    return suffix


def write_atomically(path: str | os.PathLike[str], data: bytes, *, force: bool = True) -> None:
    """Write a file under a temporary name in the same folder, then rename it.

    A link is followed: the file it names is replaced, not the link.

    Args:
        path: file to write.
        data: what it holds.
        force: replace a file that is there, also one that came while `data` was made.

    Raises:
        OutputError: the disk is full, the folder cannot be written, or there is a file and no `force`; the target is
            as it was before.
    """
    target = Path(os.path.realpath(path))
    temporary = target.parent / f".kinegraph-{secrets.token_hex(8)}.tmp"
    try:
        _write(temporary, data)
        _rename(temporary, target, force)
    except FileExistsError as error:
        raise OutputError(_exists(repr(str(path)))) from error
    except OSError as error:
        raise OutputError(
            f"{str(path)!r} cannot be written ({_reason(error)}); free some space or choose another folder"
        ) from error
    finally:
        # Gone already if the rename took place; left behind by nothing, not even Ctrl-C. Where nothing may be written
        # there is nothing to take away, and the reason has been given.
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _write(temporary: Path, data: bytes) -> None:
    # Not tempfile: its files are private (0600), and a clip should have the permissions of any new file.
    handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
    with os.fdopen(handle, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def _rename(temporary: Path, target: Path, force: bool) -> None:
    """Give a file its name; without `force` in one step that fails where there is one of that name."""
    if not force:
        try:
            os.link(temporary, target)
            return
        except FileExistsError:
            raise
        except (OSError, AttributeError, NotImplementedError):  # a file system or system without hard links
            if target.exists():
                raise FileExistsError(str(target)) from None
    temporary.replace(target)


def _exists(name: str) -> str:
    return f"{name} exists; choose another name, or replace it with force (--force)"


def _mode(path: Path) -> int | None:
    """Kind and permissions of what is there, None where nothing is."""
    try:
        return path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        raise OutputError(f"{str(path)!r} is no usable path ({_reason(error)}); choose another name") from error


def _check_folder(target: Path) -> None:
    folder = target.parent
    mode = _mode(folder)
    if mode is None or not stat.S_ISDIR(mode):
        what = "does not exist" if mode is None else "is not a folder"
        raise OutputError(f"the folder {str(folder)!r} {what}; make it first or choose another one")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OutputError(f"the folder {str(folder)!r} cannot be written to; choose another one")


def _reason(error: OSError | ValueError) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
