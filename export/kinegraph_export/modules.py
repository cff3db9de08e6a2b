"""Trained modules with the flat inputs and outputs of the contract (kinegraph.contract)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from kinegraph_training.models.denoiser import Clock, ContextEncoder, Mixing, StepNetwork
from kinegraph_training.models.vae import MotionVae


class ContextGraph(nn.Module):
    """context_{level}: key_0, value_0, key_1, ..."""

    def __init__(self, context: ContextEncoder) -> None:
        super().__init__()
        self.context = context

    def forward(self, nodes: Tensor, kind: Tensor, order: Tensor, coarse: Tensor) -> tuple[Tensor, ...]:
        return tuple(part for pair in self.context(nodes, kind, order, coarse) for part in pair)


class MotionContextGraph(ContextGraph):
    """context_motion: there is no coarser latent."""

    def forward(self, nodes: Tensor, kind: Tensor, order: Tensor) -> tuple[Tensor, ...]:  # type: ignore[override]
        return tuple(part for pair in self.context(nodes, kind, order) for part in pair)


class StepGraph(nn.Module):
    """step_{level}: latent, temb, keys and values, src, combine, bias -> noise."""

    def __init__(self, step: StepNetwork) -> None:
        super().__init__()
        self.step = step

    def forward(
        self, latent: Tensor, temb: Tensor, context: list[Tensor], src: Tensor, combine: Tensor, bias: Tensor
    ) -> Tensor:
        pairs = list(zip(context[::2], context[1::2], strict=True))
        return self.step(latent, temb, pairs, bias, Mixing(src, combine))


class DecoderGraph(nn.Module):
    """decoder: standardised latent -> normalised features; the latent's scale is folded into the first layer."""

    def __init__(self, vae: MotionVae, centre: Tensor, scale: Tensor) -> None:
        super().__init__()
        self.vae = vae
        self.register_buffer("centre", centre)
        self.register_buffer("scale", scale)

    def forward(self, latent: Tensor, frame_mask: Tensor) -> Tensor:
        return self.vae.decode(latent * self.scale + self.centre, frame_mask)


@torch.no_grad()
def tables(clock: Clock, train_steps: int, max_frames: int) -> tuple[Tensor, Tensor]:
    """The clock as two tables: (train_steps, d) by diffusion step and (max_frames + 1, d) by length."""
    return clock.of_time(torch.arange(train_steps)), clock.of_length(torch.arange(max_frames + 1))
