"""Clips generated for the captions of a split, kept on disk take by take so that a stopped evaluation goes on."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
from kinegraph.arrays import FloatArray

from kinegraph import MotionPipeline
from kinegraph_training.data.clips import MotionClip

Spacing = Literal["leading", "trailing"]
GuidanceBase = Literal["empty", "coarse"]


class Model(Protocol):
    """What makes clips: a bundle (`BundleModel`), or a training run (`torch_model.TorchModel`)."""

    name: str
    stamp: str
    """Changes with the weights and the defaults."""
    fps: float
    seconds_limits: tuple[float, float]

    def generate(self, caption: str, *, seconds: float, seed: int, **options: Any) -> Any:
        """An object with `joints`."""


class BundleModel:
    """A bundle through the runtime."""

    def __init__(self, folder: Path | None, spacing: Spacing | None = None, base: GuidanceBase | None = None) -> None:
        """`spacing` and `base` replace what the bundle says of its timesteps and of what guidance leads away from."""
        pipe = MotionPipeline.load(folder)
        manifest = pipe.manifest
        manifest = pipe.manifest = replace(
            manifest,
            schedule=replace(manifest.schedule, spacing=spacing or manifest.schedule.spacing),
            defaults=replace(manifest.defaults, guidance_base=base or manifest.defaults.guidance_base),
        )
        self.name = f"{manifest.name} {manifest.version}"
        parts = [spec.sha256 for _, spec in sorted(manifest.files.items())] + [
            repr(manifest.defaults),
            manifest.schedule.spacing,
        ]
        self.stamp = hashlib.sha256("".join(parts).encode()).hexdigest()
        self.fps, self.seconds_limits = manifest.fps, manifest.seconds_limits
        self.generate = pipe.generate


def captions_of(clips: Sequence[MotionClip], take: int) -> list[str]:
    """One caption per clip: in take k the clip of row r has its caption k + r, modulo their number.

    Captions are written in kinds (the first never tells steps, degrees or heights): so every take holds all kinds, and
    as many takes as there are captions ask for each of them once.
    """
    return [clip.captions[(take + row) % len(clip.captions)] for row, clip in enumerate(clips)]


def generated(
    model: Model, clips: Sequence[MotionClip], take: int, folder: Path, **options: Any
) -> tuple[list[FloatArray], list[str]]:
    """One motion per clip, for one of its captions (`captions_of`) and as long as it, and the captions used.

    Take k uses seed 1000 k + row. `options` go to `generate`.
    """
    captions = captions_of(clips, take)
    path = folder / f"take_{take:02d}.npz"
    if path.is_file():
        with np.load(path, allow_pickle=False) as stored:
            if stored["captions"].tolist() == captions:
                return np.split(stored["joints"], stored["offsets"][1:-1]), captions
    shortest, longest = model.seconds_limits
    motions: list[FloatArray] = []
    for row, (clip, caption) in enumerate(zip(clips, captions, strict=True)):
        seconds = min(max(len(clip.joints) / model.fps, shortest), longest)
        motions.append(model.generate(caption, seconds=seconds, seed=1000 * take + row, **options).joints)
        if sys.stderr.isatty():
            print(f"\rtake {take}: {row + 1} of {len(clips)}", end="", file=sys.stderr)
    folder.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".part")
    with partial.open("wb") as file:
        offsets = np.cumsum([0] + [len(motion) for motion in motions])
        np.savez(file, joints=np.concatenate(motions), offsets=offsets, captions=np.array(captions))
    partial.replace(path)
    return motions, captions


def folder_of(model: Model, work: Path, split: str, clips: Sequence[MotionClip], options: object) -> Path:
    """A folder that belongs to this model's weights, these clips and these options, and to nothing else."""
    parts = [model.stamp, repr(options), *(clip.id for clip in clips)]
    return work / f"{split}_{hashlib.sha256(chr(10).join(parts).encode()).hexdigest()[:12]}"
