"""Latents of clips under the autoencoder's own normalisation; those of shards in files, resumable."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

pytest.importorskip("tqdm")

from kinegraph.bundle.contract import LEVELS
from kinegraph_training import latents, stored_rows
from kinegraph_training.config import read_preset
from kinegraph_training.data.shards import write_shards
from kinegraph_training.dataset import Dataset, training_set
from kinegraph_training.latents import TrainedVae, encode_clips, encode_levels, read_vae, standardise
from kinegraph_training.models.vae import MotionVae
from support.many_hours import make_clip, write_autoencoders

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


def test_latents_of_shards_go_on_where_they_were_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_shards(tmp_path / "data", range(20), make_clip, 20.0, processes=1)
    write_autoencoders(tmp_path / "run")
    dataset = training_set(tmp_path / "data", PRESET.data, None)
    assert len(dataset.clips) == 38  # 19 of training, and their mirror images
    monkeypatch.setattr(stored_rows, "BLOCK", 16)
    monkeypatch.setattr(latents, "ROWS", 10)
    sizes: list[int] = []

    def noted(trained: TrainedVae, block: Dataset) -> latents.Posterior:
        sizes.append(len(block.features))
        if len(sizes) == 5:
            raise KeyboardInterrupt
        return encode_clips(trained, block)

    monkeypatch.setattr(latents, "encode_clips", noted)

    def encode() -> dict[str, latents.Latents]:
        return encode_levels(tmp_path / "run", dataset, tmp_path / "run" / "latents.pt")

    with pytest.raises(KeyboardInterrupt):
        encode()
    sizes[:] = [0] * 5
    stored = encode()
    assert sizes[5:] == [16, 16, 16, 6, 6, 6], "the first block was there"
    encode()
    assert len(sizes) == 11, "all was there"
    for level in LEVELS:
        mean, deviation = encode_clips(read_vae(tmp_path / "run" / f"vae_{level}" / "last.ckpt"), dataset)
        expected, latent = standardise(mean, deviation), stored[level]
        assert latent.mean.dtype == torch.float16
        torch.testing.assert_close(latent.mean.float(), mean, atol=2e-3, rtol=2e-3)
        torch.testing.assert_close(latent.deviation.float(), deviation, atol=2e-3, rtol=2e-3)
        torch.testing.assert_close(latent.centre, mean.mean(dim=0), atol=2e-3, rtol=2e-3)
        spread = torch.sqrt(mean.var(dim=0) + deviation.square().mean(dim=0))
        torch.testing.assert_close(expected.scale, spread, atol=1e-5, rtol=1e-5)
        torch.testing.assert_close(latent.scale, spread, atol=2e-3, rtol=2e-3)
        drawn = latent.sample(torch.tensor([37, 0]), torch.Generator().manual_seed(1))
        again = expected.sample(torch.tensor([37, 0]), torch.Generator().manual_seed(1))
        torch.testing.assert_close(drawn, again, atol=0.02, rtol=0.02)
    os.utime(tmp_path / "run" / "vae_action" / "last.ckpt", ns=(1, 1))
    encode()
    assert len(sizes) == 11 + 9, "another autoencoder encodes all anew"
