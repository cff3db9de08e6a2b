"""Generate clips for the captions of a split, and keep them on disk take by take so that a stopped run continues."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from kinegraph import MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph_training.data.clips import MotionClip

Spacing = Literal["leading", "trailing"]
GuidanceBase = Literal["empty", "coarse"]
MIN_FRAMES = 16
"""Frames of the shortest clip that a model can generate."""


class Model(Protocol):
    """Generator of clips: a bundle (`BundleModel`), or a training run (`torch_model.TorchModel`)."""

    name: str
    stamp: str
    """Identifies the weights and the defaults."""
    fps: float
    seconds_limits: tuple[float, float]

    def generate(self, caption: str, *, seconds: float, seed: int, **options: Any) -> Any:
        """Generate a clip.

        Returns:
            An object with `joints` (frames, 22, 3).
        """


class BundleModel:
    """A bundle sampled by the runtime.

    Args:
        folder: of the bundle, or a bundle that is loaded, whose sessions are shared; None for the default bundle.
        spacing: replaces the bundle's spacing of timesteps.
        base: replaces the condition that the bundle's guidance leads away from.
    """

    def __init__(
        self,
        folder: str | Path | MotionPipeline | None,
        spacing: Spacing | None = None,
        base: GuidanceBase | None = None,
    ) -> None:
        bundled = folder if isinstance(folder, MotionPipeline) else MotionPipeline.load(folder)
        manifest = replace(
            bundled.manifest,
            schedule=replace(bundled.manifest.schedule, spacing=spacing or bundled.manifest.schedule.spacing),
            defaults=replace(bundled.manifest.defaults, guidance_base=base or bundled.manifest.defaults.guidance_base),
        )
        encoder = bundled.encoder
        pipe = MotionPipeline(manifest, encoder.sessions, encoder.tokenizer, encoder.tables, bundled.parser)
        self.name = f"{manifest.name} {manifest.version}"
        parts = [spec.sha256 for _, spec in sorted(manifest.files.items())] + [
            repr(manifest.defaults),
            manifest.schedule.spacing,
        ]
        self.stamp = hashlib.sha256("".join(parts).encode()).hexdigest()
        self.fps, self.seconds_limits = manifest.fps, manifest.seconds_limits
        self.pipe = pipe
        self.generate = pipe.generate


def long_enough(clips: Sequence[MotionClip]) -> list[MotionClip]:
    """Select the clips that are long enough for a model to be asked for them."""
    return [clip for clip in clips if len(clip.joints) >= MIN_FRAMES]


def captions_for_take(clips: Sequence[MotionClip], take: int) -> list[str]:
    """Choose one caption per clip: in take k the clip of row r gets its caption number k + r, modulo their number.

    Captions of a clip come in a fixed order of kinds (the first never tells steps, degrees or heights). This way every
    take holds all kinds, and as many takes as a clip has captions ask for each of them once.
    """
    return [clip.captions[(take + row) % len(clip.captions)] for row, clip in enumerate(clips)]


def load_or_generate(
    model: Model, clips: Sequence[MotionClip], take: int, folder: Path, **options: Any
) -> tuple[list[FloatArray], list[str]]:
    """Read one take from its file, or generate it and write the file.

    Args:
        model: asked for one motion per clip, as long as the clip.
        clips: captured clips.
        take: number of the take; row r of take k has seed 1000 k + r and the caption of `captions_for_take`.
        folder: of the takes (`cache_folder`).
        options: keywords of `model.generate`.

    Returns:
        Joints (frames, 22, 3) of each motion, and the captions.
    """
    captions = captions_for_take(clips, take)
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


def cache_folder(model: Model, work: Path, split: str, clips: Sequence[MotionClip], options: object) -> Path:
    """Name the folder that belongs to this model's weights, these clips and these options, and to nothing else."""
    parts = [model.stamp, repr(options), *(clip.id for clip in clips)]
    return work / f"{split}_{hashlib.sha256(chr(10).join(parts).encode()).hexdigest()[:12]}"
