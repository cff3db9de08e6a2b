"""Latents of all clips at all levels, encoded once, as the autoencoders are frozen (GraphMotion, section 3.3).

Shapes: n clips, c latent tokens, z latent width, f features.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import LEVELS
from kinegraph_training.checkpoints import read_checkpoint
from kinegraph_training.dataset import Dataset
from kinegraph_training.models.vae import MotionVae, VaeConfig
from kinegraph_training.vae_batches import pad_clips

BATCH = 64
"""Clips encoded at a time."""


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
    """(n, c, z)."""
    deviation: torch.Tensor
    """(n, c, z) posterior standard deviation."""
    centre: torch.Tensor
    """(c, z) mean over clips."""
    scale: torch.Tensor
    """(c, z) standard deviation over clips, posterior noise included."""

    def sample(self, rows: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        """Draw from the posteriors of b clips, and standardise: (b, c, z)."""
        mean, deviation = self.mean[rows], self.deviation[rows]
        latents = mean + deviation * torch.randn(mean.shape, generator=generator)
        return (latents - self.centre) / self.scale


@torch.no_grad()
def encode_clips(trained: TrainedVae, dataset: Dataset) -> tuple[torch.Tensor, torch.Tensor]:
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


def standardise(mean: torch.Tensor, deviation: torch.Tensor) -> Latents:
    """Measure the standardisation of latents on these very posteriors."""
    scale = torch.sqrt(mean.var(dim=0) + deviation.square().mean(dim=0))
    return Latents(mean, deviation, mean.mean(dim=0), scale)


def encode_levels(run: Path, dataset: Dataset, cache: Path) -> dict[str, Latents]:
    """Encode all clips at all levels with the autoencoders of a run, and cache the posteriors.

    Args:
        run: folder with `vae_{level}/last.ckpt`.
        dataset: the clips.
        cache: .pt file; read back while it belongs to these checkpoints and to clips of these lengths, else written.
    """
    checkpoints = {level: run / f"vae_{level}" / "last.ckpt" for level in LEVELS}
    stamp = [*dataset.lengths.tolist(), *(path.stat().st_mtime_ns for path in checkpoints.values())]
    if cache.is_file():
        stored = read_checkpoint(cache)
        if stored["stamp"] == stamp:
            return {level: standardise(*stored[level]) for level in LEVELS}
    posteriors = {level: encode_clips(read_vae(path), dataset) for level, path in checkpoints.items()}
    torch.save({"stamp": stamp, **posteriors}, cache)
    return {level: standardise(*posterior) for level, posterior in posteriors.items()}
