"""Motion autoencoder of one level (GraphMotion, section 3.2, Eq. 4-5): frames <-> latent tokens.

It differs from the published one where measurements said so. Four frames make a token of the transformer; layers are
pre-norm; the latent is narrow; the log-variance starts at -5. A direct path pools the frames of segment k of the clip
into latent token k, and interpolates latent tokens back over the clip. A convolution over frames hides the seams
between groups of four.

Shapes: b clips, l frames, p groups of frames, f features, c latent tokens, z latent width, d width.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from kinegraph.bundle.contract import PADDING_BIAS
from kinegraph_training.models.transformer import EncoderLayer, SkipStack, sinusoid

ENCODER_PARTS = frozenset(("patch_in", "query", "encoder", "to_mean", "to_log_variance"))
"""Attributes of `MotionVae` that belong to the encoder; all others belong to the decoder."""


@dataclass(frozen=True)
class VaeConfig:
    """Shape of the autoencoder of one level."""

    features: int
    tokens: int
    """Latent tokens."""
    latent_width: int
    width: int
    layers: int
    heads: int
    feed_forward: int
    frames_per_token: int = 4
    frame_channels: int = 96
    """Channels of the convolution over frames."""


def segment_weights(patch_mask: Tensor, tokens: int) -> Tensor:
    """Compute weights of linear interpolation between the centres of equal segments of each clip.

    Args:
        patch_mask: (b, p) 1 for real groups of frames.
        tokens: segments, one for each latent token.

    Returns:
        (b, p, c); rows sum to 1, also on padding.
    """
    length = patch_mask.sum(dim=1, keepdim=True)
    position = (torch.cumsum(torch.ones_like(patch_mask), dim=1) - 0.5) / length * tokens
    position = torch.minimum(torch.clamp(position, min=0.5), torch.full_like(position, tokens - 0.5))
    centre = torch.arange(tokens, device=patch_mask.device, dtype=patch_mask.dtype) + 0.5
    return torch.relu(1.0 - torch.abs(position[..., None] - centre))


class ConvolutionBlock(nn.Module):
    """Residual convolution over frames; padding counts as zeros."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(channels)
        self.convolution = nn.Conv1d(channels, channels, kernel_size=5, padding=2)
        self.mix = nn.Linear(channels, channels)

    def forward(self, x: Tensor, frame_mask: Tensor) -> Tensor:
        inner = (self.norm(x) * frame_mask[..., None]).transpose(1, 2)
        return x + self.mix(functional.gelu(self.convolution(inner).transpose(1, 2)))


class MotionVae(nn.Module):
    """Variational autoencoder of clips whose padded length l is a multiple of `frames_per_token`."""

    def __init__(self, config: VaeConfig) -> None:
        super().__init__()
        self.config = config
        width, patch = config.width, config.frames_per_token
        layer = (config.width, config.heads, config.feed_forward, 0.0)
        self.patch_in = nn.Linear(patch * config.features, width)
        self.query = nn.Parameter(torch.randn(2 * config.tokens, width) * 0.02)
        self.encoder = SkipStack([EncoderLayer(*layer) for _ in range(config.layers)], width)
        self.to_mean = nn.Linear(width, config.latent_width)
        self.to_log_variance = nn.Linear(width, config.latent_width)
        nn.init.zeros_(self.to_log_variance.weight)
        nn.init.constant_(self.to_log_variance.bias, -5.0)
        self.latent_in = nn.Linear(config.latent_width, width)
        self.latent_position = nn.Parameter(torch.randn(config.tokens, width) * 0.02)
        self.decoder = SkipStack([EncoderLayer(*layer) for _ in range(config.layers)], width)
        self.patch_out = nn.Linear(width, patch * config.frame_channels)
        self.smooth = nn.ModuleList(ConvolutionBlock(config.frame_channels) for _ in range(2))
        self.frame_norm = nn.LayerNorm(config.frame_channels)
        self.features_out = nn.Linear(config.frame_channels, config.features)

    def patch_mask(self, frame_mask: Tensor) -> Tensor:
        """Reduce a mask (b, l) to groups of frames (b, p): a group is real if its first frame is."""
        return frame_mask[:, :: self.config.frames_per_token]

    def positions(self, patch_mask: Tensor) -> Tensor:
        """Encode positions (b, p, d) from the start and from the end, so that the length of the clip is known."""
        index = torch.cumsum(torch.ones_like(patch_mask), dim=1) - 1.0
        from_end = patch_mask.sum(dim=1, keepdim=True) - 1.0 - index
        half = self.config.width // 2
        return torch.cat([sinusoid(index, half), sinusoid(from_end, half)], dim=-1)

    def encode(self, features: Tensor, frame_mask: Tensor) -> tuple[Tensor, Tensor]:
        """Compute the posterior q(z | motion) (GraphMotion, Eq. 4).

        Args:
            features: (b, l, f).
            frame_mask: (b, l) 1 for real frames.

        Returns:
            Mean and log-variance, (b, c, z) each.
        """
        config = self.config
        batch, frames, _ = features.shape
        features = features * frame_mask[..., None]
        patches = self.patch_in(features.reshape(batch, frames // config.frames_per_token, -1))
        mask = self.patch_mask(frame_mask)
        weights = segment_weights(mask, config.tokens) * mask[..., None]
        pooled = weights.transpose(1, 2) @ patches / weights.sum(dim=1)[..., None].clamp(min=1e-4)
        queries = self.query + torch.cat([pooled, pooled], dim=1)
        sequence = torch.cat([queries, patches + self.positions(mask)], dim=1)
        bias = torch.cat([mask.new_ones(batch, 2 * config.tokens), mask], dim=1)
        bias = ((1.0 - bias) * PADDING_BIAS)[:, None, None, :]
        encoded = self.encoder(sequence, bias)
        mean = self.to_mean(encoded[:, : config.tokens])
        return mean, self.to_log_variance(encoded[:, config.tokens : 2 * config.tokens])

    def decode(self, latent: Tensor, frame_mask: Tensor) -> Tensor:
        """Decode latents to features (GraphMotion, Eq. 5).

        Args:
            latent: (b, c, z).
            frame_mask: (b, l) 1 for real frames.

        Returns:
            (b, l, f), zero on padding.
        """
        config = self.config
        batch, frames = frame_mask.shape
        mask = self.patch_mask(frame_mask)
        tokens = self.latent_in(latent)
        queries = segment_weights(mask, config.tokens) @ tokens + self.positions(mask)
        sequence = torch.cat([tokens + self.latent_position, queries], dim=1)
        bias = torch.cat([mask.new_ones(batch, config.tokens), mask], dim=1)
        bias = ((1.0 - bias) * PADDING_BIAS)[:, None, None, :]
        decoded = self.decoder(sequence, bias)[:, config.tokens :]
        x = self.patch_out(decoded).reshape(batch, frames, config.frame_channels)
        for block in self.smooth:
            x = block(x, frame_mask)
        return self.features_out(self.frame_norm(x)) * frame_mask[..., None]
