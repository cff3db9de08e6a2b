"""Data folders as `kinegraph_training.data.clips` reads them: writing one, and dividing clips into splits."""

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
    """Clip as it is stored in a data folder."""

    id: str
    """Path below the folder, without suffix, with `/`."""
    joints: FloatArray
    """(frames, 22, 3) metres."""
    captions: tuple[str, ...]
    source_file: str
    split: str
    action: str = ""
    """Label of its action, if it has one; labels of several at once are joined by `+`."""
    style: str = ""


def assign_splits(ids: Sequence[str], *, val: float, test: float) -> dict[str, str]:
    """Assign each clip to a split by a hash of its id.

    A split with a share above 0 that gets no clip takes one of `train`.

    Args:
        ids: of all clips.
        val: share of the clips for `val`.
        test: share of the clips for `test`.
    """
    fractions = {name: _hash_fraction(name) for name in ids}
    splits = {
        name: "test" if fraction < test else "val" if fraction < test + val else "train"
        for name, fraction in fractions.items()
    }
    for split, share in (("val", val), ("test", test)):
        left = sorted((name for name in ids if splits[name] == "train"), key=lambda name: fractions[name])
        if share > 0 and split not in splits.values() and len(left) > 1:
            splits[left[0]] = split
    return splits


def write_data(out: Path, clips: Sequence[PreparedClip], fps: float) -> None:
    """Write a data folder, its index last: training refuses a folder whose writing failed half-way.

    Raises:
        OutputError: the folder cannot be written.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out} cannot be made ({error.strerror}); choose another folder") from error
    for split in SPLITS:
        members = [(clip.id, clip.joints) for clip in clips if clip.split == split]
        write_atomically(out / f"{split}.npz", pack_clips(members, fps))
    captions = [{"id": clip.id, "split": clip.split, "captions": list(clip.captions)} for clip in clips]
    rate = int(fps) if fps == int(fps) else fps
    index = [
        {
            "id": clip.id,
            "frames": len(clip.joints),
            "fps": rate,
            "source_file": clip.source_file,
            "split": clip.split,
            **({"content": clip.action, "style_canon": clip.style} if clip.action else {}),
        }
        for clip in clips
    ]
    write_atomically(out / "captions.jsonl", to_json_lines(captions))
    write_atomically(out / "index.jsonl", to_json_lines(index))


def pack_clips(clips: Sequence[tuple[str, FloatArray]], fps: float) -> bytes:
    """Pack clips, given as id and joints (frames, 22, 3), into the .npz of a split."""
    joints = np.concatenate([np.zeros((0, JOINTS, 3)), *(joints.astype(np.float64) for _, joints in clips)])
    root = joints[:, PELVIS, [0, 2]].astype(np.float32)
    joints[..., [0, 2]] -= root[:, None].astype(np.float64)
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        ids=np.array([name for name, _ in clips], dtype=np.str_),
        offsets=np.cumsum([0, *(len(joints) for _, joints in clips)], dtype=np.int64),
        joints=np.round(joints / STEP_METRES).astype(np.int16),
        root_xz=root,
        scale=np.float32(STEP_METRES),
        fps=np.int32(fps) if fps == int(fps) else np.float32(fps),
    )
    return buffer.getvalue()


def to_json_lines(rows: Sequence[Mapping[str, Any]]) -> bytes:
    """Encode rows as JSON lines."""
    return "".join(json.dumps(row, ensure_ascii=False) + "\n" for row in rows).encode()


def _hash_fraction(name: str) -> float:
    """Map a name to a number in [0, 1) that depends on nothing else."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:6], "big") / 2**48
