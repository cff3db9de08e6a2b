"""Latents of all clips at all levels, computed once: the autoencoders are frozen (GraphMotion, section 3.3)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from kinegraph.arrays import FloatArray

from kinegraph_training.config import LEVELS
from kinegraph_training.dataset import Dataset
from kinegraph_training.models.vae import MotionVae, VaeConfig
from kinegraph_training.vae_batches import padded


@dataclass(frozen=True)
class TrainedVae:
    """An autoencoder read back from its run, with the normalisation it was trained under."""

    vae: MotionVae
    mean: FloatArray
    std: FloatArray


def read_vae(checkpoint: Path) -> TrainedVae:
    """The averaged weights of a checkpoint written by train_vae."""
    state = torch.load(checkpoint, map_location="cpu", weights_only=True)
    vae = MotionVae(VaeConfig(**state["hyper_parameters"]["config"]))
    weights = state["state_dict"]
    own = {name.removeprefix("vae."): value for name, value in weights.items() if name.startswith("vae.")}
    vae.load_state_dict(own)
    return TrainedVae(vae.eval(), weights["mean"].numpy(), weights["std"].numpy())


@dataclass(frozen=True)
class Latents:
    """One level's posteriors of n clips and their standardisation."""

    mean: torch.Tensor
    """(n, c, z)."""
    deviation: torch.Tensor
    """(n, c, z) posterior standard deviation."""
    centre: torch.Tensor
    """(c, z) mean over clips."""
    scale: torch.Tensor
    """(c, z) standard deviation over clips, posterior noise included."""

    def sample(self, rows: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        """Standardised draws from the posteriors of some clips: (b, c, z)."""
        mean, deviation = self.mean[rows], self.deviation[rows]
        drawn = mean + deviation * torch.randn(mean.shape, generator=generator)
        return (drawn - self.centre) / self.scale


@torch.no_grad()
def encode_clips(trained: TrainedVae, dataset: Dataset) -> tuple[torch.Tensor, torch.Tensor]:
    """Posterior mean and standard deviation, (n, c, z) each, in the order of the clips.

    Under the autoencoder's own normalisation: the diffusion stage may be given other clips, and thus another.
    """
    gain = dataset.std / trained.std
    shift = (dataset.mean - trained.mean) / trained.std
    features = [rows * gain + shift for rows in dataset.features]
    order = np.argsort([len(rows) for rows in features], kind="stable")
    config = trained.vae.config
    mean = torch.zeros(len(features), config.tokens, config.latent_width)
    deviation = torch.zeros_like(mean)
    for start in range(0, len(order), 64):
        rows = order[start : start + 64]
        batch, mask = padded([features[row] for row in rows], config.frames_per_token)
        mu, log_variance = trained.vae.encode(batch, mask)
        mean[rows], deviation[rows] = mu, torch.exp(0.5 * log_variance)
    return mean, deviation


def standardised(mean: torch.Tensor, deviation: torch.Tensor) -> Latents:
    """Latents with the statistics of these very clips."""
    scale = torch.sqrt(mean.var(dim=0) + deviation.square().mean(dim=0))
    return Latents(mean, deviation, mean.mean(dim=0), scale)


def cached_latents(runs: Path, dataset: Dataset, cache: Path) -> dict[str, Latents]:
    """All levels; read back from `cache` while it belongs to these checkpoints and clips of these lengths."""
    checkpoints = {level: runs / f"vae_{level}" / "last.ckpt" for level in LEVELS}
    stamp = [*map(len, dataset.features), *(path.stat().st_mtime_ns for path in checkpoints.values())]
    if cache.is_file():
        stored = torch.load(cache, weights_only=True)
        if stored["stamp"] == stamp:
            return {level: standardised(*stored[level]) for level in LEVELS}
    encoded = {level: encode_clips(read_vae(path), dataset) for level, path in checkpoints.items()}
    torch.save({"stamp": stamp, **encoded}, cache)
    return {level: standardised(*pair) for level, pair in encoded.items()}
