"""Data folders as `kinegraph_training.data.clips` reads them: writing one, and dividing clips into splits."""

from __future__ import annotations

import hashlib
import io
import json
import secrets
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

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
    """Path below the folder, without suffix, with `/`; a window of a long clip has its number behind: `walk#2`."""
    joints: FloatArray
    """(frames, 22, 3) metres."""
    captions: tuple[str, ...]
    source_file: str
    split: str
    action: str = ""
    """Label of its action, if it has one; labels of several at once are joined by `+`."""
    style: str = ""
    start: float | None = None
    """Seconds from the start of the recording, for a window of a long one."""
    partial_captions: tuple[str, ...] = ()
    """Sentences, each of a part of what the clip shows."""


def assign_splits(ids: Sequence[str], *, val: float, test: float) -> dict[str, str]:
    """Assign each clip to a split by a hash of its id.

    A split with a share above 0 that gets no clip takes one of `train`, which always has one.

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
    if ids and "train" not in splits.values():
        splits[max(ids, key=lambda name: fractions[name])] = "train"
    for split, share in (("val", val), ("test", test)):
        left = sorted((name for name in ids if splits[name] == "train"), key=lambda name: fractions[name])
        if share > 0 and split not in splits.values() and len(left) > 1:
            splits[left[0]] = split
    return splits


def write_data(out: Path, clips: Sequence[PreparedClip], fps: float) -> None:
    """Write a data folder whole or not at all.

    A new folder appears under its name when it is complete. Of one that exists, the files are replaced when all the new
    ones are complete, the index last: training refuses a folder in which a power cut left none.

    Raises:
        OutputError: the folder cannot be written; it is as it was before.
    """
    files = {
        f"{split}.npz": pack_clips([(clip.id, clip.joints) for clip in clips if clip.split == split], fps)
        for split in SPLITS
    }
    files["captions.jsonl"] = to_json_lines([caption_row(clip) for clip in clips])
    files["index.jsonl"] = to_json_lines([index_row(clip, fps) for clip in clips])
    write_files(out, files)


def write_files(out: Path, files: Mapping[str, bytes]) -> None:
    """Write the files of a data folder, all or none; the last one appears last.

    Raises:
        OutputError: the folder cannot be written; it is as it was before.
    """
    # a folder that exists may be a mount point, or its parent write-protected
    stage = (out if out.is_dir() else out.parent) / f".kinegraph-{secrets.token_hex(8)}.tmp"
    try:
        try:
            stage.mkdir(parents=True)
            for name, data in files.items():
                write_atomically(stage / name, data)
            _replace(stage, out, list(files))
        finally:
            shutil.rmtree(stage, ignore_errors=True)
    except OSError as error:
        reason = getattr(error.__cause__ or error, "strerror", None) or str(error)
        raise OutputError(f"{out} cannot be written ({reason}); free some space or choose another folder") from error


def _replace(stage: Path, out: Path, names: Sequence[str]) -> None:
    """Move the files of `stage` to `out`, in which files of other names stay; after a failure all is as before."""
    if not out.exists():
        stage.rename(out)
        return
    old = out / f"{stage.stem}-old.tmp"
    old.mkdir()
    moved: list[Path] = []
    try:
        for name in reversed(names):  # the index first: the folder is incomplete until its new index is there
            if (out / name).exists():
                (out / name).rename(old / name)
        for name in names:
            (stage / name).rename(out / name)
            moved.append(out / name)
    except BaseException:
        for path in moved:
            path.unlink()
        for name in names:
            if (old / name).exists():
                (old / name).rename(out / name)
        raise
    finally:
        shutil.rmtree(old, ignore_errors=True)


def caption_row(clip: PreparedClip) -> dict[str, Any]:
    """Return the line of a clip in captions.jsonl."""
    row: dict[str, Any] = {"id": clip.id, "split": clip.split, "captions": list(clip.captions)}
    return {**row, "partial_captions": list(clip.partial_captions)} if clip.partial_captions else row


def index_row(clip: PreparedClip, fps: float) -> dict[str, Any]:
    """Return the line of a clip in index.jsonl."""
    row: dict[str, Any] = {
        "id": clip.id,
        "frames": len(clip.joints),
        "fps": int(fps) if fps == int(fps) else fps,
        "source_file": clip.source_file,
        "split": clip.split,
    }
    if clip.action:
        row |= {"content": clip.action, "style_canon": clip.style}
    return row if clip.start is None else {**row, "start": round(clip.start, 3)}


def pack_clips(clips: Sequence[tuple[str, FloatArray]], fps: float) -> bytes:
    """Pack clips, given as id and joints (frames, 22, 3), into the .npz of a split.

    Joints are 16-bit numbers, relative to the pelvis on the floor plane.
    """
    packed, roots = [np.zeros((0, JOINTS, 3), dtype=np.int16)], [np.zeros((0, 2), dtype=np.float32)]
    for _, clip in clips:
        joints, root = pack_joints(clip)
        packed.append(joints)
        roots.append(root)
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        ids=np.array([name for name, _ in clips], dtype=np.str_),
        offsets=np.cumsum([0, *(len(joints) for _, joints in clips)], dtype=np.int64),
        joints=np.concatenate(packed),
        root_xz=np.concatenate(roots),
        scale=np.float32(STEP_METRES),
        fps=np.int32(fps) if fps == int(fps) else np.float32(fps),
    )
    return buffer.getvalue()


def pack_joints(clip: FloatArray) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Pack joints (frames, 22, 3): 16-bit ones relative to the pelvis on the floor, and the pelvis (frames, 2)."""
    joints = clip.astype(np.float64)
    root = joints[:, PELVIS, [0, 2]].astype(np.float32)
    joints[..., [0, 2]] -= root[:, None].astype(np.float64)
    return np.round(joints / STEP_METRES).astype(np.int16), root


def to_json_lines(rows: Sequence[Mapping[str, Any]]) -> bytes:
    return "".join(json.dumps(row, ensure_ascii=False) + "\n" for row in rows).encode()


def _hash_fraction(name: str) -> float:
    """Map a name to a number in [0, 1) that depends on nothing else."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:6], "big") / 2**48
