"""Motion autoencoder of the released GraphMotion and MLD ("encoder_decoder", with skips).

The released ones are 256 wide, with 9 + 9 layers, 4 heads, and 2, 4 or 8 latent tokens (MLD: 1).

Shapes: b clips, l frames, F features, n latent tokens, d width.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from kinegraph_export.official.transformer import (
    PositionTable,
    PostNormDecoderLayer,
    PostNormEncoderLayer,
    PostNormSkipStack,
)


@dataclass(frozen=True)
class OfficialVaeConfig:
    """Shape of one autoencoder."""

    features: int
    """F of the motion."""
    tokens: int
    """Latent tokens n."""
    width: int
    layers: int
    """Of the encoder, and of the decoder."""
    heads: int
    feed_forward: int
    embedded: int
    """Features that the transformers see; GraphMotion maps the 251 of KIT-ML to 263 first, and back."""


class OfficialVae(nn.Module):
    """Variational autoencoder; without a final layer on the latent, which is as wide as the transformers."""

    def __init__(self, config: OfficialVaeConfig) -> None:
        super().__init__()
        self.config = config
        shape = (config.width, config.heads, config.feed_forward)
        self.global_motion_token = nn.Parameter(torch.empty(2 * config.tokens, config.width))
        self.query_pos_encoder = PositionTable(config.width)
        self.query_pos_decoder = PositionTable(config.width)
        self.encoder = PostNormSkipStack([PostNormEncoderLayer(*shape) for _ in range(config.layers)], config.width)
        self.decoder = PostNormSkipStack([PostNormDecoderLayer(*shape) for _ in range(config.layers)], config.width)
        self.skel_embedding = nn.Linear(config.embedded, config.width)
        self.final_layer = nn.Linear(config.width, config.embedded)
        if config.features != config.embedded:
            self.input_proj = nn.Linear(config.features, config.embedded)
            self.output_proj = nn.Linear(config.embedded, config.features)

    def encode(self, features: Tensor, frame_mask: Tensor) -> tuple[Tensor, Tensor]:
        """Compute the posterior q(z | motion) (GraphMotion, Eq. 4).

        Args:
            features: (b, l, F), normalised.
            frame_mask: (b, l) 1 for real frames.

        Returns:
            Mean and log-variance, (b, n, d) each.
        """
        batch, frames, _ = features.shape
        if self.config.features != self.config.embedded:
            features = self.input_proj(features)
        queries = len(self.global_motion_token)
        tokens = self.global_motion_token.expand(batch, -1, -1)
        sequence = torch.cat([tokens, self.skel_embedding(features)], dim=1)
        sequence = sequence + self.query_pos_encoder(0, queries + frames)
        mask = torch.cat([torch.ones_like(frame_mask[:, :1]).expand(-1, queries), frame_mask], dim=1)
        encoded = self.encoder(sequence, mask)
        return encoded[:, : self.config.tokens], encoded[:, self.config.tokens : queries]

    def decode(self, latent: Tensor, frame_mask: Tensor) -> Tensor:
        """Decode latents to features (GraphMotion, Eq. 5).

        Args:
            latent: (b, n, d).
            frame_mask: (b, l) 1 for real frames, l >= 2.

        Returns:
            (b, l, F), normalised; padding is 0, or for 251 features the bias of the last layer.
        """
        frames = frame_mask.shape[1]
        queries = self.query_pos_decoder(0, frames).expand(latent.shape[0], -1, -1)
        features = self.final_layer(self.decoder(queries, frame_mask, latent)) * frame_mask[..., None]
        return self.output_proj(features) if self.config.features != self.config.embedded else features
