"""Wrap trained modules so that they have the flat inputs and outputs of the contract (kinegraph.bundle.contract)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from kinegraph_training.models.agd import AgdNoisePredictor
from kinegraph_training.models.denoiser import AdaLNModulation, ContextEncoder, ContextTokens, NoisePredictor, RowMixing
from kinegraph_training.models.vae import MotionVae


class ContextGraph(nn.Module):
    """Graph context_{level}: nodes, bias and coarser latent -> key_0, value_0, key_1, ... of each layer."""

    def __init__(self, context: ContextEncoder) -> None:
        super().__init__()
        self.context = context

    def forward(self, nodes: Tensor, kind: Tensor, order: Tensor, bias: Tensor, coarse: Tensor) -> tuple[Tensor, ...]:
        return self.outputs(nodes, kind, order, bias, coarse)

    def outputs(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """Flatten the keys and values of all layers."""
        return tuple(part for pair in self.context(*inputs) for part in pair)


class MotionContextGraph(ContextGraph):
    """Graph context_motion, which has no coarser latent."""

    def forward(  # type: ignore[override]
        self, nodes: Tensor, kind: Tensor, order: Tensor, bias: Tensor
    ) -> tuple[Tensor, ...]:
        return self.outputs(nodes, kind, order, bias)


class AgdContextGraph(ContextGraph):
    """Graph context_{level}_agd: the same inputs -> the tokens that keys and values are projected from."""

    def outputs(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """Stop before the projections: adaptive gradient descent moves the tokens."""
        return (ContextTokens.forward(self.context, *inputs),)


class MotionAgdContextGraph(MotionContextGraph, AgdContextGraph):
    """Graph context_motion_agd, which has no coarser latent."""


class ModulationGraph(nn.Module):
    """Graph modulation_{level}: timesteps (k,), frames (b,) -> modulation (k, b, m, d)."""

    def __init__(self, clock: AdaLNModulation) -> None:
        super().__init__()
        self.clock = clock

    def forward(self, timestep: Tensor, frames: Tensor) -> Tensor:
        return self.clock(timestep[:, None], frames[None])


class DenoiserGraph(nn.Module):
    """Graph denoiser_{level}: latent, modulation, keys and values, src, combine, bias -> noise."""

    def __init__(self, step: NoisePredictor) -> None:
        super().__init__()
        self.step = step

    def forward(
        self, latent: Tensor, modulation: Tensor, context: list[Tensor], src: Tensor, combine: Tensor, bias: Tensor
    ) -> Tensor:
        pairs = list(zip(context[::2], context[1::2], strict=True))
        return self.step(latent, modulation, pairs, bias, RowMixing(src, combine))


class AgdDenoiserGraph(nn.Module):
    """Graph denoiser_{level}_agd: latent, modulation, context, gamma, src, combine, bias -> noise."""

    def __init__(self, step: AgdNoisePredictor) -> None:
        super().__init__()
        self.step = step

    def forward(
        self,
        latent: Tensor,
        modulation: Tensor,
        context: Tensor,
        gamma: Tensor,
        src: Tensor,
        combine: Tensor,
        bias: Tensor,
    ) -> Tensor:
        return self.step(latent, modulation, context, gamma, bias, RowMixing(src, combine))


class DecoderGraph(nn.Module):
    """Graph decoder: standardised latent (b, c, z) -> normalised features (b, l, F)."""

    def __init__(self, vae: MotionVae, centre: Tensor, scale: Tensor) -> None:
        super().__init__()
        self.vae = vae
        self.register_buffer("centre", centre)
        self.register_buffer("scale", scale)

    def forward(self, latent: Tensor, frame_mask: Tensor) -> Tensor:
        return self.vae.decode(latent * self.scale + self.centre, frame_mask)


class CoarseDecoderGraph(DecoderGraph):
    """Graph decoder_{level}: the same for a coarser level, whose autoencoder has a normalisation of its own."""

    def __init__(self, vae: MotionVae, centre: Tensor, scale: Tensor, gain: Tensor, shift: Tensor) -> None:
        super().__init__(vae, centre, scale)
        self.register_buffer("gain", gain)
        self.register_buffer("shift", shift)

    def forward(self, latent: Tensor, frame_mask: Tensor) -> Tensor:
        return super().forward(latent, frame_mask) * self.gain + self.shift


class DecoderVjp(nn.Module):
    """What a graph decoder_{level}_vjp must compute: the vector-Jacobian product of a decoder, by autograd.

    The graph itself is derived from the exported decoder (`kinegraph_export.reverse_mode`), not traced from this.
    """

    def __init__(self, decoder: DecoderGraph) -> None:
        super().__init__()
        self.decoder = decoder

    def forward(self, latent: Tensor, frame_mask: Tensor, cotangent: Tensor) -> Tensor:
        with torch.enable_grad():
            latent = latent.detach().requires_grad_()
            features = self.decoder(latent, frame_mask)
            (gradient,) = torch.autograd.grad(features, latent, cotangent)
        return gradient


class EncoderGraph(nn.Module):
    """Graph encoder: normalised features (b, l, F) -> mean of the posterior, standardised (b, c, z)."""

    def __init__(self, vae: MotionVae, centre: Tensor, scale: Tensor) -> None:
        super().__init__()
        self.vae = vae
        self.register_buffer("centre", centre)
        self.register_buffer("scale", scale)

    def forward(self, features: Tensor, frame_mask: Tensor) -> Tensor:
        mean, _ = self.vae.encode(features, frame_mask)
        return (mean - self.centre) / self.scale
