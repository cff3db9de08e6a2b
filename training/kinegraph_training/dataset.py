"""The clips of one training run: recorded, made and mirrored, as features with their normalisation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.errors import InvalidInputError
from kinegraph.motion.features import features_from_joints, normalisation
from kinegraph_training.config import DataConfig
from kinegraph_training.data.clips import MotionClip, mirrored_clip, read_split
from kinegraph_training.synthetic.caption_grammar import counted_captions
from kinegraph_training.synthetic.compositions import HeldOut, make_sequences, make_splices
from kinegraph_training.synthetic.excerpts import in_manners_that_turn, make_excerpts
from kinegraph_training.synthetic.time_scaling import make_paces, paced_clips


@dataclass(frozen=True)
class Dataset:
    """Clips with group-normalised features of the same order."""

    clips: list[MotionClip]
    features: list[FloatArray]
    mean: FloatArray
    std: FloatArray

    def under(self, mean: FloatArray, std: FloatArray) -> Dataset:
        """The same under another normalisation, (137,) each."""
        gain, shift = self.std / std, (self.mean - mean) / std
        return Dataset(self.clips, [rows * gain + shift for rows in self.features], mean, std)


def training_clips(
    folder: Path, config: DataConfig, held_out: Path | None, more: Sequence[Path] = ()
) -> list[MotionClip]:
    """Recorded clips of the `train` split and made compositions, each also mirrored.

    Compositions need the action's label in index.jsonl: clips without one (a user's own) are trained on as they are,
    and so are those of the folders in `more` (`kinegraph_training.compml`).

    Raises:
        InvalidInputError: compositions are asked for without the list of pairs to hold out.
    """
    clips = [clip for clip in read_split(folder, "train") if len(clip.joints) >= config.min_frames]
    labelled = [clip for clip in clips if clip.content]
    if labelled and (config.splices or config.sequences):
        if held_out is None:
            raise InvalidInputError(
                "splices and sequences need --held-out FILE (pairs never to be made); or set both to 0 in [data]"
            )
        held = HeldOut.read(held_out)
        made = make_splices(labelled, config.splices, held, config.seed)
        made += make_sequences(labelled, config.sequences, held, config.seed + 1, config.max_frames)
        clips = with_counted_steps(clips, config.seed + 2) + made
    turning = in_manners_that_turn(labelled)
    excerpts = make_excerpts(turning, config.excerpts, config.seed + 4, config.max_frames)
    clips += excerpts + make_paces(turning + excerpts, config.paces, config.seed + 5, config.max_frames)
    clips += [clip for own in more for clip in read_split(own, "train") if len(clip.joints) >= config.min_frames]
    return clips + [mirrored_clip(clip) for clip in clips]


def with_counted_steps(clips: list[MotionClip], seed: int) -> list[MotionClip]:
    """More captions that say how many steps are taken: of recorded captions, 1 in 60 does, and a model that seldom
    reads a number ignores it."""
    rng = np.random.Generator(np.random.PCG64(seed))
    return [
        replace(clip, captions=clip.captions + counted_captions(clip.content, clip.steps, clip.style, rng))
        for clip in clips
    ]


def training_set(
    folder: Path, config: DataConfig, held_out: Path | None, more: Sequence[Path] = (), *, paced: bool = False
) -> Dataset:
    """The training clips, `paced` ones with them if asked for, under their own normalisation."""
    clips = training_clips(folder, config, held_out, more)
    if paced:
        clips += paced_clips(clips, config, config.seed + 3)
    features = [features_from_joints(clip.joints) for clip in clips]
    mean, std = normalisation(features)
    return Dataset(clips, [(rows - mean) / std for rows in features], mean, std)


def validation_set(folder: Path, split: str, config: DataConfig, mean: FloatArray, std: FloatArray) -> Dataset:
    """Recorded clips of another split, cut to the longest clip a model takes, under the training normalisation."""
    clips = [clip for clip in read_split(folder, split) if len(clip.joints) >= config.min_frames]
    features = [(features_from_joints(clip.joints[: config.max_frames]) - mean) / std for clip in clips]
    return Dataset(clips, [np.asarray(rows, dtype=np.float32) for rows in features], mean, std)


def limit_length(dataset: Dataset, max_frames: int) -> Dataset:
    """Clips whose caption describes all that a latent may hold: longer ones are left out, not cut."""
    keep = [i for i, rows in enumerate(dataset.features) if len(rows) <= max_frames]
    clips, features = [dataset.clips[i] for i in keep], [dataset.features[i] for i in keep]
    return Dataset(clips, features, dataset.mean, dataset.std)
