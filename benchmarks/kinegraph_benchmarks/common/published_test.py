"""Test clips of HumanML3D or KIT-ML as the evaluators of Guo et al. (2022) want them: features, tagged captions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.errors import InvalidInputError
from kinegraph_training.data.humanml3d_reader import LONGEST, PublishedSet, read_names, split_line

UNIT: Final = 4
"""Frames of a movement; lengths are multiples of it."""


@dataclass(frozen=True)
class Caption:
    """A caption with its words and their parts of speech."""

    text: str
    tokens: tuple[str, ...]
    """Such as `walk/VERB`."""


@dataclass(frozen=True)
class PublishedClip:
    """A clip of the test split, or a part of one that has captions of its own."""

    name: str
    features: FloatArray
    """(frames, F), not normalised."""
    captions: tuple[Caption, ...]


def read_test_clips(
    folder: Path, data: PublishedSet, limit: int | None = None
) -> tuple[list[PublishedClip], list[str]]:
    """Read the test split from new_joint_vecs and texts.

    Args:
        folder: of the data set.
        data: which it is.
        limit: clips at most; None is all.

    Returns:
        Clips, and what is wrong with those that cannot be used.

    Raises:
        InvalidInputError: the lists are missing, or no clip can be used.
    """
    clips: list[PublishedClip] = []
    problems: list[str] = []
    names = [name for name, split in read_names(folder).items() if split == "test"]
    for name in names:
        if limit is not None and len(clips) >= limit:
            break
        try:
            clips += _read_clip(folder, data, name)
        except InvalidInputError as error:
            problems.append(str(error))
    if not clips:
        raise InvalidInputError("\n".join([f"{folder} has no test clip that can be used", *problems[:10]]))
    return clips[:limit], problems


def _read_clip(folder: Path, data: PublishedSet, name: str) -> list[PublishedClip]:
    path = folder / "new_joint_vecs" / f"{name}.npy"
    try:
        rows = np.load(path, allow_pickle=False)
        lines = (folder / "texts" / f"{name}.txt").read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError, EOFError) as error:
        raise InvalidInputError(f"{name} cannot be read: {error}") from error
    if rows.ndim != 2 or rows.shape[1] != data.features or not np.isfinite(rows).all():
        raise InvalidInputError(f"{path} has the shape {rows.shape}, or NaN; {data.name} has (frames, {data.features})")
    by_time: dict[tuple[float, float], list[Caption]] = {}
    for number, line in enumerate(lines, start=1):
        if line.strip():
            text, tokens, start, end = split_line(folder / "texts" / f"{name}.txt", number, line)
            by_time.setdefault((start, end), []).append(Caption(text, tuple(tokens.split())))
    clips = []
    for (start, end), captions in by_time.items():
        cut = rows if end == 0.0 else rows[int(start * data.fps) : int(end * data.fps)]
        if data.shortest <= len(cut) < LONGEST:
            clips.append(PublishedClip(f"{name}@{start:g}-{end:g}", cut.astype(np.float32), tuple(captions)))
    return clips


def draw_items(clips: Sequence[PublishedClip], rng: np.random.Generator) -> tuple[list[FloatArray], list[Caption]]:
    """Draw a caption and a crop of every clip, as the published loader does, also at test time.

    A length is cut to a multiple of four frames, in a third of the draws to one less; the crop lies at random.
    """
    crops, captions = [], []
    for clip in clips:
        captions.append(clip.captions[int(rng.integers(len(clip.captions)))])
        shorter = int(rng.integers(3) == 0)
        frames = max(len(clip.features) // UNIT - shorter, 1) * UNIT
        first = int(rng.integers(len(clip.features) - frames + 1))
        crops.append(clip.features[first : first + frames])
    return crops, captions
