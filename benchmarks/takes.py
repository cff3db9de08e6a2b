"""Clips generated for the captions of a split, kept on disk take by take so that a stopped evaluation goes on."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinegraph import MotionPipeline
from kinegraph_training.data import MotionClip

Joints = NDArray[np.float32]


def generated(
    pipe: MotionPipeline, clips: Sequence[MotionClip], take: int, folder: Path, **options: object
) -> tuple[list[Joints], list[str]]:
    """One motion per clip, for one of its captions and as long as it, and the captions used.

    Take k uses caption k modulo their number, and seed 1000 k + row. `options` go to `generate`.
    """
    captions = [clip.captions[take % len(clip.captions)] for clip in clips]
    path = folder / f"take_{take:02d}.npz"
    if path.is_file():
        with np.load(path, allow_pickle=False) as stored:
            if stored["captions"].tolist() == captions:
                return np.split(stored["joints"], stored["offsets"][1:-1]), captions
    shortest, longest = pipe.manifest.seconds_limits
    motions: list[Joints] = []
    for row, (clip, caption) in enumerate(zip(clips, captions, strict=True)):
        seconds = min(max(len(clip.joints) / pipe.manifest.fps, shortest), longest)
        motions.append(pipe.generate(caption, seconds=seconds, seed=1000 * take + row, **options).joints)  # type: ignore[arg-type]
        if sys.stderr.isatty():
            print(f"\rtake {take}: {row + 1} of {len(clips)}", end="", file=sys.stderr)
    folder.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".part")
    with partial.open("wb") as file:
        offsets = np.cumsum([0] + [len(motion) for motion in motions])
        np.savez(file, joints=np.concatenate(motions), offsets=offsets, captions=np.array(captions))
    partial.replace(path)
    return motions, captions


def folder_of(pipe: MotionPipeline, work: Path, split: str, clips: Sequence[MotionClip], options: object) -> Path:
    """A folder that belongs to this bundle's files, these clips and these options, and to nothing else."""
    parts = [spec.sha256 for _, spec in sorted(pipe.manifest.files.items())] + [clip.id for clip in clips]
    stamp = hashlib.sha256("\n".join([*parts, repr(options), repr(pipe.manifest.defaults)]).encode()).hexdigest()
    return work / f"{split}_{stamp[:12]}"
