"""Clips of one training run, captured and synthetic, as normalised features."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import FloatArray
from kinegraph.errors import InvalidInputError
from kinegraph.motion.features import normalisation
from kinegraph_training.config import DataConfig
from kinegraph_training.data.clips import MotionClip, StoredClips, is_sharded, mirrored_clip, read_split
from kinegraph_training.layouts import JOINTS_137, FeatureLayout, layout_of, measure_normalisation
from kinegraph_training.stored_features import StoredFeatures
from kinegraph_training.synthetic.caption_grammar import PHRASES, concept_caption, step_count_captions
from kinegraph_training.synthetic.compositions import HeldOut, make_sequences, make_splices
from kinegraph_training.synthetic.excerpts import (
    make_excerpts,
    make_gesture_excerpts,
    make_padded,
    select_turning_styles,
)
from kinegraph_training.synthetic.gestures import make_gestures
from kinegraph_training.synthetic.paths import make_bent
from kinegraph_training.synthetic.time_scaling import make_time_scaled, time_scaled_copies

STANDING = ("stand-still", "stand-idle")
"""Actions of people who do nothing: what stands around short actions, and under made gestures."""


class SeedStream(IntEnum):
    """Random streams of the synthetic data; each is seeded with `DataConfig.seed` plus its number."""

    SPLICES = 0
    SEQUENCES = 1
    STEP_COUNTS = 2
    TIME_SCALED_COPIES = 3
    EXCERPTS = 4
    TIME_SCALED = 5
    WORDINGS = 6
    TRIPLES = 7
    GESTURE_EXCERPTS = 8
    PADDED = 9
    BENT = 10
    GESTURES = 11


@dataclass(frozen=True)
class Dataset:
    """Clips with their group-normalised features: in memory, or in shards (`StoredClips`, `StoredFeatures`)."""

    clips: Sequence[MotionClip]
    features: Sequence[FloatArray]
    """Per clip (frames, width)."""
    mean: FloatArray
    """(width,) of the normalisation."""
    std: FloatArray
    """(width,) of the normalisation."""

    @cached_property
    def lengths(self) -> NDArray[np.int64]:
        """Rows of each clip's features, (clips,)."""
        if isinstance(self.features, StoredFeatures):
            return self.features.lengths
        return np.array([len(rows) for rows in self.features], dtype=np.int64)

    def under(self, mean: FloatArray, std: FloatArray) -> Dataset:
        """Bring the features under another normalisation, (width,) each."""
        if isinstance(self.features, StoredFeatures):
            return Dataset(self.clips, self.features.under(mean, std), mean, std)
        gain, shift = self.std / std, (self.mean - mean) / std
        return Dataset(self.clips, [rows * gain + shift for rows in self.features], mean, std)

    def select(self, indices: NDArray[np.int64]) -> Dataset:
        """Return some of the clips, in the order of `indices`."""
        if isinstance(self.clips, StoredClips) and isinstance(self.features, StoredFeatures):
            return Dataset(self.clips.select(indices), self.features.select(indices), self.mean, self.std)
        clips, features = [self.clips[i] for i in indices], [self.features[i] for i in indices]
        return Dataset(clips, features, self.mean, self.std)

    def in_memory(self) -> Dataset:
        """Return the features alone, read from where they are."""
        return Dataset([], list(self.features), self.mean, self.std)


def training_clips(
    folder: Path, config: DataConfig, held_out: Path | None, more: Sequence[Path] = ()
) -> list[MotionClip]:
    """Read the `train` split, add synthetic clips, and add the mirror image of every clip.

    Synthetic clips need action labels in index.jsonl: clips without (a user's own) are trained on as they are.

    Args:
        folder: of captured data.
        config: which synthetic clips, and how many.
        held_out: JSON file of the pairs that must not be composed.
        more: further data folders, used as they are (`kinegraph_training.compml`).

    Raises:
        InvalidInputError: compositions are asked for without `held_out`.
    """
    clips = [clip for clip in read_split(folder, "train") if len(clip.joints) >= config.min_frames]
    recorded = [clip for clip in clips if clip.actions]
    clips = add_wordings(add_step_counts(clips, config.seed + SeedStream.STEP_COUNTS), config)
    clips += synthetic_clips(recorded, config, held_out)
    for other in more:
        clips += [clip for clip in read_split(other, "train") if len(clip.joints) >= config.min_frames]
    return clips + [mirrored_clip(clip) for clip in clips]


def synthetic_clips(recorded: list[MotionClip], config: DataConfig, held_out: Path | None) -> list[MotionClip]:
    """Make all synthetic clips that a configuration asks for, of labelled recorded ones.

    Raises:
        InvalidInputError: compositions are asked for without `held_out`.
    """
    if not recorded:
        return []
    seed, longest = config.seed, config.max_frames
    standing = [clip for clip in recorded if clip.action in STANDING]
    turning = select_turning_styles(recorded)
    excerpts = make_excerpts(turning, config.excerpts, seed + SeedStream.EXCERPTS, longest)
    made = [
        *excerpts,
        *make_time_scaled(turning + excerpts, config.paces, seed + SeedStream.TIME_SCALED, longest),
        *make_gesture_excerpts(recorded, config.gesture_excerpts, seed + SeedStream.GESTURE_EXCERPTS),
        *make_padded(recorded, standing, config.padded, seed + SeedStream.PADDED, longest),
        *make_bent(recorded, standing, config.bent, seed + SeedStream.BENT),
        *make_gestures(standing, config.gestures, seed + SeedStream.GESTURES),
    ]
    if config.splices or config.triples or config.sequences:
        if held_out is None:
            raise InvalidInputError(
                "splices and sequences need --held-out FILE (pairs never to be made); or set them to 0 in [data]"
            )
        pairs = HeldOut.read(held_out)
        # Recordings have most one-handed actions on one side; both sides are composed.
        both = recorded + [mirrored_clip(clip) for clip in recorded]
        made += make_splices(both, config.splices, pairs, seed + SeedStream.SPLICES)
        made += make_splices(both, config.triples, pairs, seed + SeedStream.TRIPLES, actions=3)
        made += make_sequences(both, config.sequences, pairs, seed + SeedStream.SEQUENCES, longest)
    return [clip for clip in made if len(clip.joints) <= longest]


def add_wordings(clips: list[MotionClip], config: DataConfig) -> list[MotionClip]:
    """Add captions in the words of the action table to clips of one action."""
    rng = np.random.Generator(np.random.PCG64(config.seed + SeedStream.WORDINGS))
    return [
        replace(
            clip,
            captions=clip.captions
            + tuple(concept_caption(clip.action, clip.style, rng) for _ in range(config.wordings)),
        )
        if clip.action in PHRASES
        else clip
        for clip in clips
    ]


def add_step_counts(clips: list[MotionClip], seed: int) -> list[MotionClip]:
    """Add captions that say how many steps are taken.

    Of captured captions 1 in 60 does, and a model that seldom reads a number ignores it.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    return [
        replace(clip, captions=clip.captions + step_count_captions(clip.action, clip.steps, clip.style, rng))
        for clip in clips
    ]


def training_set(
    folder: Path,
    config: DataConfig,
    held_out: Path | None,
    more: Sequence[Path] = (),
    *,
    paced: bool = False,
    layout: FeatureLayout = JOINTS_137,
) -> Dataset:
    """Make the training clips' features under their own normalisation.

    A folder of shards is used as it is, with the mirror image of every clip, and read while training.

    Args:
        folder: see `training_clips`.
        config: see `training_clips`.
        held_out: see `training_clips`.
        more: see `training_clips`.
        paced: add a copy of every clip at a random speed (`time_scaled_copies`).
        layout: of the features.

    Raises:
        InvalidInputError: see `training_clips`; or there are no clips; or clips are to be added to shards.
    """
    if is_sharded(folder):
        if more or paced:
            raise InvalidInputError(f"{folder} is in shards, which are used as they are: leave out --more and --paced")
        stored = StoredClips.of_split(folder, "train", shortest=config.min_frames).with_mirror_images()
        if not stored:
            raise InvalidInputError(f"{folder} has no clip of {config.min_frames} frames or more in its split train")
        lazy = StoredFeatures.measured(stored, layout)
        return Dataset(stored, lazy, lazy.mean, lazy.std)
    clips = training_clips(folder, config, held_out, more)
    if not clips:
        raise InvalidInputError(f"{folder} has no clip of {config.min_frames} frames or more in its split train")
    if paced:
        clips += time_scaled_copies(clips, config, config.seed + SeedStream.TIME_SCALED_COPIES)
    features = [layout.from_joints(clip.joints) for clip in clips]
    mean, std = normalisation(features) if layout is JOINTS_137 else measure_normalisation(features, layout)
    return Dataset(clips, [(rows - mean) / std for rows in features], mean, std)


def validation_set(folder: Path, split: str, config: DataConfig, mean: FloatArray, std: FloatArray) -> Dataset:
    """Read another split's captured clips, cut to `max_frames`, under the training normalisation, (width,) each."""
    layout = layout_of(len(mean))
    if is_sharded(folder):
        stored = StoredClips.of_split(folder, split, shortest=config.min_frames)
        return Dataset(stored, StoredFeatures(stored, layout, mean, std, config.max_frames), mean, std)
    clips = [clip for clip in read_split(folder, split) if len(clip.joints) >= config.min_frames]
    features = [(layout.from_joints(clip.joints[: config.max_frames]) - mean) / std for clip in clips]
    return Dataset(clips, [np.asarray(rows, dtype=np.float32) for rows in features], mean, std)


def drop_long_clips(dataset: Dataset, max_frames: int) -> Dataset:
    """Leave out clips longer than `max_frames`.

    They cannot be cut for the denoisers, as a caption describes the whole of its clip.
    """
    return dataset.select(np.flatnonzero(dataset.lengths <= max_frames))


def cut_long_clips(dataset: Dataset, max_frames: int) -> Dataset:
    """Cut features to their first `max_frames`.

    That is enough for the evaluator: of a few hundred frames of dance, the first ten seconds tell as much as the rest.
    """
    return Dataset(dataset.clips, [rows[:max_frames] for rows in dataset.features], dataset.mean, dataset.std)
