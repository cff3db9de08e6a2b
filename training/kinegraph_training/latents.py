"""Latents of all clips at all levels, encoded once, as the autoencoders are frozen (GraphMotion, section 3.2).

Shapes: n clips, c latent tokens, z latent width, f features.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import LEVELS
from kinegraph.errors import InvalidInputError
from kinegraph_training.checkpoints import read_checkpoint
from kinegraph_training.dataset import Dataset
from kinegraph_training.models.vae import MotionVae, VaeConfig
from kinegraph_training.stored_features import StoredFeatures
from kinegraph_training.stored_rows import store_rows
from kinegraph_training.vae_batches import pad_clips

BATCH = 64
"""Clips encoded at a time."""
ROWS = 16_384
"""Clips that a standardisation is measured on at a time."""

Posterior = tuple[torch.Tensor, torch.Tensor]
"""Mean and standard deviation of the latents of n clips, (n, c, z) each."""


@dataclass(frozen=True)
class TrainedVae:
    """Autoencoder with the normalisation it was trained under."""

    vae: MotionVae
    mean: FloatArray
    """(f,)."""
    std: FloatArray
    """(f,)."""


def read_vae(checkpoint: Path) -> TrainedVae:
    """Read the averaged weights of a checkpoint that train_vae wrote."""
    state = read_checkpoint(checkpoint)
    vae = MotionVae(VaeConfig(**state["hyper_parameters"]["config"]))
    weights = state["state_dict"]
    vae.load_state_dict({name.removeprefix("vae."): w for name, w in weights.items() if name.startswith("vae.")})
    return TrainedVae(vae.eval(), weights["mean"].numpy(), weights["std"].numpy())


@dataclass(frozen=True)
class Latents:
    """Posteriors of one level for n clips, and the standardisation of its latents."""

    mean: torch.Tensor
    """(n, c, z); of clips in shards, 16-bit and mapped into memory."""
    deviation: torch.Tensor
    """(n, c, z) posterior standard deviation."""
    centre: torch.Tensor
    """(c, z) mean over clips."""
    scale: torch.Tensor
    """(c, z) standard deviation over clips, posterior noise included."""

    def sample(self, rows: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        """Draw from the posteriors of b clips, and standardise: (b, c, z)."""
        mean, deviation = self.mean[rows].float(), self.deviation[rows].float()
        latents = mean + deviation * torch.randn(mean.shape, generator=generator)
        return (latents - self.centre) / self.scale


@torch.no_grad()
def encode_clips(trained: TrainedVae, dataset: Dataset) -> Posterior:
    """Encode all clips; returns posterior mean and standard deviation (n, c, z), in the order of the clips.

    Features are brought under the autoencoder's own normalisation, as the diffusion stage may train on other clips.
    """
    features = dataset.under(trained.mean, trained.std).features
    order = np.argsort(dataset.lengths, kind="stable")
    config = trained.vae.config
    mean = torch.zeros(len(features), config.tokens, config.latent_width)
    deviation = torch.zeros_like(mean)
    for start in range(0, len(order), BATCH):
        rows = order[start : start + BATCH]
        batch, mask = pad_clips([features[row] for row in rows], config.frames_per_token)
        mu, log_variance = trained.vae.encode(batch, mask)
        mean[rows], deviation[rows] = mu, torch.exp(0.5 * log_variance)
    return mean, deviation


def encode_stored(vaes: Mapping[str, TrainedVae], dataset: Dataset, folder: Path, stamp: str) -> dict[str, Posterior]:
    """Encode clips in shards at all levels, into files that are mapped into memory.

    Args:
        vaes: autoencoder of each level.
        dataset: the clips.
        folder: to write.
        stamp: of the clips and the autoencoders.
    """
    parts = ("mean", "deviation")
    configs = {level: trained.vae.config for level, trained in vaes.items()}
    shapes = {
        f"{level}.{part}": (len(dataset.lengths), config.tokens, config.latent_width)
        for level, config in configs.items()
        for part in parts
    }

    def encode_rows(rows: NDArray[np.int64]) -> dict[str, FloatArray]:
        block = dataset.select(rows).in_memory()
        encoded = {level: encode_clips(trained, block) for level, trained in vaes.items()}
        return {f"{level}.{part}": encoded[level][index].numpy() for level in vaes for index, part in enumerate(parts)}

    arrays = {name: torch.from_numpy(array) for name, array in store_rows(folder, stamp, shapes, encode_rows).items()}
    return {level: (arrays[f"{level}.mean"], arrays[f"{level}.deviation"]) for level in vaes}


def standardise(mean: torch.Tensor, deviation: torch.Tensor) -> Latents:
    """Measure the standardisation of latents on these very posteriors, some rows at a time."""
    count = len(mean)
    parts = [slice(start, start + ROWS) for start in range(0, count, ROWS)]
    centre = torch.stack([mean[part].double().sum(dim=0) for part in parts]).sum(dim=0) / count
    between = torch.stack([(mean[part].double() - centre).square().sum(dim=0) for part in parts]).sum(dim=0)
    within = torch.stack([deviation[part].double().square().sum(dim=0) for part in parts]).sum(dim=0)
    scale = torch.sqrt(between / (count - 1) + within / count)
    return Latents(mean, deviation, centre.float(), scale.float())


def encode_levels(run: Path, dataset: Dataset, cache: Path) -> dict[str, Latents]:
    """Encode all clips at all levels with the autoencoders of a run, and cache the posteriors.

    Those of clips in shards are written into a folder and stay there.

    Args:
        run: folder with `vae_{level}/last.ckpt`.
        dataset: the clips.
        cache: .pt file, or for clips in shards the folder without that suffix; read back while it belongs to these
            checkpoints and to clips of these lengths, else written.
    """
    checkpoints = {level: run / f"vae_{level}" / "last.ckpt" for level in LEVELS}
    if missing := [level for level, path in checkpoints.items() if not path.is_file()]:
        raise InvalidInputError(f"{run} has no autoencoder of {', '.join(missing)}; train it first: train_vae --level")
    stamp = [*dataset.lengths.tolist(), *(path.stat().st_mtime_ns for path in checkpoints.values())]
    if isinstance(dataset.features, StoredFeatures):
        name = hashlib.sha256(json.dumps(stamp).encode()).hexdigest()
        vaes = {level: read_vae(path) for level, path in checkpoints.items()}
        mapped = encode_stored(vaes, dataset, cache.with_suffix(""), name)
        return {level: standardise(*posterior) for level, posterior in mapped.items()}
    if cache.is_file():
        stored = read_checkpoint(cache)
        if stored["stamp"] == stamp:
            return {level: standardise(*stored[level]) for level in LEVELS}
    posteriors = {level: encode_clips(read_vae(path), dataset) for level, path in checkpoints.items()}
    torch.save({"stamp": stamp, **posteriors}, cache)
    return {level: standardise(*posterior) for level, posterior in posteriors.items()}
