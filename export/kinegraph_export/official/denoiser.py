"""Denoisers of the released GraphMotion and MLD: latent, time and conditions in one sequence ("concat").

GraphMotion's are 1024 wide with 17 layers and 16 heads, and lift the latent from 256 by a perceptron; MLD's are as wide
as the latent, with 9 layers and 4 heads, and have none. The sequence is

    latent (n), time (1), coarser latent (n'), sentence (1), actions (4), specifics (8)

as far as the level has them, and a table of positions is added to all of it.

Shapes: r rows, n latent tokens, z latent width, s condition tokens, d width, D text width.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from kinegraph_export.official.transformer import PositionTable, PostNormEncoderLayer, PostNormSkipStack

MAX_PERIOD = 10000.0


@dataclass(frozen=True)
class OfficialDenoiserConfig:
    """Shape of one denoiser."""

    tokens: int
    """Latent tokens n."""
    latent_width: int
    """z."""
    width: int
    """d."""
    layers: int
    heads: int
    feed_forward: int
    text_width: int
    """D."""
    is_lifted: bool
    """Whether perceptrons lead from the latent to the transformer and back (GraphMotion)."""


class TimeEmbedding(nn.Module):
    """Perceptron over the sinusoids of a timestep."""

    def __init__(self, text_width: int, width: int) -> None:
        super().__init__()
        self.linear_1 = nn.Linear(text_width, width)
        self.linear_2 = nn.Linear(width, width)

    def forward(self, timestep: Tensor) -> Tensor:
        """Encode timesteps (k,) as (k, d)."""
        half = self.linear_1.in_features // 2
        frequency = torch.exp(torch.arange(half, dtype=torch.float32) * (-math.log(MAX_PERIOD) / half))
        angle = timestep.to(torch.float32)[:, None] * frequency
        # cosines first, unlike Vaswani et al.
        sinusoid = torch.cat([torch.cos(angle), torch.sin(angle)], dim=-1)
        return self.linear_2(nn.functional.silu(self.linear_1(sinusoid)))


class OfficialDenoiser(nn.Module):
    """Noise prediction of one level."""

    def __init__(self, config: OfficialDenoiserConfig) -> None:
        super().__init__()
        self.config = config
        width, latent_width = config.width, config.latent_width
        if config.is_lifted:
            self.large_encoder_proj = nn.Sequential(nn.Linear(latent_width, width), nn.ReLU(), nn.Linear(width, width))
            self.large_decoder_proj = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, latent_width))
        else:
            self.large_encoder_proj = nn.Identity()
            self.large_decoder_proj = nn.Identity()
        self.time_embedding = TimeEmbedding(config.text_width, width)
        self.emb_proj = nn.Sequential(nn.ReLU(), nn.Linear(config.text_width, width))
        self.query_pos = PositionTable(width)
        self.mem_pos = PositionTable(width)  # in every checkpoint, and never used
        layer = (width, config.heads, config.feed_forward)
        self.encoder = PostNormSkipStack([PostNormEncoderLayer(*layer) for _ in range(config.layers)], width)

    def time(self, timestep: Tensor) -> Tensor:
        """Encode timesteps (k,) as tokens (k, d), positions included."""
        return self.time_embedding(timestep) + self.query_pos(self.config.tokens, 1)[0]

    def conditions(self, nodes: Tensor, coarse: Tensor | None) -> Tensor:
        """Project the conditions of a level to tokens, positions included; they are the same at every step.

        Args:
            nodes: (r, k, D) sentence, actions and specifics, as far as the level sees them.
            coarse: (r, n', z) latent of the level above; None at the coarsest.

        Returns:
            (r, s, d), the coarser latent first.
        """
        tokens = self.emb_proj(nodes)
        if coarse is not None:
            tokens = torch.cat([self.large_encoder_proj(coarse), tokens], dim=1)
        return tokens + self.query_pos(self.config.tokens + 1, tokens.shape[1])

    def forward(self, latent: Tensor, time: Tensor, condition: Tensor, mask: Tensor) -> Tensor:
        """Predict the noise.

        Args:
            latent: (r, n, z).
            time: (r, d) of `time`.
            condition: (r, s, d) of `conditions`.
            mask: (r, s) 1 on conditions that are there.

        Returns:
            (r, n, z).
        """
        tokens = self.config.tokens
        lifted = self.large_encoder_proj(latent) + self.query_pos(0, tokens)
        sequence = torch.cat([lifted, time[:, None], condition], dim=1)
        visible = torch.cat([torch.ones_like(mask[:, :1]).expand(-1, tokens + 1), mask], dim=1)
        return self.large_decoder_proj(self.encoder(sequence, visible)[:, :tokens])
