"""TMR's encoders of motions and captions (Petrovich et al., ICCV 2023), with the parameter names of its checkpoints.

Both are the encoder of ACTOR (Petrovich et al., 2021): a linear layer, two learned tokens before the sequence (mean and
log-variance; one token without them), sines added to all of it, post-norm layers. The first token becomes the
embedding. A caption comes as DistilBERT's states of all its word pieces.

Shapes: b sequences, s tokens, d width, l frames, t word pieces, F = 263 features.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor, nn

from kinegraph.errors import InvalidInputError
from kinegraph_export.official.distilbert import DistilBert
from kinegraph_export.official.transformer import PostNormEncoderLayer

MOTION, TEXT = "motion_encoder", "text_encoder"
"""First parts of the names, and names of the files that TMR splits a checkpoint into."""
FEATURES: Final = 263
RELEASED: Final = "tmr_humanml3d_guoh3dfeats"
"""The published model of these features."""
_POSITIONS: Final = "sequence_pos_encoding.pe"
"""A table of sines that some checkpoints hold."""


@dataclass(frozen=True)
class SequenceEncoderConfig:
    """Shape of one encoder."""

    features: int
    width: int
    layers: int
    heads: int
    feed_forward: int
    tokens: int
    """Learned tokens: 2 with a variance, 1 without."""


class SequenceEncoder(nn.Module):
    """Encoder of a sequence to one vector, without the drawing that it was trained with."""

    def __init__(self, config: SequenceEncoderConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.projection = nn.Linear(config.features, width)
        self.tokens = nn.Parameter(torch.empty(config.tokens, width))
        layers = (PostNormEncoderLayer(width, config.heads, config.feed_forward) for _ in range(config.layers))
        self.seqTransEncoder = nn.ModuleDict({"layers": nn.ModuleList(layers)})
        rates = torch.exp(torch.arange(0, width, 2).float() * (-math.log(10_000.0) / width))
        self.register_buffer("rates", rates, persistent=False)

    def forward(self, x: Tensor, mask: Tensor) -> Tensor:
        """Encode x (b, s, features), where mask (b, s) is 1: (b, d)."""
        count = len(self.tokens)
        x = torch.cat([self.tokens.expand(len(x), -1, -1), self.projection(x)], dim=1)
        mask = torch.cat([torch.ones_like(mask[:, :1]).expand(-1, count), mask], dim=1)
        # sin and cos of each rate in turn, by the place in the sequence, tokens included
        angles = (torch.cumsum(torch.ones_like(x[0, :, :1]), dim=0) - 1.0) * self.rates
        x = x + torch.stack([angles.sin(), angles.cos()], dim=-1).flatten(-2)
        for layer in self.seqTransEncoder["layers"]:
            x = layer(x, mask)
        return x[:, 0]


class MotionEmbedding(nn.Module):
    """TMR's motion encoder with the normalisation of its features, mean and deviation (F,)."""

    def __init__(self, encoder: SequenceEncoder, mean: Tensor, deviation: Tensor) -> None:
        super().__init__()
        self.encoder = encoder
        self.register_buffer("mean", mean)
        self.register_buffer("deviation", deviation)

    def forward(self, features: Tensor, lengths: Tensor) -> Tensor:
        """Embed features (b, l, F), not normalised, of which the first lengths (b,) count: (b, d)."""
        normalised = (features - self.mean) / self.deviation
        frame = torch.cumsum(torch.ones_like(normalised[:, :, 0]), dim=1)
        return self.encoder(normalised, (frame <= lengths[:, None]).to(normalised.dtype))


class TextEmbedding(nn.Module):
    """TMR's text encoder on DistilBERT."""

    def __init__(self, words: DistilBert, encoder: SequenceEncoder) -> None:
        super().__init__()
        self.words, self.encoder = words, encoder

    def forward(self, input_ids: Tensor, attention_mask: Tensor) -> Tensor:
        """Embed word pieces (b, t), those where the mask (b, t) is 1: (b, d)."""
        states = self.words(input_ids, attention_mask)
        return self.encoder(states, attention_mask.to(states.dtype))


def without_tables(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Leave out the tables of sines, which are computed."""
    return {name: value for name, value in tensors.items() if not name.endswith(_POSITIONS)}


def build_encoder(tensors: Mapping[str, Tensor], part: str, heads: int) -> SequenceEncoder:
    """Build the encoder whose shape the tensors of a part have; its weights are not loaded.

    Args:
        tensors: by name.
        part: `MOTION` or `TEXT`.
        heads: of every layer; not in a checkpoint.

    Raises:
        InvalidInputError: the tensors are of something else, or the heads do not divide the width.
    """
    names = [f"{part}.{name}" for name in ("projection.weight", "tokens", "seqTransEncoder.layers.0.linear1.weight")]
    for name in names:
        if name not in tensors or tensors[name].ndim != 2:
            raise InvalidInputError(
                f"the checkpoint has no {name}: it is no TMR; bring last.ckpt of {RELEASED}, or the "
                f"folder last_weights with {MOTION}.pt and {TEXT}.pt"
            )
    (width, features), (tokens, _), (feed_forward, _) = (tensors[name].shape for name in names)
    if heads < 1 or width % heads or width % 2:
        raise InvalidInputError(f"{heads} heads do not divide the width {width} of {part}; the released models have 4")
    start = f"{part}.seqTransEncoder.layers."
    layers = len({name.split(".")[3] for name in tensors if name.startswith(start)})
    return SequenceEncoder(SequenceEncoderConfig(features, width, layers, heads, feed_forward, tokens))
