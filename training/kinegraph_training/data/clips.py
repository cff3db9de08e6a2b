"""Motion and captions in memory.

A data folder holds, per split, `<split>.npz` (ids, offsets, joints, root_xz, scale, fps), and `captions.jsonl` and
`index.jsonl` with one line per clip; `kinegraph_training.prepare` writes the same from BVH files.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from kinegraph.arrays import FloatArray

from kinegraph.errors import InvalidInputError
from kinegraph.motion.features import features_from_joints
from kinegraph.motion.skeleton import mirrored

SWAP = {"left": "right", "leftward": "rightward", "leftwards": "rightwards", "clockwise": "counterclockwise"}
SWAP |= {other: word for word, other in SWAP.items()}
# An underscore ends a word here, for labels such as wave_left_hand; each spelling of counterclockwise is one word.
_SIDE = re.compile(r"(?<![^\W_])(left(?:wards?)?|right(?:wards?)?|(counter[- ]?|anti[- ]?)?clockwise)(?![^\W_])", re.I)


@dataclass(frozen=True)
class MotionClip:
    """One clip with what is known of it."""

    id: str
    joints: FloatArray
    """(frames, 22, 3) metres, 20 frames per second, starting at the origin facing +Z."""
    captions: tuple[str, ...]
    content: str
    """Label of the action, "" where the data has none."""
    style: str
    steps: int | None = None
    """Steps taken, where the index counts them."""
    any_length: bool = False
    """Made as long as it was drawn to be: it says nothing of how long its captions usually take."""


def mirrored_caption(caption: str) -> str:
    """The caption of the mirrored clip: left and right exchanged, other words untouched."""
    return _SIDE.sub(_other_side, caption)


def _other_side(match: re.Match[str]) -> str:
    """The opposite of a word of `_SIDE`, in its case."""
    word = match.group()
    other = "clockwise" if match.group(2) else SWAP[word.lower()]
    if word.isupper():
        return other.upper()
    return other.capitalize() if word[0].isupper() else other


def mirrored_label(label: str) -> str:
    """`wave-left-hand` -> `wave-right-hand`."""
    return mirrored_caption(label)


def mirrored_clip(clip: MotionClip) -> MotionClip:
    """Left and right exchanged in the motion, the captions and the label."""
    return replace(
        clip,
        id=f"{clip.id}~mirror",
        joints=mirrored(clip.joints),
        captions=tuple(mirrored_caption(caption) for caption in clip.captions),
        content=mirrored_label(clip.content),
    )


def read_jsonl(path: Path) -> dict[str, dict[str, Any]]:
    """Lines of a JSON-lines file by their "id"."""
    if not path.is_file():
        raise InvalidInputError(f"{path} is missing; a data folder needs it (see kinegraph_training.data.clips)")
    rows = (json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.strip())
    return {row["id"]: row for row in rows}


def read_split(folder: Path, split: str) -> list[MotionClip]:
    """All clips of one split but those that index.jsonl calls not `clean`.

    Raises:
        InvalidInputError: a file is missing, or a clip has no caption.
    """
    path = folder / f"{split}.npz"
    if not path.is_file():
        found = sorted(file.stem for file in folder.glob("*.npz"))
        raise InvalidInputError(f"{path} is missing; splits in this folder: {', '.join(found) or 'none'}")
    captions, index = read_jsonl(folder / "captions.jsonl"), read_jsonl(folder / "index.jsonl")
    clips = []
    with np.load(path, allow_pickle=False) as pack:
        joints, root, offsets = pack["joints"], pack["root_xz"], pack["offsets"]
        scale, ids = float(pack["scale"]), [str(name) for name in pack["ids"]]
    for name, start, end in zip(ids, offsets[:-1], offsets[1:], strict=True):
        if not captions.get(name, {}).get("captions"):
            raise InvalidInputError(f"clip {name!r} of {path} has no caption in captions.jsonl")
        row = index.get(name, {})
        if not row.get("clean", True):
            continue
        place = joints[start:end].astype(np.float32) * np.float32(scale)
        place[..., 0] += root[start:end, None, 0]
        place[..., 2] += root[start:end, None, 1]
        clips.append(
            MotionClip(
                id=name,
                joints=place,
                captions=tuple(captions[name]["captions"]),
                content=row.get("content", ""),
                style=row.get("style_canon", ""),
                steps=row.get("attr", {}).get("steps"),
            )
        )
    return clips


def clip_features(clips: list[MotionClip], *, min_frames: int) -> list[FloatArray]:
    """(frames, 137) of every clip long enough; shorter ones are left out by the caller beforehand."""
    short = [clip.id for clip in clips if len(clip.joints) < min_frames]
    if short:
        raise InvalidInputError(f"clips shorter than {min_frames} frames: {', '.join(short[:5])}")
    return [features_from_joints(clip.joints) for clip in clips]
