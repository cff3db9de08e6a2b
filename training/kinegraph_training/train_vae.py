"""Train the autoencoder of one level.

    python -m kinegraph_training.train_vae --level specific --data DATA/bandai --held-out DATA/held_out_pairs.json \
        --run runs/edge --preset edge

The same command resumes a stopped run. Further flags are those of `lightning.Trainer`: `--devices 2 --strategy ddp`,
`--num-nodes 2`.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader

from kinegraph.bundle.contract import LEVELS
from kinegraph.errors import InvalidInputError
from kinegraph_training.checkpoints import fit
from kinegraph_training.config import OptimiserConfig, Preset, read_preset
from kinegraph_training.data.clips import without_motion
from kinegraph_training.dataset import Dataset, training_set, validation_set
from kinegraph_training.layouts import layout_of
from kinegraph_training.losses import (
    PATH_WINDOWS,
    SPECTRUM_WINDOWS,
    ReconstructionWeights,
    kl_divergence,
    path_loss,
    reconstruction_terms,
)
from kinegraph_training.metrics import reconstruction_scores
from kinegraph_training.models.vae import ENCODER_PARTS, MotionVae, VaeConfig
from kinegraph_training.sampling_weights import sampling_weights
from kinegraph_training.trainer import (
    add_common_arguments,
    configure_optimiser,
    lightning_flags,
    load_start_weights,
    make_trainer,
)
from kinegraph_training.vae_batches import FrameBudgetSampler, pad_clips, random_crop

PATH_WEIGHT = 0.1
"""Weight of `path_loss`, which is added in the last third of a run, once poses are learnt."""

MOTION_TERMS = frozenset(
    (
        *("bones", "velocities", "accelerations", "feet"),
        *(f"window_{size}" for size in PATH_WINDOWS),
        *(f"spectra_{size}" for size in SPECTRUM_WINDOWS),
    )
)
"""Terms that `motion_ramp` holds back at first. While poses are still wrong, a body that stands still has the smallest
velocity error, and a run that starts with these terms never leaves that solution (82 mm after 1,000 steps)."""


def motion_ramp(step: int, steps: int) -> float:
    """Compute the weight of MOTION_TERMS in a run from random weights: 0 up to 10 % of its steps, 1 from 40 % on."""
    return min(1.0, max(0.0, (step / steps - 0.1) / 0.3))


class VaeModule(L.LightningModule):
    """Autoencoder with its normalisation and its loss."""

    def __init__(self, config: VaeConfig, training: OptimiserConfig, mean: list[float], std: list[float]) -> None:
        super().__init__()
        self.save_hyperparameters({"config": vars(config), "training": vars(training)})
        self.vae = MotionVae(config)
        self.training_config = training
        self.weights = ReconstructionWeights()
        self.pretrained = False
        """Whether the run started from trained weights: MOTION_TERMS then count from the first step."""
        self.register_buffer("mean", torch.tensor(mean))
        self.register_buffer("std", torch.tensor(std))

    def start_from(self, checkpoint: Path) -> None:
        """Load the weights and the normalisation of another run's checkpoint; the schedule stays this run's own.

        The clips have to be brought under the loaded normalisation too (`Dataset.under`).

        Raises:
            InvalidInputError: no such file, or weights of another shape.
        """
        load_start_weights(self, checkpoint, "")
        self.pretrained = True

    def freeze_encoder(self) -> None:
        """Train the decoder alone, so that latents, and denoisers trained on them, stay valid."""
        for name, parameter in self.vae.named_parameters():
            parameter.requires_grad_(name.split(".")[0] not in ENCODER_PARTS)

    def training_step(self, batch: tuple[Tensor, Tensor], index: int) -> Tensor:
        features, mask = batch
        mean, log_variance = self.vae.encode(features, mask)
        # Reparameterisation: z = mu + sigma eps
        latent = mean + torch.randn_like(mean) * torch.exp(0.5 * log_variance)
        decoded = self.vae.decode(latent, mask)
        with torch.autocast(self.device.type, enabled=False):
            ramp = 1.0 if self.pretrained else motion_ramp(self.global_step, self.training_config.steps)
            terms = reconstruction_terms(decoded.float(), features, mask, self.std, self.mean, self.weights)
            terms = {name: value * ramp if name in MOTION_TERMS else value for name, value in terms.items()}
            terms["kl"] = self.weights.kl * kl_divergence(mean.float(), log_variance.float())
            if self.global_step > 2 * self.training_config.steps // 3:
                terms["path"] = PATH_WEIGHT * path_loss(decoded.float(), features, mask, self.std, self.mean)
        loss = torch.stack(list(terms.values())).sum()
        self.log_dict({f"train/{name}": value for name, value in terms.items()}, batch_size=len(mask))
        self.log("loss", loss, prog_bar=True, logger=False, batch_size=len(mask))
        return loss

    def validation_step(self, batch: tuple[Tensor, Tensor], index: int) -> None:
        features, mask = batch
        decoded = self.vae.decode(self.vae.encode(features, mask)[0], mask).float()
        for predicted, target, row in zip(decoded, features, mask, strict=True):
            frames = int(row.sum())
            raw = [(clip[:frames] * self.std + self.mean).float().cpu().numpy() for clip in (predicted, target)]
            scores = reconstruction_scores(*raw)
            self.log_dict(
                {f"val/{name}": value for name, value in scores.items()}, on_epoch=True, batch_size=1, on_step=False
            )
            self.log("local_mm", scores["local_mm"], prog_bar=True, logger=False, on_epoch=True, batch_size=1)

    def configure_optimizers(self) -> Any:
        return configure_optimiser(self.vae, self.training_config, str(self.trainer.precision))


def make_loaders(train: Dataset, val: Dataset, preset: Preset, level: str) -> tuple[DataLoader, DataLoader]:
    """Make batches of training, with random crops, and of validation.

    There are no worker processes: the clips are in memory or in the cache of the file system, and a batch is built in
    less time than a process switch.
    """
    data, patch = preset.data, preset.vae[level].frames_per_token
    rng = np.random.Generator(np.random.PCG64(preset.seed))
    multiple = 2 * patch

    def collate(indices: list[int]) -> tuple[Tensor, Tensor]:
        clips = [train.features[i] for i in indices]
        limits = {"min_frames": data.min_frames, "max_frames": data.max_frames}
        return pad_clips([random_crop(clip, rng, **limits) for clip in clips], multiple)

    lengths = np.minimum(train.lengths, data.max_frames).tolist()
    budget = preset.vae_training[level].batch
    weights = sampling_weights(without_motion(train.clips), data) if data.weighted_vae else None
    sampler = FrameBudgetSampler(lengths, budget, preset.seed, weights)
    val_sampler = FrameBudgetSampler(val.lengths.tolist(), 4 * budget, preset.seed)
    train_indices: Any = range(len(train.features))
    val_indices: Any = range(len(val.features))
    return (
        DataLoader(train_indices, batch_sampler=sampler, collate_fn=collate),
        DataLoader(
            val_indices,
            batch_sampler=val_sampler,
            collate_fn=lambda indices: pad_clips([val.features[i] for i in indices], multiple),
        ),
    )


def main(argv: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="kinegraph_training.train_vae", description=__doc__.split("\n")[0])
    parser.add_argument("--level", choices=LEVELS, required=True)
    parser.add_argument("--decoder-only", action="store_true", help="with --start-from: leave the encoder as it is")
    parser.add_argument("--paced", action="store_true", help="train on every clip at a second speed too")
    add_common_arguments(parser)
    arguments, lightning = parser.parse_known_args(argv)
    if arguments.decoder_only and not arguments.start_from:
        raise InvalidInputError("--decoder-only needs --start-from: an untrained encoder is not worth keeping")
    preset = read_preset(arguments.preset)
    if arguments.threads:
        torch.set_num_threads(arguments.threads)
    L.seed_everything(preset.seed)
    config = preset.vae_training[arguments.level]
    layout = layout_of(preset.vae[arguments.level].features)
    train = training_set(
        arguments.data, preset.data, arguments.held_out, arguments.more, paced=arguments.paced, layout=layout
    )
    module = VaeModule(preset.vae[arguments.level], config, train.mean.tolist(), train.std.tolist())
    if arguments.start_from:
        module.start_from(arguments.start_from)
        train = train.under(module.mean.numpy(), module.std.numpy())
    val = validation_set(arguments.data, "val", preset.data, train.mean, train.std)
    if arguments.decoder_only:
        module.freeze_encoder()
    run = arguments.run / f"vae_{arguments.level}"
    trainer = make_trainer(run, config, validate_every=min(1000, config.steps), lightning=lightning_flags(lightning))
    train_batches, val_batches = make_loaders(train, val, preset, arguments.level)
    fit(trainer, module, train_batches, val_batches, run)


if __name__ == "__main__":
    main()
