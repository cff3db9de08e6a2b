"""Parts of sequences and timelines that were made, so that what did not change is not made again."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Final

from kinegraph.clip import Clip
from kinegraph.errors import InvalidInputError
from kinegraph.validation import short_repr

MAX_PARTS_KEPT: Final = 64
MAX_BYTES_KEPT: Final = 8 * 1024 * 1024
"""Bytes of joints of all kept parts; the longest clip has 52 kB."""


class PartMemory:
    """The latest parts that were made. Bounded in number and bytes; not shared by threads.

    A part is kept under all that it depends on, the pipeline included, so what is kept equals what would be made.
    """

    def __init__(self, most: int = MAX_PARTS_KEPT, most_bytes: int = MAX_BYTES_KEPT) -> None:
        self._clips: OrderedDict[Hashable, Clip] = OrderedDict()
        self._most, self._most_bytes = most, most_bytes
        self._made: set[int] = set()
        self.bytes = 0
        """Of the joints of all kept parts."""

    @property
    def made(self) -> tuple[int, ...]:
        """The sentences of the last sequence or timeline, from 0, of which a part was made and not remembered."""
        return tuple(sorted(self._made))

    def begin(self) -> None:
        """Begin a sequence or timeline: so far nothing of it was made."""
        self._made.clear()

    def part(self, sentence: int, key: Hashable, make: Callable[[], Clip]) -> Clip:
        """Return the part of a key, made if it is not kept.

        Args:
            sentence: that it belongs to, from 0.
            key: all that the part depends on.
            make: makes it.
        """
        clip = self.get(key)
        if clip is None:
            clip = make()
            self._made.add(sentence)
            self.keep(key, clip)
        return clip

    def get(self, key: Hashable) -> Clip | None:
        """Return what is kept under a key, or None."""
        if key in self._clips:
            self._clips.move_to_end(key)
        return self._clips.get(key)

    def keep(self, key: Hashable, clip: Clip) -> None:
        """Keep a clip, in place of another of this key, and drop those that were asked for longest ago."""
        self._drop(key)
        self._clips[key] = clip
        self.bytes += clip.joints.nbytes
        while len(self._clips) > self._most or self.bytes > self._most_bytes:
            self._drop(next(iter(self._clips)))

    def _drop(self, key: Hashable) -> None:
        clip = self._clips.pop(key, None)
        if clip is not None:
            self.bytes -= clip.joints.nbytes


def check_memory(memory: object) -> PartMemory:
    """Check what a caller gives as memory.

    Raises:
        InvalidInputError: it is none.
    """
    if not isinstance(memory, PartMemory):
        raise InvalidInputError(f"memory is a PartMemory or None, not {short_repr(memory)}")
    return memory
