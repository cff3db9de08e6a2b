"""Data folders: what `kinegraph_training.data.clips` reads, and which split a clip belongs to."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from kinegraph.arrays import FloatArray

from kinegraph.errors import OutputError
from kinegraph.files import write_atomically
from kinegraph.motion.skeleton import JOINTS, PELVIS

SPLITS: Final = ("train", "val", "test")

STEP_METRES: Final = 0.0001
"""Joints are stored as 16-bit multiples of this."""


@dataclass(frozen=True)
class PreparedClip:
    """One clip as it is stored."""

    id: str
    """Path below the folder, without suffix, with `/`."""
    joints: FloatArray
    """(frames, 22, 3) metres."""
    captions: tuple[str, ...]
    source_file: str
    split: str
    content: str = ""
    """Label of the action, where it has one: two of them joined by `+` for a composition."""
    style: str = ""


def split_of(ids: Sequence[str], *, val: float, test: float) -> dict[str, str]:
    """Split of each clip by a hash of its id. A split that was asked for and got none takes one clip of
    `train`."""
    place = {each: _hash(each) for each in ids}
    splits = {
        each: "test" if share < test else "val" if share < test + val else "train" for each, share in place.items()
    }
    for split, share in (("val", val), ("test", test)):
        left = sorted((each for each in ids if splits[each] == "train"), key=lambda each: place[each])
        if share > 0 and split not in splits.values() and len(left) > 1:
            splits[left[0]] = split
    return splits


def write_data(out: Path, clips: Sequence[PreparedClip], fps: float) -> None:
    """The split files first: a folder whose writing failed lacks the index, and no training starts on it."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out} cannot be made ({error.strerror}); choose another folder") from error
    for split in SPLITS:
        chosen = [clip for clip in clips if clip.split == split]
        write_atomically(out / f"{split}.npz", _pack(chosen, fps))
    captions = [{"id": clip.id, "split": clip.split, "captions": list(clip.captions)} for clip in clips]
    rate = int(fps) if fps == int(fps) else fps
    index = [
        {
            "id": each.id,
            "frames": len(each.joints),
            "fps": rate,
            "source_file": each.source_file,
            "split": each.split,
            **({"content": each.content, "style_canon": each.style} if each.content else {}),
        }
        for each in clips
    ]
    write_atomically(out / "captions.jsonl", _lines(captions))
    write_atomically(out / "index.jsonl", _lines(index))


def _pack(clips: Sequence[PreparedClip], fps: float) -> bytes:
    joints = np.concatenate([np.zeros((0, JOINTS, 3)), *(clip.joints.astype(np.float64) for clip in clips)])
    root = joints[:, PELVIS, [0, 2]].astype(np.float32)
    joints[..., [0, 2]] -= root[:, None].astype(np.float64)
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        ids=np.array([clip.id for clip in clips], dtype=np.str_),
        offsets=np.cumsum([0, *(len(clip.joints) for clip in clips)], dtype=np.int64),
        joints=np.round(joints / STEP_METRES).astype(np.int16),
        root_xz=root,
        scale=np.float32(STEP_METRES),
        fps=np.int32(fps) if fps == int(fps) else np.float32(fps),
    )
    return buffer.getvalue()


def _lines(rows: Sequence[Mapping[str, Any]]) -> bytes:
    return "".join(json.dumps(row, ensure_ascii=False) + "\n" for row in rows).encode()


def _hash(name: str) -> float:
    """A number in [0, 1) that depends on the name alone."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:6], "big") / 2**48
