"""What the denoisers are trained on: clips of both splits, and their encoded captions."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from kinegraph.errors import InvalidInputError
from kinegraph_training.config import DataConfig
from kinegraph_training.data.caption_cache import CaptionGraphs, CaptionStates, encode_graphs, encode_states
from kinegraph_training.data.clips import without_motion
from kinegraph_training.dataset import Dataset, drop_long_clips, training_set, validation_set
from kinegraph_training.layouts import FeatureLayout

BATCHES_PER_EPOCH = 200


@dataclass(frozen=True)
class Splits:
    """Clips of training and of validation."""

    train: Dataset
    val: Dataset


@dataclass(frozen=True)
class EncodedCaptions:
    """Captions of all clips as the denoisers attend to them."""

    graphs: CaptionGraphs | CaptionStates
    masked: CaptionGraphs | None
    """Captions of training with their verbs masked; None for a model without a graph, or that masks none."""


def load_clips(arguments: argparse.Namespace, config: DataConfig, layout: FeatureLayout) -> Splits:
    """Load captured and synthetic clips of training, and captured ones of validation."""
    everything = training_set(arguments.data, config, arguments.held_out, arguments.more, layout=layout)
    train = drop_long_clips(everything, config.max_frames)
    dropped = len(everything.clips) - len(train.clips)
    if not train.clips:
        raise InvalidInputError(f"all clips of {arguments.data} are longer than {config.max_frames} frames; cut them")
    if dropped:
        print(f"left out: {dropped} of {len(everything.clips)} clips, longer than {config.max_frames} frames")
    return Splits(train, validation_set(arguments.data, "val", config, train.mean, train.std))


def encode_captions(
    clips: Splits, condition: str, assets: Path, run: Path, *, verb_masking: bool = True
) -> EncodedCaptions:
    """Encode all captions, or read them back from the run's caches.

    Args:
        clips: with their captions.
        condition: of `DenoiserConfig`.
        assets: folder of the text files.
        run: folder of the caches `captions.npz` and `captions_masked.npz`, or `states.npz`.
        verb_masking: encode every caption with its verbs masked too.
    """
    train, val = (
        dict.fromkeys(
            caption for clip in without_motion(split.clips) for caption in (*clip.captions, *clip.partial_captions)
        )
        for split in (clips.train, clips.val)
    )
    if condition == "tokens":
        return EncodedCaptions(encode_states(chain(train, val), assets, run / "states.npz"), None)
    graphs = encode_graphs(chain(train, val), assets, run / "captions.npz")
    if not verb_masking:
        return EncodedCaptions(graphs, None)
    return EncodedCaptions(graphs, encode_graphs(train, assets, run / "captions_masked.npz", verbs_masked=True))
