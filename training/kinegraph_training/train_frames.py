"""Train the skeleton-space denoiser (EnergyMoGen, appendix A and B) on the graph encoder of a run.

    python -m kinegraph_training.train_frames --data DATA --held-out PAIRS \
        --run runs/studio --preset studio --assets ASSETS

`--run` must hold the latent denoisers and the specific autoencoder, trained or recovered from a bundle
(`kinegraph_export.recover`): their graph encoder and their normalisation are those of the bundle, and a new network
starts from the weights of the finest denoiser. The same command resumes a stopped run, and SIGTERM stops one with a
checkpoint. Further flags are those of `lightning.Trainer`.
"""

from __future__ import annotations

import signal
from pathlib import Path
from types import FrameType
from typing import Any

import lightning as L
from torch.utils.data import DataLoader

from kinegraph.bundle.contract import FRAMES, LEVELS
from kinegraph.errors import InvalidInputError
from kinegraph_training.checkpoints import read_checkpoint
from kinegraph_training.config import Preset
from kinegraph_training.data.clips import without_motion
from kinegraph_training.dataset import Dataset
from kinegraph_training.denoiser_batches import SimilarLengths
from kinegraph_training.denoiser_command import fit_denoisers, read_command
from kinegraph_training.denoiser_data import (
    BATCHES_PER_EPOCH,
    EncodedCaptions,
    Splits,
    encode_captions,
    load_clips,
)
from kinegraph_training.frame_batches import FrameBatches
from kinegraph_training.frame_module import FrameModule
from kinegraph_training.latents import read_vae
from kinegraph_training.layouts import layout_of
from kinegraph_training.models.denoiser import LatentShape
from kinegraph_training.sampling_weights import sampling_weights
from kinegraph_training.trainer import load_start_weights


class StopAtSigterm(L.Callback):
    """Callback that ends a run after the step in which SIGTERM comes, with a checkpoint as after the last step."""

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        def stop(number: int, frame: FrameType | None) -> None:
            trainer.should_stop = True

        signal.signal(signal.SIGTERM, stop)


def normalised_as(clips: Splits, checkpoint: Path) -> Splits:
    """Bring the features under the normalisation of the specific autoencoder, which the bundle has.

    Raises:
        InvalidInputError: there is no such checkpoint.
    """
    if not checkpoint.is_file():
        raise InvalidInputError(f"{checkpoint} is missing; train it, or recover a run from a bundle")
    vae = read_vae(checkpoint)

    def under(dataset: Dataset) -> Dataset:
        return dataset.under(vae.mean, vae.std)

    return Splits(under(clips.train), under(clips.val))


def make_loaders(clips: Splits, captions: EncodedCaptions, preset: Preset) -> tuple[DataLoader, DataLoader]:
    """Make batches of training, drawn at random with dropout, and of validation, in order and without."""
    train, val, size = clips.train, clips.val, preset.frames_training.batch
    weights = sampling_weights(without_motion(train.clips), preset.data)
    sampler = SimilarLengths(train.lengths, weights, size, BATCHES_PER_EPOCH)
    collate = FrameBatches(
        train, preset.frames, captions.graphs, seed=preset.seed, augment=True, masked=captions.masked
    )
    collate_val = FrameBatches(val, preset.frames, captions.graphs, seed=preset.seed, augment=False)
    train_indices: Any = range(len(train.clips))
    val_indices: Any = range(len(val.clips))
    return (
        DataLoader(train_indices, batch_sampler=sampler, collate_fn=collate),
        DataLoader(val_indices, batch_size=size, collate_fn=collate_val),
    )


def make_module(preset: Preset, run: Path, start_from: Path | None) -> FrameModule:
    """Make the network: with borrowed weights, with those of another skeleton-space denoiser, or with random ones.

    Raises:
        InvalidInputError: the run has no latent denoisers.
    """
    frames, config = preset.frames, preset.frames.denoiser(preset.denoiser)
    group = frames.frames_per_token
    shape = LatentShape(-(-config.max_frames // group), group * preset.vae[LEVELS[-1]].features)
    module = FrameModule(config, preset.frames_training, {FRAMES: shape}, frames)
    if frames.from_latent:
        latent = run / "denoisers" / "last.ckpt"
        if not latent.is_file():
            raise InvalidInputError(f"{latent} is missing; train the latent denoisers, or recover a run from a bundle")
        module.borrow_weights(read_checkpoint(latent)["state_dict"])
    if start_from:
        load_start_weights(module.hierarchy, start_from, "hierarchy.")
    return module


def main(argv: list[str] | None = None) -> None:
    """Run the command line."""
    command = read_command("train_frames", __doc__, argv)
    arguments, preset, run = command.arguments, command.preset, command.arguments.run
    module = make_module(preset, run, arguments.start_from)
    clips = load_clips(arguments, preset.data, layout_of(preset.vae[LEVELS[-1]].features))
    clips = normalised_as(clips, run / f"vae_{LEVELS[-1]}" / "last.ckpt")
    captions = encode_captions(
        clips, preset.denoiser.condition, arguments.assets, run, verb_masking=preset.data.verb_masking
    )
    batches = make_loaders(clips, captions, preset)
    fit_denoisers(command, run / FRAMES, preset.frames_training, module, batches, [StopAtSigterm()])


if __name__ == "__main__":
    main()
