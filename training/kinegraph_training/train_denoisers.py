"""Train the graph encoder and the three denoisers together (GraphMotion, Eq. 6), on frozen autoencoders.

    python -m kinegraph_training.train_denoisers --data DATA/bandai --held-out DATA/held_out_pairs.json \
        --run runs/edge --preset edge --assets assets

Needs the three autoencoders in `--run` and the text assets (`python -m kinegraph_export.text_assets`). Stopped runs
go on where they were. Further flags are Lightning's own: `--devices 2 --strategy ddp`, `--num-nodes 2`.
"""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path
from typing import Any

import lightning as L
import torch
from torch import Tensor
from torch.utils.data import DataLoader, WeightedRandomSampler

from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import LEVELS, NULL_KIND, PADDING_BIAS
from kinegraph.bundle.tables import BONE_LENGTHS, DURATION
from kinegraph.diffusion.sampling import NoiseSchedule
from kinegraph_training.bundle_tables import common_bone_lengths, fit_duration, write_tables
from kinegraph_training.config import DataConfig, OptimiserConfig, Preset, read_preset
from kinegraph_training.data.caption_cache import CaptionGraphs, CaptionStates, caption_states, encode_captions
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.dataset import Dataset, limit_length, training_set, validation_set
from kinegraph_training.denoiser_batches import DenoiserBatch, DenoiserBatches
from kinegraph_training.latents import Latents, cached_latents, encode_clips, read_vae
from kinegraph_training.losses import CLEAR, WEIGHT, SpectralMotionLoss, denoised
from kinegraph_training.models.denoiser import DenoiserConfig, LatentShape
from kinegraph_training.models.hierarchy import Hierarchy
from kinegraph_training.trainer import (
    add_common_arguments,
    last_checkpoint,
    lightning_flags,
    optimiser,
    start_weights,
    trainer,
)


def squared_error(predicted: Tensor, noise: Tensor) -> Tensor:
    """|eps - eps'|^2 of (b, c, z), mean per sample: (b,)."""
    return (predicted - noise).square().mean(dim=(1, 2))


class DenoiserModule(L.LightningModule):
    """Sum over levels of |eps - phi(z_t, t, graph, coarser latent)|^2, and of `SpectralMotionLoss` at the last one."""

    def __init__(
        self,
        config: DenoiserConfig,
        training: OptimiserConfig,
        latents: dict[str, LatentShape],
        statistics: dict[str, tuple[Tensor, Tensor]],
        swing: SpectralMotionLoss | None = None,
    ) -> None:
        super().__init__()
        self.swing = swing
        shapes = {level: vars(shape) for level, shape in latents.items()}
        self.save_hyperparameters({"config": vars(config), "training": vars(training), "latents": shapes})
        self.hierarchy = Hierarchy(config, latents)
        self.training_config = training
        alphas = torch.tensor(NoiseSchedule(train_steps=config.train_steps).alphas_cumprod, dtype=torch.float32)
        self.register_buffer("alphas", alphas)
        for level, (centre, scale) in statistics.items():
            self.register_buffer(f"{level}_centre", centre)
            self.register_buffer(f"{level}_scale", scale)

    def predicted_noise(
        self, level: str, nodes: Tensor, batch: DenoiserBatch, timestep: Tensor, noise: Tensor
    ) -> Tensor:
        """One level's prediction of `noise` (b, c, z) that is mixed into its latents at `timestep` (b,)."""
        kinds = self.hierarchy.config.kinds_seen(level)
        denoiser = self.hierarchy.levels[level]
        alpha = self.alphas[timestep][:, None, None]
        noisy = alpha.sqrt() * batch.latents[level] + (1 - alpha).sqrt() * noise
        seen = (batch.graph.kind < kinds) | (batch.graph.kind == NULL_KIND)
        bias = torch.where(seen, batch.node_bias, torch.full_like(batch.node_bias, PADDING_BIAS))
        # who has nothing else to look at is never denied the sentence
        if kinds == 1:
            bias = torch.where(batch.graph.kind == 0, torch.zeros_like(bias), bias)
        coarse = batch.coarse.get(level)
        if coarse is not None:
            bias = torch.cat([bias, batch.coarse_bias[:, None].expand(-1, coarse.shape[1])], dim=1)
        context = denoiser.context(nodes, batch.graph.kind, batch.graph.order, coarse)
        clock = denoiser.clock(timestep, batch.frames)
        predicted: Tensor = denoiser.step(noisy, clock, context, bias[:, None, None, :]).float()
        return predicted

    def losses(self, batch: DenoiserBatch, generator: torch.Generator | None = None) -> dict[str, Tensor]:
        """Per level (b,), with timesteps stratified over the batch; "swing" is the mean of what it is measured on."""
        nodes = self.hierarchy.encode(batch.graph)
        count = len(batch.frames)
        terms = {}
        for level in self.hierarchy.latents:
            place = (torch.randperm(count, generator=generator) + torch.rand(count, generator=generator)) / count
            timestep = (place * len(self.alphas)).long().clamp(max=len(self.alphas) - 1).to(self.device)
            noise = torch.randn(batch.latents[level].shape, generator=generator).to(self.device)
            predicted = self.predicted_noise(level, nodes, batch, timestep, noise)
            terms[level] = squared_error(predicted, noise)
            clear = timestep < CLEAR * len(self.alphas)
            if self.swing is not None and level == LEVELS[-1] and clear.any():
                alpha = self.alphas[timestep[clear]][:, None, None]
                true = batch.latents[level][clear]
                made = denoised(true, noise[clear], predicted[clear], alpha)
                terms["swing"] = WEIGHT * CLEAR * self.swing(made, true, batch.frames[clear])
        return terms

    def training_step(self, batch: DenoiserBatch, index: int) -> Tensor:
        terms = {level: value.mean() for level, value in self.losses(batch).items()}
        loss = torch.stack(list(terms.values())).sum()
        self.log_dict({f"train/{level}": value for level, value in terms.items()}, batch_size=len(batch.frames))
        self.log("loss", loss, prog_bar=True, logger=False, batch_size=len(batch.frames))
        return loss

    def validation_step(self, batch: DenoiserBatch, index: int) -> None:
        """With the text and without it, on the same noise: the gap is what the text is worth."""
        for name, shown in (("", batch), ("_without_text", batch.without_text())):
            generator = torch.Generator().manual_seed(index)
            for level, value in self.losses(shown, generator).items():
                self.log(f"val/{level}{name}", value.mean(), batch_size=len(batch.frames), on_epoch=True)

    def transfer_batch_to_device(
        self, batch: DenoiserBatch, device: torch.device, dataloader_idx: int
    ) -> DenoiserBatch:
        return batch.to(device)

    def configure_optimizers(self) -> Any:
        return optimiser(self.hierarchy, self.training_config, str(self.trainer.precision))


def clip_weights(clips: list[MotionClip], config: DataConfig) -> list[float]:
    """Clips of rare contents are drawn more often; made compositions are as rare as they were made to be."""
    counts = Counter(clip.content for clip in clips)
    made = ("+", ">")
    return [
        config.rare_weight if counts[clip.content] < 50 and not any(mark in clip.content for mark in made) else 1.0
        for clip in clips
    ]


def measured(train: Dataset, graphs: CaptionGraphs | CaptionStates) -> dict[str, FloatArray]:
    """What the bundle says of the training clips besides the networks: how long they are, how long their bones."""
    tables = {}
    if isinstance(graphs, CaptionGraphs):
        usual = [clip for clip in train.clips if not clip.any_length]
        frames = [(graphs.get(caption), len(clip.joints)) for clip in usual for caption in clip.captions]
        tables[DURATION] = fit_duration(frames)
    lengths = common_bone_lengths(clip.joints for clip in train.clips)
    return tables if lengths is None else {**tables, BONE_LENGTHS: lengths}


def batches(arguments: argparse.Namespace, preset: Preset) -> tuple[DataLoader, DataLoader, dict[str, Latents]]:
    """Training and validation batches, and the latents they come from."""
    train = limit_length(
        training_set(arguments.data, preset.data, arguments.held_out, arguments.more), preset.data.max_frames
    )
    val = validation_set(arguments.data, "val", preset.data, train.mean, train.std)
    captions = [caption for clip in train.clips + val.clips for caption in clip.captions]
    graphs: CaptionGraphs | CaptionStates
    masked: CaptionGraphs | None = None
    if preset.denoiser.condition == "tokens":
        graphs = caption_states(captions, arguments.assets, arguments.run / "states.npz")
    else:
        graphs = encode_captions(captions, arguments.assets, arguments.run / "captions.npz")
        trained_on = [caption for clip in train.clips for caption in clip.captions]
        masked = encode_captions(trained_on, arguments.assets, arguments.run / "captions_masked.npz", verbs_masked=True)
    write_tables(arguments.run, measured(train, graphs))
    known = cached_latents(arguments.run, train, arguments.run / "latents.pt")
    latents = {level: known[level] for level in preset.denoiser.levels}
    val_latents = {}
    for level, own in latents.items():
        posterior = encode_clips(read_vae(arguments.run / f"vae_{level}" / "last.ckpt"), val)
        val_latents[level] = Latents(*posterior, own.centre, own.scale)
    config = preset.denoiser_training
    sampler = WeightedRandomSampler(clip_weights(train.clips, preset.data), 200 * config.batch)
    collate = DenoiserBatches(train, latents, graphs, seed=preset.seed, augment=True, masked=masked)
    check = DenoiserBatches(val, val_latents, graphs, seed=preset.seed, augment=False)
    numbers: Any = range(len(train.clips))
    val_numbers: Any = range(len(val.clips))
    return (
        DataLoader(numbers, batch_size=config.batch, sampler=sampler, collate_fn=collate, drop_last=True),
        DataLoader(val_numbers, batch_size=config.batch, collate_fn=check),
        latents,
    )


def main(argv: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="kinegraph_training.train_denoisers", description=__doc__.split("\n")[0])
    add_common_arguments(parser)
    parser.add_argument(
        "--assets", type=Path, required=True, help="folder with text_encoder.onnx, tokenizer.json, parser.bin"
    )
    arguments, lightning = parser.parse_known_args(argv)
    preset = read_preset(arguments.preset)
    if arguments.threads:
        torch.set_num_threads(arguments.threads)
    L.seed_everything(preset.seed)
    train, val, latents = batches(arguments, preset)
    shapes = {level: LatentShape(*own.centre.shape) for level, own in latents.items()}
    statistics = {level: (own.centre, own.scale) for level, own in latents.items()}
    config = preset.denoiser_training
    finest = latents[LEVELS[-1]]
    decoder = read_vae(arguments.run / f"vae_{LEVELS[-1]}" / "last.ckpt")
    decoder.vae.requires_grad_(False)
    swing = SpectralMotionLoss(decoder, finest.centre, finest.scale)
    module = DenoiserModule(preset.denoiser, config, shapes, statistics, swing)
    if arguments.start_from:
        start_weights(module.hierarchy, arguments.start_from, "hierarchy.")
    run = arguments.run / "denoisers"
    loop = trainer(run, config, validate_every=min(500, config.steps), lightning=lightning_flags(lightning))
    loop.fit(module, train, val, ckpt_path=last_checkpoint(run))


if __name__ == "__main__":
    main()
