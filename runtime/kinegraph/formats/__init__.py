"""Files a clip can be saved as, by suffix."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Final, cast

if TYPE_CHECKING:
    from collections.abc import Callable

    from kinegraph.motion.clip import Clip

WRITERS: Final[dict[str, str]] = {
    ".bvh": "kinegraph.formats.bvh",
    ".npz": "kinegraph.formats.npz",
    ".png": "kinegraph.formats.png",
}
"""Suffix -> module with `encode(clip) -> bytes`; loaded when used: a format may need an optional package."""


def encode(clip: Clip, suffix: str) -> bytes:
    """The bytes of a clip as a file of one kind; equal clips give equal bytes.

    Args:
        clip: what to write.
        suffix: a key of `WRITERS`.
    """
    writer = cast("Callable[[Clip], bytes]", import_module(WRITERS[suffix]).encode)
    return writer(clip)
