"""Captions of stretches of a recording: clips of their own, and captions of a part of longer clips.

A caption of a stretch that lies in a clip is true of the clip without saying all of it. Training marks it so
(`denoiser_batches`): "this at least".
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

from kinegraph.arrays import FloatArray
from kinegraph.limits import MAX_FRAMES, MAX_TEXT
from kinegraph.motion.skeleton import canonicalise
from kinegraph_training.data.folder import PreparedClip
from kinegraph_training.data.windows import MIN_FRAMES, cut_windows, holds_at_any_moment

WITHIN: Final = 0.8
"""Share of a stretch that must lie in a clip for its captions to be true of the clip."""
WHOLE: Final = 0.95
"""Share of a recording from which on a stretch tells of all of it."""


@dataclass(frozen=True)
class Stretch:
    """Captions of one stretch of a recording."""

    start: float
    end: float
    """Seconds; both 0 for the whole recording."""
    captions: tuple[str, ...]

    @property
    def is_whole(self) -> bool:
        """Whether it is the whole recording."""
        return self.end == 0.0

    def later(self, seconds: float) -> Stretch:
        """Return the stretch moved by some seconds, cut at 0; one before that is of no length."""
        if self.is_whole:
            return self
        return replace(self, start=max(self.start + seconds, 0.0), end=max(self.end + seconds, 1e-6))


def usable_captions(texts: Sequence[str]) -> tuple[str, ...]:
    """Return the texts that can be captions, spaces joined, each once: with words, and not longer than `MAX_TEXT`."""
    joined = (" ".join(text.split()) for text in texts)
    return tuple(dict.fromkeys(t for t in joined if len(t) <= MAX_TEXT and any(letter.isalnum() for letter in t)))


def captions_within(start: float, end: float, stretches: Sequence[Stretch], but: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the captions of the stretches that lie in a clip, without those that it has.

    Args:
        start: of the clip, seconds.
        end: of the clip, seconds.
        stretches: of its recording.
        but: captions that the clip has.
    """
    texts = (
        caption
        for stretch in stretches
        if not stretch.is_whole
        and min(end, stretch.end) - max(start, stretch.start) >= WITHIN * (stretch.end - stretch.start)
        for caption in stretch.captions
    )
    return tuple(text for text in dict.fromkeys(texts) if text not in but)


def cut_recording(
    name: str, joints: FloatArray, stretches: Sequence[Stretch], source_file: str, split: str, fps: float
) -> list[PreparedClip]:
    """Cut a recording into clips: the whole, each stretch, and windows of what is longer than `MAX_FRAMES`.

    A stretch that is nearly all of the recording gives the whole its captions. Windows keep the captions that hold at
    any moment; those without any are left out.

    Args:
        name: id of the recording; clips of a part have their times behind it.
        joints: (frames, 22, 3) metres, canonical.
        stretches: captions of the whole and of parts.
        source_file: for the index.
        split: for the index.
        fps: of `joints`.
    """
    seconds = len(joints) / fps
    telling = [each for each in stretches if each.is_whole or each.end - each.start >= WHOLE * seconds]
    parts = [each for each in stretches if each not in telling]
    whole = Stretch(0.0, 0.0, tuple(dict.fromkeys(text for each in telling for text in each.captions)))
    clips = []
    for stretch in ([whole] if whole.captions else []) + parts:
        for first, last, captions in _windows(joints, stretch, fps):
            is_all = (first, last) == (0, len(joints))
            clips.append(
                PreparedClip(
                    id=name if is_all else f"{name}@{first / fps:g}-{last / fps:g}",
                    joints=joints if is_all else canonicalise(joints[first:last]),
                    captions=captions,
                    source_file=source_file,
                    split=split,
                    start=None if is_all else first / fps,
                    partial_captions=captions_within(first / fps, last / fps, parts, captions),
                )
            )
    return _merge_same(clips)


def _windows(joints: FloatArray, stretch: Stretch, fps: float) -> Iterator[tuple[int, int, tuple[str, ...]]]:
    """Yield first frame, end and captions of the clips of one stretch."""
    first = 0 if stretch.is_whole else round(stretch.start * fps)
    last = len(joints) if stretch.is_whole else min(round(stretch.end * fps), len(joints))
    if last - first < MIN_FRAMES:
        return
    if last - first <= MAX_FRAMES:
        yield first, last, stretch.captions
        return
    held = tuple(text for text in stretch.captions if holds_at_any_moment(text))
    for start, end in cut_windows(joints[first:last]) if held else ():
        yield first + start, first + end, held


def _merge_same(clips: Sequence[PreparedClip]) -> list[PreparedClip]:
    """Join clips of the same frames: the captions of all of them describe it."""
    merged: dict[str, PreparedClip] = {}
    for clip in clips:
        other = merged.get(clip.id)
        if other is None:
            merged[clip.id] = clip
            continue
        captions = tuple(dict.fromkeys((*other.captions, *clip.captions)))
        partial = tuple(text for text in clip.partial_captions if text not in captions)
        merged[clip.id] = replace(other, captions=captions, partial_captions=partial)
    return list(merged.values())
