"""Latents of clips under the autoencoder's own normalisation."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from kinegraph_training.config import read_preset
from kinegraph_training.dataset import Dataset
from kinegraph_training.latents import TrainedVae, encode_clips, standardise
from kinegraph_training.models.vae import MotionVae

PRESET = read_preset("tiny")


def vae() -> TrainedVae:
    torch.manual_seed(0)
    width = PRESET.vae["specific"].features
    rng = np.random.default_rng(0)
    mean, std = rng.standard_normal(width).astype(np.float32), rng.uniform(0.5, 2, width).astype(np.float32)
    return TrainedVae(MotionVae(PRESET.vae["specific"]).eval(), mean, std)


def test_another_normalisation_of_the_same_clips_gives_the_same_latents() -> None:
    trained = vae()
    raw = [np.random.default_rng(n).standard_normal((20 + 9 * n, len(trained.mean))).astype(np.float32) for n in (1, 0)]
    normalised = Dataset([], [(rows - trained.mean) / trained.std for rows in raw], trained.mean, trained.std)
    plain = Dataset([], raw, np.zeros_like(trained.mean), np.ones_like(trained.std))
    for a, b in zip(encode_clips(trained, normalised), encode_clips(trained, plain), strict=True):
        torch.testing.assert_close(a, b, atol=1e-5, rtol=1e-4)
    # each row belongs to its clip, whatever the order of encoding
    alone = encode_clips(trained, Dataset([], normalised.features[:1], normalised.mean, normalised.std))
    both, _ = encode_clips(trained, normalised)
    torch.testing.assert_close(alone[0][0], both[0], atol=1e-5, rtol=1e-4)
    assert not torch.allclose(both[0], both[1], atol=1e-3)


def test_standardised_draws_have_unit_spread() -> None:
    generator = torch.Generator().manual_seed(0)
    mean, deviation = 3 * torch.randn(4000, 2, 3, generator=generator) + 5, torch.full((4000, 2, 3), 0.7)
    drawn = standardise(mean, deviation).sample(torch.arange(4000), generator)
    torch.testing.assert_close(drawn.mean(0), torch.zeros(2, 3), atol=0.06, rtol=0)
    torch.testing.assert_close(drawn.std(0), torch.ones(2, 3), atol=0.04, rtol=0)
