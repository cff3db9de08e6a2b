"""Read HumanML3D and KIT-ML from their folders, as Guo et al. (2022) publish them.

    new_joints/NAME.npy        (frames, joints, 3)
    new_joint_vecs/NAME.npy    (frames, 263 or 251), used where there are no joints
    texts/NAME.txt             a line for each caption: sentence # words with their tags # from # to, in seconds
    train.txt, val.txt, test.txt

A line whose times are not 0 tells of a part of the clip; the part becomes a clip of its own, with the captions of the
same times; those of parts that lie in a clip are its partial captions. HumanML3D is in metres with our 22 joints at 20
frames per second. KIT-ML has 21 joints in units of its own at 12.5; it is scaled to the leg of our common body, mapped
to our joints and resampled.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.errors import InvalidInputError
from kinegraph.limits import MAX_TEXT
from kinegraph.motion import kit_ml
from kinegraph.motion.humanml3d import joints_from_humanml3d
from kinegraph.motion.kit_ml import KIT_JOINTS, from_kit_joints
from kinegraph.motion.resampling import resample
from kinegraph.motion.skeleton import JOINTS, canonicalise
from kinegraph_training.data.folder import SPLITS, PreparedClip
from kinegraph_training.data.timeline import Stretch, captions_within

FPS: Final = 20.0
"""Of prepared clips."""
LONGEST: Final = 200
"""Frames; the published code leaves out clips of so many and more, of both sets: 10 s of HumanML3D, 16 of KIT-ML."""


@dataclass(frozen=True)
class PublishedSet:
    """A data set of Guo et al."""

    name: str
    option: str
    """Of the command line."""
    features: int
    joints: int
    fps: float
    shortest: int
    """Frames; shorter clips are left out, as in the published code."""
    to_ours: Callable[[FloatArray], FloatArray]
    """(frames, joints, 3) -> (frames, 22, 3) metres at `FPS`."""


def from_kit(joints: FloatArray) -> FloatArray:
    """Map joints of KIT-ML (frames, 21, 3) to ours (frames, 22, 3) in metres at `FPS`."""
    return resample(from_kit_joints(joints), KIT.fps, FPS)


HUMANML3D: Final = PublishedSet("HumanML3D", "--humanml3d", 263, JOINTS, FPS, 40, lambda joints: joints)
KIT: Final = PublishedSet("KIT-ML", "--kit", kit_ml.WIDTH, KIT_JOINTS, kit_ml.FPS, 24, from_kit)
SETS: Final[dict[str, PublishedSet]] = {data.option: data for data in (HUMANML3D, KIT)}
"""Option of the command line -> data set."""


def read_names(folder: Path) -> dict[str, str]:
    """Read the lists of clips.

    Returns:
        Split by name, of `folder.SPLITS`.

    Raises:
        InvalidInputError: a list is missing or empty, or a name is in two of them.
    """
    splits: dict[str, str] = {}
    for split in SPLITS:
        path = folder / f"{split}.txt"
        try:
            names = path.read_text(encoding="utf-8").split()
        except (OSError, UnicodeDecodeError) as error:
            raise InvalidInputError(
                f"{path} cannot be read: {error}; the published folder has train.txt, val.txt and test.txt"
            ) from error
        if not names:
            raise InvalidInputError(f"{path} names no clip")
        twice = sorted(splits.keys() & set(names))
        if twice:
            raise InvalidInputError(f"{path}: {twice[0]} is in {splits[twice[0]]}.txt too; a clip has one split")
        splits |= dict.fromkeys(names, split)
    return splits


def read_stretches(path: Path) -> list[Stretch]:
    """Read the captions of a clip, those of the same times together.

    Raises:
        InvalidInputError: no file, or a line that breaks the format.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInputError(f"{path} cannot be read: {error}") from error
    captions: dict[tuple[float, float], list[str]] = {}
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        caption, _, start, end = split_line(path, number, line)
        captions.setdefault((start, end), []).append(caption)
    if not captions:
        raise InvalidInputError(f"{path} holds no captions")
    return [Stretch(*times, tuple(dict.fromkeys(texts))) for times, texts in captions.items()]


def split_line(path: Path, number: int, line: str) -> tuple[str, str, float, float]:
    """Split a line of a file of texts; returns caption, tagged words, and start and end in seconds, 0 for the whole.

    Raises:
        InvalidInputError: the line breaks the format; the message names it.
    """
    fields = line.split("#")
    if len(fields) != 4:
        raise InvalidInputError(f"{path}, line {number}: {len(fields) - 1} '#' instead of 3")
    caption = " ".join(fields[0].split())
    if not any(letter.isalnum() for letter in caption) or len(caption) > MAX_TEXT:
        raise InvalidInputError(f"{path}, line {number}: a caption has words, and {MAX_TEXT} characters at most")
    try:
        # the published files write nan for the whole clip
        start, end = (0.0 if math.isnan(value := float(field)) else value for field in fields[2:])
    except ValueError as error:
        raise InvalidInputError(f"{path}, line {number}: {error}") from error
    if (start, end) != (0.0, 0.0) and not 0.0 <= start < end < math.inf:
        raise InvalidInputError(f"{path}, line {number}: it tells of {start:g} to {end:g} seconds")
    return caption, fields[1], start, end


def read_motion(folder: Path, name: str, data: PublishedSet) -> FloatArray:
    """Read the joints of a clip, (frames, joints, 3) in the units of the data set.

    Raises:
        InvalidInputError: no file, another layout, or numbers that are not finite.
    """
    joints, vectors = folder / "new_joints" / f"{name}.npy", folder / "new_joint_vecs" / f"{name}.npy"
    path = joints if joints.is_file() else vectors
    try:
        array = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise InvalidInputError(f"{path} cannot be read: {error}") from error
    shape = (data.joints, 3) if path == joints else (data.features,)
    if not isinstance(array, np.ndarray) or array.ndim != 1 + len(shape) or array.shape[1:] != shape:
        raise InvalidInputError(
            f"{path} has the shape {getattr(array, 'shape', None)}; {data.name} has (frames, "
            f"{', '.join(map(str, shape))})"
        )
    if not np.isfinite(array).all():
        raise InvalidInputError(f"{path} holds NaN or infinity, as some files of the published data do")
    array = array.astype(np.float32)
    return array if path == joints else joints_from_humanml3d(array, data.joints)


def find_clips(folder: Path, data: PublishedSet) -> list[tuple[str, str]]:
    """List the clips of a data set, as name and split.

    Raises:
        InvalidInputError: no folder, or lists are missing.
    """
    if not folder.is_dir():
        raise InvalidInputError(f"{folder} is no folder; {data.option} names that of {data.name}")
    return list(read_names(folder).items())


def read_clips(folder: Path, option: str, clip: tuple[str, str]) -> list[PreparedClip]:
    """Read a clip and the parts of it that have captions of their own; those of unusual length are left out.

    Args:
        folder: of the data set.
        option: key of `SETS`.
        clip: name and split.

    Raises:
        InvalidInputError: see `read_motion` and `read_stretches`.
    """
    data, (name, split) = SETS[option], clip
    stretches = read_stretches(folder / "texts" / f"{name}.txt")
    motion = read_motion(folder, name, data)
    clips = []
    for stretch in stretches:
        first = int(stretch.start * data.fps)
        last = len(motion) if stretch.is_whole else min(int(stretch.end * data.fps), len(motion))
        if not data.shortest <= last - first < LONGEST:
            continue
        clips.append(
            PreparedClip(
                id=name if stretch.is_whole else f"{name}@{stretch.start:g}-{stretch.end:g}",
                joints=canonicalise(data.to_ours(motion[first:last])),
                captions=stretch.captions,
                source_file=f"new_joints/{name}.npy",
                split=split,
                partial_captions=captions_within(first / data.fps, last / data.fps, stretches, stretch.captions),
            )
        )
    return clips
