"""Clips of motion with their captions and labels, read from a data folder, and their mirror images.

A data folder holds, per split, `<split>.npz` (ids, offsets, joints, root_xz, scale, fps), and `captions.jsonl` and
`index.jsonl` with one line per clip. `kinegraph_training.prepare` writes such a folder from BVH files.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.errors import InvalidInputError
from kinegraph.motion.skeleton import HORIZONTAL, PELVIS, facing_angle, mirrored

AT_ONCE: Final = "+"
IN_ORDER: Final = ">"
"""Join the labels of several actions in index.jsonl and in the names of compositions."""

MIRRORED: Final = "~mirror"
"""End of the id of a mirror image."""

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


def start_at_origin(joints: FloatArray) -> FloatArray:
    """Move and turn a clip over the floor so that it starts at x = z = 0 and faces +Z; heights stay."""
    moved = joints - joints[0, PELVIS] * HORIZONTAL.astype(np.float32)
    heading = float(facing_angle(moved[:1])[0])
    cos, sin = np.cos(heading), np.sin(heading)
    x, y, z = moved[..., 0], moved[..., 1], moved[..., 2]
    return np.stack([cos * x - sin * z, y, sin * x + cos * z], axis=-1).astype(np.float32)


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


def read_split(folder: Path, split: str) -> list[MotionClip]:
    """Read all clips of a split, except those that index.jsonl marks as not `clean`.

    Raises:
        InvalidInputError: a file is missing, or a clip has no caption.
    """
    path = folder / f"{split}.npz"
    if not path.is_file():
        names = sorted(file.stem for file in folder.glob("*.npz"))
        raise InvalidInputError(f"{path} is missing; splits in this folder: {', '.join(names) or 'none'}")
    captions, index = read_jsonl(folder / "captions.jsonl"), read_jsonl(folder / "index.jsonl")
    clips = []
    with np.load(path, allow_pickle=False) as pack:
        packed, root, offsets = pack["joints"], pack["root_xz"], pack["offsets"]
        scale, ids = float(pack["scale"]), [str(name) for name in pack["ids"]]
    for name, start, end in zip(ids, offsets[:-1], offsets[1:], strict=True):
        if not captions.get(name, {}).get("captions"):
            raise InvalidInputError(f"clip {name!r} of {path} has no caption in captions.jsonl")
        row = index.get(name, {})
        if not row.get("clean", True):
            continue
        joints = packed[start:end].astype(np.float32) * np.float32(scale)
        joints[..., 0] += root[start:end, None, 0]
        joints[..., 2] += root[start:end, None, 1]
        label = row.get("content", "")
        clips.append(
            MotionClip(
                id=name,
                joints=joints,
                captions=tuple(captions[name]["captions"]),
                actions=split_label(label),
                style=row.get("style_canon", ""),
                in_order=IN_ORDER in label,
                steps=row.get("attr", {}).get("steps"),
                # where a recording was cut says nothing of how long its action takes
                any_length="start" in row,
            )
        )
    return clips
