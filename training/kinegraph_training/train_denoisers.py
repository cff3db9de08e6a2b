"""Train the graph encoder and the three denoisers together (GraphMotion, Eq. 6), on frozen autoencoders.

    python -m kinegraph_training.train_denoisers --data DATA/bandai --held-out DATA/held_out_pairs.json \
        --run runs/edge --preset edge --assets assets

`--run` must hold the three autoencoders, `--assets` the text files (`python -m kinegraph_export.text_assets`). The same
command resumes a stopped run. Further flags are those of `lightning.Trainer`: `--devices 2 --strategy ddp`,
`--num-nodes 2`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch.utils.data import DataLoader

from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import LEVELS
from kinegraph.bundle.tables import BONE_LENGTHS, DURATION
from kinegraph.errors import InvalidInputError
from kinegraph_training.bundle_tables import common_bone_lengths, fit_duration, write_tables
from kinegraph_training.config import Preset
from kinegraph_training.data.caption_cache import CaptionGraphs, CaptionStates
from kinegraph_training.data.clips import read_ids, without_motion
from kinegraph_training.data.shown_captions import write_shown_captions
from kinegraph_training.dataset import Dataset
from kinegraph_training.denoiser_batches import DenoiserBatches, SimilarLengths, caption_sizes
from kinegraph_training.denoiser_command import fit_denoisers, read_command
from kinegraph_training.denoiser_data import (
    BATCHES_PER_EPOCH,
    EncodedCaptions,
    Splits,
    encode_captions,
    load_clips,
)
from kinegraph_training.denoiser_module import DenoiserModule
from kinegraph_training.latents import Latents, encode_clips, encode_levels, read_vae
from kinegraph_training.layouts import layout_of
from kinegraph_training.losses import SpectralMotionLoss
from kinegraph_training.models.denoiser import LatentShape
from kinegraph_training.sampling_weights import sampling_weights
from kinegraph_training.trainer import load_start_weights


@dataclass(frozen=True)
class EncodedClips:
    """Latents of all clips, by level."""

    train: dict[str, Latents]
    val: dict[str, Latents]
    """Under the standardisation of training."""


def measure_tables(train: Dataset, graphs: CaptionGraphs | CaptionStates) -> dict[str, FloatArray]:
    """Measure the tables of the bundle on the clips of training: the duration model, and the length of the bones."""
    tables = {}
    if isinstance(graphs, CaptionGraphs):
        has_usual = any(not clip.any_length for clip in train.clips)
        tables[DURATION] = fit_duration(
            (graphs.get(caption), len(clip.joints))
            for clip in train.clips
            if not (has_usual and clip.any_length)
            for caption in clip.captions
        )
    lengths = common_bone_lengths(clip.joints for clip in train.clips)
    return tables if lengths is None else {**tables, BONE_LENGTHS: lengths}


def write_bundle_tables(run: Path, train: Dataset, captions: EncodedCaptions) -> None:
    """Measure the tables of the bundle and write them into the run."""
    write_tables(run, measure_tables(train, captions.graphs))


def encode_latents(clips: Splits, levels: Sequence[str], run: Path) -> EncodedClips:
    """Encode all clips at some levels; latents of training are cached in the run."""
    every_level = encode_levels(run, clips.train, run / "latents.pt")
    train = {level: every_level[level] for level in levels}
    val = {}
    for level, latents in train.items():
        posterior = encode_clips(read_vae(run / f"vae_{level}" / "last.ckpt"), clips.val)
        val[level] = Latents(*posterior, latents.centre, latents.scale)
    return EncodedClips(train, val)


def make_loaders(
    clips: Splits, captions: EncodedCaptions, latents: EncodedClips, preset: Preset
) -> tuple[DataLoader, DataLoader]:
    """Make batches of training, drawn at random with dropout, and of validation, in order and without."""
    train, val, graphs = clips.train, clips.val, captions.graphs
    size = preset.denoiser_training.batch
    weights = sampling_weights(without_motion(train.clips), preset.data)
    sizes = caption_sizes(without_motion(train.clips), graphs)
    sampler = SimilarLengths(sizes, weights, size, BATCHES_PER_EPOCH)
    composed = preset.data.composed
    if composed and preset.denoiser.kind == "concat":
        raise InvalidInputError("kind concat cannot compose inside a layer (EnergyMoGen, Eq. 9): set composed to 0")
    collate = DenoiserBatches(
        train, latents.train, graphs, seed=preset.seed, augment=True, masked=captions.masked, composed=composed
    )
    collate_val = DenoiserBatches(val, latents.val, graphs, seed=preset.seed, augment=False)
    train_indices: Any = range(len(train.clips))
    val_indices: Any = range(len(val.clips))
    return (
        DataLoader(train_indices, batch_sampler=sampler, collate_fn=collate),
        DataLoader(val_indices, batch_size=size, collate_fn=collate_val),
    )


def make_spectral_loss(run: Path, latents: Latents) -> SpectralMotionLoss:
    """Make the spectral loss of the finest level with its frozen autoencoder."""
    autoencoder = read_vae(run / f"vae_{LEVELS[-1]}" / "last.ckpt")
    autoencoder.vae.requires_grad_(False)
    return SpectralMotionLoss(autoencoder, latents.centre, latents.scale)


def add_own_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the latent denoisers alone take."""
    parser.add_argument(
        "--keep-graph-encoder",
        action="store_true",
        help="with --start-from: leave the graph encoder as it is, for a skeleton-space network trained over it",
    )


def main(argv: list[str] | None = None) -> None:
    """Run the command line."""
    command = read_command("train_denoisers", __doc__, argv, add_own_arguments)
    arguments, preset, run = command.arguments, command.preset, command.arguments.run
    if arguments.keep_graph_encoder and not arguments.start_from:
        raise InvalidInputError("--keep-graph-encoder needs --start-from: an untrained encoder is not worth keeping")
    config = preset.denoiser_training
    clips = load_clips(arguments, preset.data, layout_of(preset.vae[LEVELS[-1]].features))
    captions = encode_captions(
        clips, preset.denoiser.condition, arguments.assets, run, verb_masking=preset.data.verb_masking
    )
    write_bundle_tables(run, clips.train, captions)
    write_shown_captions(run, without_motion(clips.train.clips), recorded=read_ids(arguments.data))
    latents = encode_latents(clips, preset.denoiser.levels, run)
    batches = make_loaders(clips, captions, latents, preset)

    shapes = {level: LatentShape(*posterior.centre.shape) for level, posterior in latents.train.items()}
    statistics = {level: (posterior.centre, posterior.scale) for level, posterior in latents.train.items()}
    spectral_loss = make_spectral_loss(run, latents.train[LEVELS[-1]])
    module = DenoiserModule(preset.denoiser, config, shapes, statistics, spectral_loss)
    if arguments.start_from:
        load_start_weights(module.hierarchy, arguments.start_from, "hierarchy.")
    if arguments.keep_graph_encoder:
        module.hierarchy.graph_encoder.requires_grad_(False)
    fit_denoisers(command, run / "denoisers", config, module, batches)


if __name__ == "__main__":
    main()
