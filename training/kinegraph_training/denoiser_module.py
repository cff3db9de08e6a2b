"""The denoisers in training: their loss, and what is hidden from them late in a run."""

from __future__ import annotations

from typing import Any

import lightning as L
import torch
from torch import Tensor

from kinegraph.bundle.contract import KINDS, LEVELS, PADDING_BIAS
from kinegraph.diffusion.sampling import NoiseSchedule
from kinegraph_training.config import OptimiserConfig
from kinegraph_training.denoiser_batches import DenoiserBatch, DenoiserBatches
from kinegraph_training.losses import SPECTRAL_TIMESTEPS, SPECTRAL_WEIGHT, SpectralMotionLoss, denoise
from kinegraph_training.models.denoiser import DenoiserConfig, LatentShape
from kinegraph_training.models.hierarchy import Hierarchy
from kinegraph_training.trainer import configure_optimiser


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
        beta_end: float = NoiseSchedule.beta_end,
    ) -> None:
        super().__init__()
        self.spectral_loss = spectral_loss
        shapes = {level: vars(shape) for level, shape in latents.items()}
        self.save_hyperparameters({"config": vars(config), "training": vars(training), "latents": shapes})
        self.hierarchy = Hierarchy(config, latents)
        self.training_config = training
        schedule = NoiseSchedule(train_steps=config.train_steps, beta_end=beta_end)
        self.register_buffer("alphas", torch.tensor(schedule.alphas_cumprod, dtype=torch.float32))
        for level, (centre, scale) in statistics.items():
            self.register_buffer(f"{level}_centre", centre)
            self.register_buffer(f"{level}_scale", scale)

    def predict_noise(self, level: str, nodes: Tensor, batch: DenoiserBatch, timestep: Tensor, noise: Tensor) -> Tensor:
        """Mix noise into the latents of one level, and predict it.

        Args:
            level: name of the level.
            nodes: (a, n, D) of the graph encoder.
            batch: latents, graphs and what is hidden.
            timestep: t, (b,).
            noise: eps, (b, c, z).

        Returns:
            eps', (b, c, z); of composed samples that of all their rows (EnergyMoGen, Eq. 7 and 9).
        """
        inputs, rows = self.step_inputs(level, nodes, batch, timestep, noise), batch.rows
        if rows is None:
            predicted: Tensor = self.hierarchy.levels[level].step(*inputs)
            return predicted.float()
        of_rows = self.hierarchy.levels[level].step(*inputs, mixing=rows.mixing)
        with torch.autocast(of_rows.device.type, enabled=False):  # a difference of predictions is small
            return torch.tensordot(rows.coefficients, of_rows.float(), dims=1)

    def step_inputs(
        self, level: str, nodes: Tensor, batch: DenoiserBatch, timestep: Tensor, noise: Tensor
    ) -> tuple[Any, ...]:
        """Compute what the denoiser of a level takes; arguments as in `predict_noise`.

        Returns:
            Noisy latents (r, c, z), modulation, context and its bias (a, 1, 1, s), see `NoisePredictor.forward`;
            r = a = b where no sample is composed.
        """
        denoiser = self.hierarchy.levels[level]
        # z_t = sqrt(alpha_t) z_0 + sqrt(1 - alpha_t) eps
        alpha = self.alphas[timestep][:, None, None]
        noisy = alpha.sqrt() * batch.latents[level] + (1 - alpha).sqrt() * noise
        bias, coarse, frames = self.context_bias(level, batch), batch.coarse.get(level), batch.frames
        if batch.rows is not None:
            sample = batch.rows.sample
            noisy, timestep, frames = noisy[sample], timestep[sample], frames[sample]
            coarse = None if coarse is None else coarse[batch.rows.attention_sample]
        context = denoiser.context(nodes, batch.graph.kind, batch.graph.order, bias, coarse)
        return noisy, denoiser.clock(timestep, frames), context, bias[:, None, None, :]

    def context_bias(self, level: str, batch: DenoiserBatch) -> Tensor:
        """Compute the bias (a, s) of the context tokens: PADDING_BIAS on what is hidden or not seen at this level."""
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
        of_coarse = batch.coarse_bias if batch.rows is None else batch.coarse_bias[batch.rows.attention_sample]
        return torch.cat([bias, of_coarse[:, None].expand(-1, coarse.shape[1])], dim=1)

    def draw_timesteps(self, count: int, generator: torch.Generator | None) -> Tensor:
        """Draw timesteps (count,), stratified: each of `count` equal parts of the schedule gives one."""
        part = (torch.randperm(count, generator=generator) + torch.rand(count, generator=generator)) / count
        return (part * len(self.alphas)).long().clamp(max=len(self.alphas) - 1).to(self.device)

    def losses(self, batch: DenoiserBatch, generator: torch.Generator | None = None) -> dict[str, Tensor]:
        """Compute the loss of every level, (b,), and under "swing" the spectral loss, one number."""
        nodes = self.hierarchy.encode(batch.graph)
        count = len(batch.frames)
        spectral = self.global_step >= self.training_config.spectral_from * self.training_config.steps
        terms = {}
        for level in self.hierarchy.latents:
            timestep = self.draw_timesteps(count, generator)
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
