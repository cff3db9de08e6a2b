"""Clips of motion with their captions and labels, read from a data folder, and their mirror images.

A data folder holds, per split, `<split>.npz` (ids, offsets, joints, root_xz, scale, fps), and `captions.jsonl` and
`index.jsonl` with one line per clip. `kinegraph_training.prepare` writes such a folder from BVH files, and one with
shards in place of the .npz from published data sets (`data.shards`).
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, overload

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import FloatArray
from kinegraph.errors import InvalidInputError
from kinegraph.motion.skeleton import JOINTS, mirrored
from kinegraph_training.data.folder import STEP_METRES
from kinegraph_training.data.windows import holds_at_any_moment
from kinegraph_training.metrics import FPS

AT_ONCE: Final = "+"
IN_ORDER: Final = ">"
"""Join the labels of several actions in index.jsonl and in the names of compositions."""

SHARDS: Final = "shards"
"""Folder of the shards in a data folder (`data.shards`)."""

MIRRORED: Final = "~mirror"
"""End of the id of a mirror image."""

_NO_FRAMES: Final = np.zeros((0, JOINTS, 3), dtype=np.float32)

OPPOSITE = {"left": "right", "leftward": "rightward", "leftwards": "rightwards", "clockwise": "counterclockwise"}
OPPOSITE |= {other: word for word, other in OPPOSITE.items()}
# An underscore ends a word here, for labels such as wave_left_hand; each spelling of counterclockwise is one word.
_SIDE = re.compile(r"(?<![^\W_])(left(?:wards?)?|right(?:wards?)?|(counter[- ]?|anti[- ]?)?clockwise)(?![^\W_])", re.I)


@dataclass(frozen=True)
class MotionClip:
    """Clip of motion with its captions and labels."""

    id: str
    joints: FloatArray
    """(frames, 22, 3) metres at 20 frames per second, starting at the origin facing +Z."""
    captions: tuple[str, ...]
    """Sentences, each of all that the clip shows."""
    actions: tuple[str, ...]
    """Label of each action it shows; none where the data has no labels."""
    style: str
    in_order: bool = False
    """Whether several actions follow one another instead of happening at once."""
    steps: int | None = None
    """Number of steps taken, where the index counts them."""
    any_length: bool = False
    """Whether its length was drawn at random or cut, and so says nothing of how long its captions usually take."""
    partial_captions: tuple[str, ...] = ()
    """Sentences, each of a part of what the clip shows: one of several actions at once."""
    made_by: str = ""
    """What made it, a key of `DataConfig.draws`; "" where it was recorded."""

    @property
    def action(self) -> str:
        """Label of its action, or of all of them, joined by `AT_ONCE` or `IN_ORDER`; "" without labels."""
        return (IN_ORDER if self.in_order else AT_ONCE).join(self.actions)


def mirrored_caption(caption: str) -> str:
    """Exchange left and right in a caption; other words stay."""
    return _SIDE.sub(_opposite, caption)


def _opposite(match: re.Match[str]) -> str:
    """Return the opposite of a word that `_SIDE` matched, in the same case."""
    word = match.group()
    other = "clockwise" if match.group(2) else OPPOSITE[word.lower()]
    if word.isupper():
        return other.upper()
    return other.capitalize() if word[0].isupper() else other


def split_label(label: str) -> tuple[str, ...]:
    """Split the label of several actions; a clip without a label has none."""
    return tuple(re.split(f"[{AT_ONCE}{IN_ORDER}]", label)) if label else ()


def mirrored_label(label: str) -> str:
    """Exchange left and right in a label: `wave-left-hand` -> `wave-right-hand`."""
    return mirrored_caption(label)


def mirrored_clip(clip: MotionClip) -> MotionClip:
    """Exchange left and right in the motion, the captions and the labels."""
    return replace(
        clip,
        id=clip.id + MIRRORED,
        joints=mirrored(clip.joints),
        captions=tuple(mirrored_caption(caption) for caption in clip.captions),
        partial_captions=tuple(mirrored_caption(caption) for caption in clip.partial_captions),
        actions=tuple(mirrored_label(action) for action in clip.actions),
    )


def read_jsonl(path: Path) -> dict[str, dict[str, Any]]:
    """Read a JSON-lines file; returns its rows by their "id"."""
    if not path.is_file():
        raise InvalidInputError(f"{path} is missing; a data folder needs it (see kinegraph_training.data.clips)")
    rows = (json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.strip())
    return {row["id"]: row for row in rows}


def read_ids(folder: Path) -> Iterator[str]:
    """Yield the ids of all clips of a data folder, a line of index.jsonl at a time."""
    return (json.loads(line)["id"] for line in _lines(folder / "index.jsonl"))


def read_split(folder: Path, split: str) -> list[MotionClip]:
    """Read all clips of a split into memory, except those that index.jsonl marks as not `clean`.

    Raises:
        InvalidInputError: a file is missing, or a clip has no caption.
    """
    if is_sharded(folder):
        return list(StoredClips.of_split(folder, split))
    path = folder / f"{split}.npz"
    if not path.is_file():
        names = sorted(file.stem for file in folder.glob("*.npz"))
        raise InvalidInputError(f"{path} is missing; splits in this folder: {', '.join(names) or 'none'}")
    captions, index = read_jsonl(folder / "captions.jsonl"), read_jsonl(folder / "index.jsonl")
    clips = []
    with np.load(path, allow_pickle=False) as pack:
        packed, root, offsets = pack["joints"], pack["root_xz"], pack["offsets"]
        scale, ids = float(pack["scale"]), [str(name) for name in pack["ids"]]
        fps = float(pack["fps"]) if "fps" in pack.files else FPS
    if fps != FPS:
        raise InvalidInputError(f"{path} has {fps:g} frames a second, and training {FPS:g}; prepare it without --fps")
    for name, start, end in zip(ids, offsets[:-1], offsets[1:], strict=True):
        texts, row = captions.get(name, {}), index.get(name, {})
        if not texts.get("captions"):
            raise InvalidInputError(f"clip {name!r} of {path} has no caption in captions.jsonl")
        if row.get("clean", True) and (split != "train" or taught_captions(texts, row)):
            clips.append(clip_of_rows(name, unpack_joints(packed[start:end], root[start:end], scale), texts, row))
    return clips


def taught_captions(texts: Mapping[str, Any], row: Mapping[str, Any]) -> tuple[str, ...]:
    """Choose the captions that hold for a clip: those of a whole trial need not hold for each window of it."""
    captions = tuple(texts["captions"])
    if texts.get("scope") != "trial" or row.get("windows", 1) == 1:
        return captions
    return tuple(filter(holds_at_any_moment, captions))


def unpack_joints(packed: NDArray[np.int16], root: FloatArray, scale: float) -> FloatArray:
    """Return the joints (frames, 22, 3) in metres of 16-bit ones, relative to the pelvis on the floor (frames, 2)."""
    joints = packed.astype(np.float32) * np.float32(scale)
    joints[..., 0] += root[:, None, 0]
    joints[..., 2] += root[:, None, 1]
    return joints


def clip_of_rows(name: str, joints: FloatArray, texts: Mapping[str, Any], row: Mapping[str, Any]) -> MotionClip:
    """Make a clip of its joints (frames, 22, 3) and its rows in captions.jsonl and index.jsonl."""
    label = row.get("content", "")
    return MotionClip(
        id=name,
        joints=joints,
        captions=taught_captions(texts, row) or tuple(texts["captions"]),
        actions=split_label(label),
        style=row.get("style_canon", ""),
        in_order=IN_ORDER in label,
        steps=row.get("attr", {}).get("steps"),
        # where a recording was cut says nothing of how long its action takes
        any_length="start" in row or row.get("windows", 1) > 1,
        partial_captions=tuple(texts.get("partial_captions", ())),
    )


def is_sharded(folder: Path) -> bool:
    """Tell whether a data folder holds its motion in shards (`data.shards`) instead of a file for each split."""
    return (folder / SHARDS).is_dir()


@dataclass(frozen=True)
class StoredClips(Sequence[MotionClip]):
    """Clips of a split in shards. The motion of a clip is read from the memory-mapped shard when it is asked for.

    Nothing that was read is kept: 300 hours take the memory of their captions.
    """

    folder: Path
    rows: tuple[tuple[bytes, bytes], ...]
    """Lines of index.jsonl and captions.jsonl, by clip."""
    frames: NDArray[np.int64]
    """(clips,)."""
    mirrored: NDArray[np.bool_]
    """(clips,) whether a clip is the mirror image of the one stored."""

    @classmethod
    def of_split(cls, folder: Path, split: str, *, shortest: int = 0) -> StoredClips:
        """List the clips of a split that index.jsonl does not mark as not `clean`.

        Args:
            folder: data folder.
            split: its name.
            shortest: frames; shorter clips are left out.

        Raises:
            InvalidInputError: a file is missing, or a clip has no caption.
        """
        texts = {json.loads(line)["id"]: line for line in _lines(folder / "captions.jsonl")}
        rows, frames = [], []
        for line in _lines(folder / "index.jsonl"):
            row = json.loads(line)
            if row["split"] != split or not row.get("clean", True) or row["frames"] < shortest:
                continue
            if row["id"] not in texts:
                raise InvalidInputError(f"clip {row['id']!r} of {folder} has no caption in captions.jsonl")
            rows.append((line, texts[row["id"]]))
            frames.append(row["frames"])
        return cls(folder, tuple(rows), np.array(frames, dtype=np.int64), np.zeros(len(rows), dtype=bool))

    def select(self, indices: NDArray[np.int64]) -> StoredClips:
        """Return some of the clips, in the order of `indices`."""
        rows = tuple(self.rows[index] for index in indices)
        return StoredClips(self.folder, rows, self.frames[indices], self.mirrored[indices])

    def with_mirror_images(self) -> StoredClips:
        """Return the clips, and behind them the mirror image of each."""
        frames, mirrored_ones = np.tile(self.frames, 2), np.concatenate([self.mirrored, ~self.mirrored])
        return StoredClips(self.folder, self.rows * 2, frames, mirrored_ones)

    def __len__(self) -> int:
        return len(self.rows)

    @overload
    def __getitem__(self, index: int) -> MotionClip: ...
    @overload
    def __getitem__(self, index: slice) -> StoredClips: ...
    def __getitem__(self, index: int | slice) -> MotionClip | StoredClips:
        if isinstance(index, slice):
            return self.select(np.arange(len(self))[index])
        row, texts = (json.loads(line) for line in self.rows[index])
        span = slice(row["first"], row["first"] + row["frames"])
        shard = self.folder / SHARDS / f"{row['shard']:05d}"
        packed = np.load(f"{shard}.joints.npy", mmap_mode="r", allow_pickle=False)[span]
        root = np.load(f"{shard}.root.npy", mmap_mode="r", allow_pickle=False)[span]
        clip = clip_of_rows(row["id"], unpack_joints(packed, root, STEP_METRES), texts, row)
        return mirrored_clip(clip) if self.mirrored[index] else clip

    def without_motion(self, index: int) -> MotionClip:
        """Return a clip for its captions and labels: it has no frames, and no file is read."""
        row, texts = (json.loads(line) for line in self.rows[index])
        clip = clip_of_rows(row["id"], _NO_FRAMES, texts, row)
        return mirrored_clip(clip) if self.mirrored[index] else clip


def without_motion(clips: Sequence[MotionClip]) -> Iterator[MotionClip]:
    """Yield clips for their captions and labels; those of shards have no frames, as no motion is read."""
    if isinstance(clips, StoredClips):
        return map(clips.without_motion, range(len(clips)))
    return iter(clips)


def _lines(path: Path) -> Iterator[bytes]:
    """Yield the lines of a file that hold something."""
    if not path.is_file():
        raise InvalidInputError(f"{path} is missing; the conversion was stopped, give the same command again")
    with path.open("rb") as file:
        yield from (line for line in file if line.strip())
