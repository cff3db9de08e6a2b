"""Train the autoencoder of one level.

    python -m kinegraph_training.train_vae --level specific --data DATA/bandai --held-out DATA/held_out_pairs.json \
        --run runs/edge --preset edge

Stopped runs go on where they were. Further flags are Lightning's own: `--devices 2 --strategy ddp`, `--num-nodes 2`.
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

from kinegraph.errors import InvalidInputError
from kinegraph.motion.features import joints_from_features
from kinegraph.motion.skeleton import FEET
from kinegraph_training.config import LEVELS, OptimiserConfig, Preset, read_preset
from kinegraph_training.dataset import Dataset, training_set, validation_set
from kinegraph_training.losses import SPECTRA, ReconstructionLoss, kl_divergence, path_loss, reconstruction_terms
from kinegraph_training.models.vae import MotionVae, VaeConfig
from kinegraph_training.trainer import (
    add_common_arguments,
    last_checkpoint,
    lightning_flags,
    optimiser,
    start_weights,
    trainer,
)
from kinegraph_training.vae_batches import FrameBudgetSampler, cropped, padded

PATH_WEIGHT = 0.1
"""Weight of the whole integral in the last third of a run, once poses are learnt."""

MOTION_TERMS = frozenset(
    ("bones", "velocities", "accelerations", "feet", "window_8", "window_16", *(f"spectra_{size}" for size in SPECTRA))
)
"""Held back at first: while poses are still wrong, a body that stands still has the smallest velocity error, and a
run that starts with these terms never leaves that answer (82 mm after 1,000 steps)."""


ENCODER = frozenset(("patch_in", "query", "encoder", "to_mean", "to_log_variance"))
"""Parts of an autoencoder that lead to its latent."""


def motion_ramp(step: int, steps: int) -> float:
    """Weight of MOTION_TERMS in a run from nothing: 0 for its first tenth, 1 from four tenths on."""
    return min(1.0, max(0.0, (step / steps - 0.1) / 0.3))


class VaeModule(L.LightningModule):
    """The autoencoder, its normalisation and its loss."""

    def __init__(self, config: VaeConfig, training: OptimiserConfig, mean: list[float], std: list[float]) -> None:
        super().__init__()
        self.save_hyperparameters({"config": vars(config), "training": vars(training)})
        self.vae = MotionVae(config)
        self.training_config = training
        self.weights = ReconstructionLoss()
        self.poses_known = False
        """Started from weights that know poses: MOTION_TERMS count from the first step."""
        self.register_buffer("mean", torch.tensor(mean))
        self.register_buffer("std", torch.tensor(std))

    def start_from(self, checkpoint: Path) -> None:
        """Take the weights of another run's checkpoint, and the normalisation without which they mean nothing; the
        schedule stays this run's own. Clips have to come under it too (`Dataset.under`).

        Raises:
            InvalidInputError: no such file, or weights of another shape.
        """
        start_weights(self, checkpoint, "")
        self.poses_known = True

    def keep_encoder(self) -> None:
        """Train the decoder alone: latents stay what they are, and with them denoisers trained on them."""
        for name, parameter in self.vae.named_parameters():
            parameter.requires_grad_(name.split(".")[0] not in ENCODER)

    def training_step(self, batch: tuple[Tensor, Tensor], index: int) -> Tensor:
        features, mask = batch
        mean, log_variance = self.vae.encode(features, mask)
        latent = mean + torch.randn_like(mean) * torch.exp(0.5 * log_variance)
        decoded = self.vae.decode(latent, mask)
        with torch.autocast(self.device.type, enabled=False):
            ramp = 1.0 if self.poses_known else motion_ramp(self.global_step, self.training_config.steps)
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
            raw = [(part[:frames] * self.std + self.mean).float().cpu().numpy() for part in (predicted, target)]
            scores = reconstruction_scores(*raw)
            self.log_dict(
                {f"val/{name}": value for name, value in scores.items()}, on_epoch=True, batch_size=1, on_step=False
            )
            self.log("local_mm", scores["local_mm"], prog_bar=True, logger=False, on_epoch=True, batch_size=1)

    def configure_optimizers(self) -> Any:
        return optimiser(self.vae, self.training_config, str(self.trainer.precision))


def reconstruction_scores(predicted: np.ndarray, target: np.ndarray) -> dict[str, float]:
    """Errors in mm (pose in the facing frame, and everything), jerk in m/s^3, foot skate in m/s."""
    no_root = [rows.copy() for rows in (predicted, target)]
    for rows in no_root:
        rows[:, :3] = 0.0
    local = [joints_from_features(rows) for rows in no_root]
    world = [joints_from_features(rows) for rows in (predicted, target)]
    feet = list(FEET)
    step = np.linalg.norm(np.diff(world[0][:, feet][..., [0, 2]], axis=0), axis=-1) * 20.0
    low = world[0][1:, feet, 1] < 0.05
    return {
        "local_mm": 1000 * float(np.linalg.norm(local[0] - local[1], axis=-1).mean()),
        "global_mm": 1000 * float(np.linalg.norm(world[0] - world[1], axis=-1).mean()),
        "jerk": float(np.linalg.norm(np.diff(world[0], n=3, axis=0), axis=-1).mean()) * 8000.0,
        "skate": float(step[low].mean()) if low.any() else 0.0,
    }


def loaders(train: Dataset, val: Dataset, preset: Preset, level: str) -> tuple[DataLoader, DataLoader]:
    """In memory, no workers: building a batch costs less than a process switch."""
    data, patch = preset.data, preset.vae[level].frames_per_token
    rng = np.random.Generator(np.random.PCG64(preset.seed))
    multiple = 2 * patch

    def collate(indices: list[int]) -> tuple[Tensor, Tensor]:
        clips = [train.features[i] for i in indices]
        crop = {"min_frames": data.min_frames, "max_frames": data.max_frames}
        return padded([cropped(clip, rng, **crop) for clip in clips], multiple)

    lengths = [min(len(rows), data.max_frames) for rows in train.features]
    budget = preset.vae_training[level].batch
    sampler = FrameBudgetSampler(lengths, budget, preset.seed)
    numbers: Any = range(len(train.features))
    val_sampler = FrameBudgetSampler([len(rows) for rows in val.features], 4 * budget, preset.seed)
    return (
        DataLoader(numbers, batch_sampler=sampler, collate_fn=collate),
        DataLoader(
            range(len(val.features)),  # type: ignore[arg-type]
            batch_sampler=val_sampler,
            collate_fn=lambda indices: padded([val.features[i] for i in indices], multiple),
        ),
    )


def main(argv: list[str] | None = None) -> None:
    """Command line."""
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
    train = training_set(arguments.data, preset.data, arguments.held_out, arguments.more, paced=arguments.paced)
    module = VaeModule(preset.vae[arguments.level], config, train.mean.tolist(), train.std.tolist())
    if arguments.start_from:
        module.start_from(arguments.start_from)
        train = train.under(module.mean.numpy(), module.std.numpy())
    val = validation_set(arguments.data, "val", preset.data, train.mean, train.std)
    if arguments.decoder_only:
        module.keep_encoder()
    run = arguments.run / f"vae_{arguments.level}"
    loop = trainer(run, config, validate_every=min(1000, config.steps), lightning=lightning_flags(lightning))
    loop.fit(module, *loaders(train, val, preset, arguments.level), ckpt_path=last_checkpoint(run))


if __name__ == "__main__":
    main()
