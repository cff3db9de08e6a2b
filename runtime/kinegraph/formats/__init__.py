"""File formats a clip can be saved in, by suffix.

Formats know clips, not the other way round: no module here imports `kinegraph.clip` when it is loaded.
"""

from __future__ import annotations

import os
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Final, cast

from kinegraph.errors import InvalidInputError, MissingExtraError
from kinegraph.files import check_target, suffix_of
from kinegraph.motion.skeleton import CONVENTIONS, DEFAULT_NAMES

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
}
"""Suffix -> module:function, `function(clip) -> bytes`; imported when used, as some need optional packages."""

NAMED: Final = frozenset((".bvh", ".glb"))
"""Formats whose joints follow a naming convention."""

_REQUIRED_PACKAGES: Final[dict[str, tuple[str, ...]]] = {
    ".gif": ("PIL",),
    ".mp4": ("PIL", "av"),
    ".png": ("matplotlib",),
}
"""Suffix -> packages beyond numpy that its writer imports; the extra `plot` installs them."""


def encode(clip: Clip, suffix: str, names: str = DEFAULT_NAMES) -> bytes:
    """Encode a clip as the bytes of a file; equal clips give equal bytes.

    Args:
        clip: clip to encode.
        suffix: a key of `WRITERS`.
        names: naming convention of the joints, a key of `skeleton.CONVENTIONS`, in files for animation programs.

    Raises:
        InvalidInputError: unknown convention, or the format has none.
        MissingExtraError: the format needs a package that is not installed.
    """
    check_names(suffix, names)
    check_installed(suffix)
    module, _, function = WRITERS[suffix].partition(":")
    writer = cast("Callable[..., bytes]", getattr(import_module(module), function))
    return writer(clip, names) if suffix in NAMED else writer(clip)


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


def check_names(suffix: str, names: str) -> None:
    """Refuse an unknown naming convention, or one for a format that does not name joints by convention.

    Raises:
        InvalidInputError: naming the conventions, or the formats that have them.
    """
    if names not in CONVENTIONS:
        raise InvalidInputError(f"joint names must be one of {', '.join(CONVENTIONS)}, not {names!r}")
    if names != DEFAULT_NAMES and suffix not in NAMED:
        raise InvalidInputError(f"joint names {names!r} are for {', '.join(sorted(NAMED))}, not for {suffix}")
