"""Train the graph encoder and the three denoisers together (GraphMotion, Eq. 6), on frozen autoencoders.

    python -m kinegraph_training.train_denoisers --data DATA/bandai --held-out DATA/held_out_pairs.json \
        --run runs/edge --preset edge --assets assets

`--run` must hold the three autoencoders, `--assets` the text files (`python -m kinegraph_export.text_assets`). The same
command resumes a stopped run. Further flags are those of `lightning.Trainer`: `--devices 2 --strategy ddp`,
`--num-nodes 2`.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, WeightedRandomSampler

from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import KINDS, LEVELS, PADDING_BIAS
from kinegraph.bundle.tables import BONE_LENGTHS, DURATION
from kinegraph.diffusion.sampling import NoiseSchedule
from kinegraph.errors import InvalidInputError
from kinegraph_training.bundle_tables import common_bone_lengths, fit_duration, write_tables
from kinegraph_training.checkpoints import fit
from kinegraph_training.config import DataConfig, OptimiserConfig, Preset, read_preset
from kinegraph_training.data.caption_cache import CaptionGraphs, CaptionStates, encode_graphs, encode_states
from kinegraph_training.data.clips import MotionClip, read_ids, without_motion
from kinegraph_training.data.shown_captions import write_shown_captions
from kinegraph_training.dataset import Dataset, drop_long_clips, training_set, validation_set
from kinegraph_training.denoiser_batches import DenoiserBatch, DenoiserBatches
from kinegraph_training.latents import Latents, encode_clips, encode_levels, read_vae
from kinegraph_training.layouts import FeatureLayout, layout_of
from kinegraph_training.losses import SPECTRAL_TIMESTEPS, SPECTRAL_WEIGHT, SpectralMotionLoss, denoise
from kinegraph_training.models.denoiser import DenoiserConfig, LatentShape
from kinegraph_training.models.hierarchy import Hierarchy
from kinegraph_training.trainer import (
    add_common_arguments,
    configure_optimiser,
    lightning_flags,
    load_start_weights,
    make_trainer,
)

BATCHES_PER_EPOCH = 200


def squared_error(predicted: Tensor, noise: Tensor) -> Tensor:
    """Compute |eps - eps'|^2 of (b, c, z), averaged per sample: (b,)."""
    return (predicted - noise).square().mean(dim=(1, 2))


class HideLate(L.Callback):
    """Callback that hides nodes of the graph, and verbs, only in the last part of a run."""

    def __init__(self, batches: DenoiserBatches, first_step: float) -> None:
        self.batches, self.first_step = batches, first_step

    def on_train_batch_start(self, trainer: L.Trainer, module: L.LightningModule, batch: Any, index: int) -> None:
        self.batches.hiding = trainer.global_step >= self.first_step


class DenoiserModule(L.LightningModule):
    """Graph encoder and denoisers with their loss.

    The loss is the sum over levels of |eps - phi(z_t, t, graph, coarser latent)|^2 (GraphMotion, Eq. 6), and
    `SpectralMotionLoss` at the finest level.
    """

    def __init__(
        self,
        config: DenoiserConfig,
        training: OptimiserConfig,
        latents: dict[str, LatentShape],
        statistics: dict[str, tuple[Tensor, Tensor]],
        spectral_loss: SpectralMotionLoss | None = None,
    ) -> None:
        super().__init__()
        self.spectral_loss = spectral_loss
        shapes = {level: vars(shape) for level, shape in latents.items()}
        self.save_hyperparameters({"config": vars(config), "training": vars(training), "latents": shapes})
        self.hierarchy = Hierarchy(config, latents)
        self.training_config = training
        alphas = torch.tensor(NoiseSchedule(train_steps=config.train_steps).alphas_cumprod, dtype=torch.float32)
        self.register_buffer("alphas", alphas)
        for level, (centre, scale) in statistics.items():
            self.register_buffer(f"{level}_centre", centre)
            self.register_buffer(f"{level}_scale", scale)

    def predict_noise(self, level: str, nodes: Tensor, batch: DenoiserBatch, timestep: Tensor, noise: Tensor) -> Tensor:
        """Mix noise into the latents of one level, and predict it.

        Args:
            level: name of the level.
            nodes: (b, n, D) of the graph encoder.
            batch: latents, graphs and what is hidden.
            timestep: t, (b,).
            noise: eps, (b, c, z).

        Returns:
            eps', (b, c, z).
        """
        denoiser = self.hierarchy.levels[level]
        # z_t = sqrt(alpha_t) z_0 + sqrt(1 - alpha_t) eps
        alpha = self.alphas[timestep][:, None, None]
        noisy = alpha.sqrt() * batch.latents[level] + (1 - alpha).sqrt() * noise
        coarse = batch.coarse.get(level)
        bias = self.context_bias(level, batch)
        context = denoiser.context(nodes, batch.graph.kind, batch.graph.order, bias, coarse)
        modulation = denoiser.clock(timestep, batch.frames)
        predicted: Tensor = denoiser.step(noisy, modulation, context, bias[:, None, None, :]).float()
        return predicted

    def context_bias(self, level: str, batch: DenoiserBatch) -> Tensor:
        """Compute the bias (b, s) of the context tokens: PADDING_BIAS on what is hidden or not seen at this level."""
        names = self.hierarchy.config.kinds_seen(level)
        kind = batch.graph.kind
        seen = torch.isin(kind, torch.tensor([KINDS[name] for name in (*names, "null", "partial")], device=kind.device))
        bias = torch.where(seen, batch.node_bias, torch.full_like(batch.node_bias, PADDING_BIAS))
        # A level that sees the motion node alone always sees it: with nothing to attend to, it would see the padding.
        if names == ("motion",):
            bias = torch.where(kind == KINDS["motion"], torch.zeros_like(bias), bias)
        coarse = batch.coarse.get(level)
        if coarse is None:
            return bias
        return torch.cat([bias, batch.coarse_bias[:, None].expand(-1, coarse.shape[1])], dim=1)

    def losses(self, batch: DenoiserBatch, generator: torch.Generator | None = None) -> dict[str, Tensor]:
        """Compute the loss of every level, (b,), and under "swing" the spectral loss, one number.

        Timesteps are stratified over the batch: each of its b equal parts of the schedule gives one.
        """
        nodes = self.hierarchy.encode(batch.graph)
        count = len(batch.frames)
        spectral = self.global_step >= self.training_config.spectral_from * self.training_config.steps
        terms = {}
        for level in self.hierarchy.latents:
            part = (torch.randperm(count, generator=generator) + torch.rand(count, generator=generator)) / count
            timestep = (part * len(self.alphas)).long().clamp(max=len(self.alphas) - 1).to(self.device)
            noise = torch.randn(batch.latents[level].shape, generator=generator).to(self.device)
            predicted = self.predict_noise(level, nodes, batch, timestep, noise)
            terms[level] = squared_error(predicted, noise)
            clear = timestep < SPECTRAL_TIMESTEPS * len(self.alphas)
            if self.spectral_loss is not None and spectral and level == LEVELS[-1] and clear.any():
                alpha = self.alphas[timestep[clear]][:, None, None]
                target = batch.latents[level][clear]
                clean = denoise(target, noise[clear], predicted[clear], alpha)
                difference = self.spectral_loss(clean, target, batch.frames[clear])
                # The mean over the clear samples stands for their share of the batch.
                terms["swing"] = SPECTRAL_WEIGHT * SPECTRAL_TIMESTEPS * difference
        return terms

    def training_step(self, batch: DenoiserBatch, index: int) -> Tensor:
        terms = {level: value.mean() for level, value in self.losses(batch).items()}
        loss = torch.stack(list(terms.values())).sum()
        self.log_dict({f"train/{level}": value for level, value in terms.items()}, batch_size=len(batch.frames))
        self.log("loss", loss, prog_bar=True, logger=False, batch_size=len(batch.frames))
        return loss

    def validation_step(self, batch: DenoiserBatch, index: int) -> None:
        """Log the losses with and without text, on the same noise: their difference is what the text is worth."""
        for name, variant in (("", batch), ("_without_text", batch.without_text())):
            generator = torch.Generator().manual_seed(index)
            for level, value in self.losses(variant, generator).items():
                self.log(f"val/{level}{name}", value.mean(), batch_size=len(batch.frames), on_epoch=True)

    def transfer_batch_to_device(
        self, batch: DenoiserBatch, device: torch.device, dataloader_idx: int
    ) -> DenoiserBatch:
        return batch.to(device)

    def configure_optimizers(self) -> Any:
        return configure_optimiser(self.hierarchy, self.training_config, str(self.trainer.precision))


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


@dataclass(frozen=True)
class EncodedClips:
    """Latents of all clips, by level."""

    train: dict[str, Latents]
    val: dict[str, Latents]
    """Under the standardisation of training."""


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


def sampling_weights(clips: Iterable[MotionClip], config: DataConfig) -> np.ndarray:
    """Compute how often each clip is drawn, (clips,), by what made it and by what it shows.

    What made a clip has the share of `DataConfig.draws`. Within it, an action in a style has a share by a power of its
    number of clips, and no action has more than `label_cap`: what it has too much is shared by the others.
    """
    told = [(clip.made_by, clip.action, clip.style, clip.action or clip.id) for clip in clips]
    kinds = np.array([made_by for made_by, *_ in told])
    groups = Counter(group[:3] for group in told)
    power = config.label_power - 1.0
    weights = np.array([groups[group[:3]] ** power for group in told])
    often = tuple(config.often)
    weights *= [config.often_weight if often and action.startswith(often) else 1.0 for _, action, *_ in told]
    shares = {kind: config.draws.get(kind, float(np.mean(kinds == kind))) for kind in set(kinds.tolist())}
    shares[""] = max(1.0 - sum(share for kind, share in shares.items() if kind), 0.0)
    for kind, share in shares.items():
        of_kind = kinds == kind
        weights[of_kind] *= share / max(weights[of_kind].sum(), 1e-12)
    labels, index = np.unique([label for *_, label in told], return_inverse=True)
    for _ in range(10):  # capping one action lifts the others, which may pass the cap then
        totals = np.bincount(index, weights, len(labels))
        weights *= np.minimum(1.0, config.label_cap / totals.clip(min=1e-12))[index]
        weights /= weights.sum()
    return weights


def make_loaders(
    clips: Splits, captions: EncodedCaptions, latents: EncodedClips, preset: Preset
) -> tuple[DataLoader, DataLoader]:
    """Make batches of training, drawn at random with dropout, and of validation, in order and without."""
    train, val, graphs = clips.train, clips.val, captions.graphs
    size = preset.denoiser_training.batch
    weights = sampling_weights(without_motion(train.clips), preset.data)
    sampler = WeightedRandomSampler(weights.tolist(), BATCHES_PER_EPOCH * size)
    collate = DenoiserBatches(train, latents.train, graphs, seed=preset.seed, augment=True, masked=captions.masked)
    collate_val = DenoiserBatches(val, latents.val, graphs, seed=preset.seed, augment=False)
    train_indices: Any = range(len(train.clips))
    val_indices: Any = range(len(val.clips))
    return (
        DataLoader(train_indices, batch_size=size, sampler=sampler, collate_fn=collate, drop_last=True),
        DataLoader(val_indices, batch_size=size, collate_fn=collate_val),
    )


def make_spectral_loss(run: Path, latents: Latents) -> SpectralMotionLoss:
    """Make the spectral loss of the finest level with its frozen autoencoder."""
    autoencoder = read_vae(run / f"vae_{LEVELS[-1]}" / "last.ckpt")
    autoencoder.vae.requires_grad_(False)
    return SpectralMotionLoss(autoencoder, latents.centre, latents.scale)


def main(argv: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="kinegraph_training.train_denoisers", description=__doc__.split("\n")[0])
    add_common_arguments(parser)
    parser.add_argument(
        "--assets", type=Path, required=True, help="folder with text_encoder.onnx, tokenizer.json, parser.bin"
    )
    arguments, lightning = parser.parse_known_args(argv)
    preset, run = read_preset(arguments.preset), arguments.run
    config = preset.denoiser_training
    if arguments.threads:
        torch.set_num_threads(arguments.threads)
    L.seed_everything(preset.seed)

    clips = load_clips(arguments, preset.data, layout_of(preset.vae[LEVELS[-1]].features))
    captions = encode_captions(
        clips, preset.denoiser.condition, arguments.assets, run, verb_masking=preset.data.verb_masking
    )
    write_bundle_tables(run, clips.train, captions)
    write_shown_captions(run, without_motion(clips.train.clips), recorded=read_ids(arguments.data))
    latents = encode_latents(clips, preset.denoiser.levels, run)
    train_batches, val_batches = make_loaders(clips, captions, latents, preset)

    shapes = {level: LatentShape(*posterior.centre.shape) for level, posterior in latents.train.items()}
    statistics = {level: (posterior.centre, posterior.scale) for level, posterior in latents.train.items()}
    spectral_loss = make_spectral_loss(run, latents.train[LEVELS[-1]])
    module = DenoiserModule(preset.denoiser, config, shapes, statistics, spectral_loss)
    if arguments.start_from:
        load_start_weights(module.hierarchy, arguments.start_from, "hierarchy.")
    stage = run / "denoisers"
    collate: Any = train_batches.collate_fn
    trainer = make_trainer(
        stage,
        config,
        validate_every=min(500, config.steps),
        lightning=lightning_flags(lightning),
        callbacks=[HideLate(collate, preset.data.hide_from * config.steps)],
    )
    fit(trainer, module, train_batches, val_batches, stage)


if __name__ == "__main__":
    main()
