"""File formats a clip can be saved in and read from, by suffix.

Clips import formats, not the other way round: no module here imports `kinegraph.clip`; `read` loads it by name.
"""

from __future__ import annotations

import os
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

from kinegraph.errors import InvalidInputError, MissingExtraError
from kinegraph.files import check_target, suffix_of
from kinegraph.motion.skeleton import CONVENTIONS, DEFAULT_NAMES
from kinegraph.validation import short_repr

if TYPE_CHECKING:
    from collections.abc import Callable

    from kinegraph.clip import Clip

WRITERS: Final[dict[str, str]] = {
    ".bvh": "kinegraph.formats.bvh:encode",
    ".gif": "kinegraph.formats.video:encode_gif",
    ".glb": "kinegraph.formats.glb:encode",
    ".html": "kinegraph.formats.html:encode",
    ".json": "kinegraph.formats.json:encode",
    ".mp4": "kinegraph.formats.video:encode_mp4",
    ".npz": "kinegraph.formats.npz:encode",
    ".png": "kinegraph.formats.contact_sheet:encode",
    ".vrma": "kinegraph.formats.vrma:encode",
}
"""Suffix -> module:function, `function(clip) -> bytes`; imported when used, as some need optional packages."""

READERS: Final[dict[str, str]] = {
    ".bvh": "kinegraph.formats.bvh_reader:decode",
    ".glb": "kinegraph.formats.glb_reader:decode",
    ".json": "kinegraph.formats.json:decode",
    ".npz": "kinegraph.formats.npz:decode",
}
"""Suffix -> module:function, `function(bytes)` that returns fields of `Clip`, text and seed where the file has them."""

MAX_BYTES: Final = 1 << 27
"""Size of a file that is read; ten minutes at 60 frames per second have 10 (.npz) to 55 MB (.json)."""

NAMED: Final = frozenset((".bvh", ".glb"))
"""Formats whose joints follow a naming convention, and can hang on a root joint."""

_REQUIRED_PACKAGES: Final[dict[str, tuple[str, ...]]] = {
    ".gif": ("PIL",),
    ".mp4": ("PIL", "av"),
    ".png": ("matplotlib",),
}
"""Suffix -> packages beyond numpy that its writer imports; the extra `plot` installs them."""


def encode(clip: Clip, suffix: str, names: str = DEFAULT_NAMES, root: bool = False) -> bytes:
    """Encode a clip as the bytes of a file; equal clips give equal bytes.

    Args:
        clip: clip to encode.
        suffix: a key of `WRITERS`.
        names: naming convention of the joints, a key of `skeleton.CONVENTIONS`, in files for animation programs.
        root: add a joint "root" on the floor, above the pelvis, that carries travel and heading; in files for
            animation programs.

    Raises:
        InvalidInputError: unknown convention, or the format has no convention or no root joint.
        MissingExtraError: the format needs a package that is not installed.
    """
    check_names(suffix, names)
    check_root(suffix, root)
    check_installed(suffix)
    writer = _function(WRITERS[suffix])
    data: bytes = writer(clip, names, root) if suffix in NAMED else writer(clip)
    return data


def read(path: str | os.PathLike[str], *, suffix: str | None = None) -> Clip:
    """Read a clip that kinegraph saved.

    `.npz` holds the clip itself, and `.json` its joints to 0.005 mm. `.bvh` and `.glb` hold the solved skeleton: the
    joints come back where the file shows them, to 0.01 mm, which is on average 0.6 mm from those of the generated clip
    that was saved. Text, seed and bundle come back from all but `.bvh`, which has no room for them: the text is then
    the name of the file, the seed 0. `.npz` alone keeps the graph.

    Args:
        path: file to read, of at most `MAX_BYTES`.
        suffix: a key of `READERS`; None takes that of the file's name.

    Raises:
        InvalidInputError: no such file, another format, or not a file that kinegraph wrote.
    """
    if not isinstance(path, str | os.PathLike):
        raise InvalidInputError(f"a clip is read from a path, not from {short_repr(path)}")
    name, file = repr(str(path)), Path(path)
    suffix = file.suffix.lower() if suffix is None else suffix
    if not isinstance(suffix, str) or suffix not in READERS:
        actual = "no suffix" if isinstance(suffix, str) and not suffix else f"the suffix {short_repr(suffix)}"
        raise InvalidInputError(f"{name} has {actual}; clips are read from {', '.join(sorted(READERS))}")
    data = _read_bytes(file)
    try:
        fields: dict[str, Any] = _function(READERS[suffix])(data)
        if "text" not in fields:
            fields |= {"text": file.stem.encode("utf-8", "replace").decode(), "seed": 0, "bundle": "unknown"}
        # by name, like the readers: clips import formats, and formats no clips
        clip: Clip = _function("kinegraph.clip:Clip")(**fields)
        return clip
    except InvalidInputError as error:
        raise InvalidInputError(f"{name} is no clip that kinegraph saved as {suffix}: {error}") from error


def check_clip_target(path: str | os.PathLike[str], force: bool = False) -> None:
    """Refuse a path that a clip could not be saved to, before anything is computed for it.

    Args:
        path: file to write; its suffix, one of `WRITERS`, chooses the format.
        force: whether an existing file may be replaced.

    Raises:
        OutputError: see `files.check_target`. Nothing has been written.
        MissingExtraError: the format needs a package that is not installed.
    """
    check_target(path, force, WRITERS)
    check_installed(suffix_of(path, WRITERS))


def check_installed(suffix: str) -> None:
    """Refuse a format whose optional package is not installed; imports nothing.

    Raises:
        MissingExtraError: naming the package and the extra that installs it.
    """
    for package in _REQUIRED_PACKAGES.get(suffix, ()):
        if find_spec(package) is None:
            raise MissingExtraError(f'{suffix} files need {package}: pip install "kinegraph[plot]"')


def check_root(suffix: str, root: bool) -> None:
    """Refuse a root joint for a format that has no skeleton to add it to.

    Raises:
        InvalidInputError: naming the formats that can have one.
    """
    if root and suffix not in NAMED:
        raise InvalidInputError(f"a root joint is for {', '.join(sorted(NAMED))}, not for {suffix}")


def check_names(suffix: str, names: str) -> None:
    """Refuse an unknown naming convention, or one for a format that does not name joints by convention.

    Raises:
        InvalidInputError: naming the conventions, or the formats that have them.
    """
    if not isinstance(names, str) or names not in CONVENTIONS:
        raise InvalidInputError(f"joint names must be one of {', '.join(CONVENTIONS)}, not {short_repr(names)}")
    if names != DEFAULT_NAMES and suffix not in NAMED:
        raise InvalidInputError(f"joint names {names!r} are for {', '.join(sorted(NAMED))}, not for {suffix}")


def _function(name: str) -> Callable[..., Any]:
    """Import `module:function`."""
    module, _, function = name.partition(":")
    return cast("Callable[..., Any]", getattr(import_module(module), function))


def _read_bytes(path: Path) -> bytes:
    """Read a file whole.

    Raises:
        InvalidInputError: no file, unreadable, or larger than `MAX_BYTES`.
    """
    name = repr(str(path))
    try:
        if not path.is_file():
            raise InvalidInputError(f"there is no file {name}; name a clip saved as {', '.join(sorted(READERS))}")
        if path.stat().st_size > MAX_BYTES:
            raise InvalidInputError(f"{name} is larger than {MAX_BYTES >> 20} MiB; clips that long are not read")
        return path.read_bytes()
    except (OSError, ValueError) as error:
        if isinstance(error, InvalidInputError):
            raise
        raise InvalidInputError(f"{name} cannot be read ({error}); check the name and its permissions") from error
