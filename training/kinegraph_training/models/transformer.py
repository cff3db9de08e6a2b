"""Transformer blocks shared by the autoencoders and the denoisers.

Legend of shapes: b batch, s sequence, c latent tokens, d width, h heads. Attention is written as matmul and softmax:
for sequences this short it is 1.5 times faster to train on a CPU than torch's fused kernel, and it exports as it reads.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

MASKED = -1e4
"""Additive bias of what must not be attended to; finite, so that a row of them is not NaN."""


def split_heads(x: Tensor, heads: int) -> Tensor:
    """(b, s, d) -> (b, h, s, d/h)."""
    batch, length, width = x.shape
    return x.reshape(batch, length, heads, width // heads).transpose(1, 2)


def merge_heads(x: Tensor) -> Tensor:
    """(b, h, s, d/h) -> (b, s, d)."""
    batch, heads, length, width = x.shape
    return x.transpose(1, 2).reshape(batch, length, heads * width)


def attend(query: Tensor, key: Tensor, value: Tensor, bias: Tensor | None) -> Tensor:
    """softmax(q k^T / sqrt(d/h) + bias) v, all (b, h, s, d/h); bias broadcasts to (b, h, queries, keys)."""
    scores = query @ key.transpose(-1, -2) * (1.0 / math.sqrt(query.shape[-1]))
    if bias is not None:
        scores = scores + bias
    return torch.softmax(scores, dim=-1) @ value


class SelfAttention(nn.Module):
    """Multi-head self-attention; `bias` is (b, 1, 1, s), 0 or MASKED."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)

    def forward(self, x: Tensor, bias: Tensor | None) -> Tensor:
        query, key, value = (split_heads(part, self.heads) for part in self.qkv(x).chunk(3, dim=-1))
        return self.out(merge_heads(attend(query, key, value, bias)))


class FeedForward(nn.Sequential):
    """Linear, exact GELU, linear."""

    def __init__(self, width: int, hidden: int) -> None:
        super().__init__(nn.Linear(width, hidden), nn.GELU(), nn.Linear(hidden, width))


class EncoderLayer(nn.Module):
    """Pre-norm self-attention and feed-forward."""

    def __init__(self, width: int, heads: int, hidden: int, dropout: float) -> None:
        super().__init__()
        self.norm_self = nn.LayerNorm(width)
        self.self_attention = SelfAttention(width, heads)
        self.norm_feed = nn.LayerNorm(width)
        self.feed = FeedForward(width, hidden)
        self.dropout = nn.Dropout(dropout)

    def forward(self, x: Tensor, bias: Tensor | None) -> Tensor:
        x = x + self.dropout(self.self_attention(self.norm_self(x), bias))
        return x + self.dropout(self.feed(self.norm_feed(x)))


class SkipStack(nn.Module):
    """Long skip connections as in MLD: layers 0..k-1, a middle one, and k more that each take, projected
    from 2d to d, the output of its mirror image. The number of layers is odd."""

    def __init__(self, layers: list[nn.Module], width: int) -> None:
        super().__init__()
        if len(layers) % 2 == 0:
            raise ValueError(f"a skip stack needs an odd number of layers, not {len(layers)}")
        self.layers = nn.ModuleList(layers)
        self.joins = nn.ModuleList(nn.Linear(2 * width, width) for _ in range(len(layers) // 2))
        self.norm = nn.LayerNorm(width)

    def join(self, index: int, x: Tensor, kept: list[Tensor]) -> Tensor:
        """What layer `index` reads, given the outputs kept from the first half."""
        half = len(self.layers) // 2
        if index <= half:
            return x
        return self.joins[index - half - 1](torch.cat([x, kept.pop()], dim=-1))

    def forward(self, x: Tensor, bias: Tensor | None) -> Tensor:
        kept: list[Tensor] = []
        for index, layer in enumerate(self.layers):
            x = layer(self.join(index, x, kept), bias)
            if index < len(self.layers) // 2:
                kept.append(x)
        return self.norm(x)


def sinusoid(position: Tensor, width: int) -> Tensor:
    """(...,) real positions -> (..., width): sine half, then cosine half (Vaswani et al., 2017)."""
    half = width // 2
    frequency = torch.exp(torch.arange(half, device=position.device) * (-math.log(10000.0) / half))
    angle = position[..., None] * frequency
    return torch.cat([torch.sin(angle), torch.cos(angle)], dim=-1)


def smooth_l1(difference: Tensor, beta: float = 1.0) -> Tensor:
    """Element-wise SmoothL1 of a difference."""
    return functional.smooth_l1_loss(difference, torch.zeros_like(difference), beta=beta, reduction="none")
