"""Files a clip can be saved as, by suffix."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Final, cast

from kinegraph.errors import MissingExtraError

if TYPE_CHECKING:
    from collections.abc import Callable

    from kinegraph.motion.clip import Clip

WRITERS: Final[dict[str, str]] = {
    ".bvh": "kinegraph.formats.bvh",
    ".npz": "kinegraph.formats.npz",
    ".png": "kinegraph.formats.png",
}
"""Suffix -> module with `encode(clip) -> bytes`; loaded when used: a format may need an optional package."""

_NEEDS: Final[dict[str, tuple[str, str]]] = {".png": ("matplotlib", "plot")}
"""Suffix -> package beyond numpy that its writer needs, and the extra that installs it."""


def check_installed(suffix: str) -> None:
    """Raise MissingExtraError where a format's package is not installed; nothing is imported."""
    if suffix in _NEEDS:
        package, extra = _NEEDS[suffix]
        if find_spec(package) is None:
            raise MissingExtraError(f'{suffix} files need {package}: pip install "kinegraph[{extra}]"')


def encode(clip: Clip, suffix: str) -> bytes:
    """The bytes of a clip as a file of one kind; equal clips give equal bytes.

    Args:
        clip: what to write.
        suffix: a key of `WRITERS`.

    Raises:
        MissingExtraError: the format needs a package that is not installed.
    """
    check_installed(suffix)
    writer = cast("Callable[[Clip], bytes]", import_module(WRITERS[suffix]).encode)
    return writer(clip)
