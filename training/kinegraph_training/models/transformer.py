"""Transformer blocks shared by the autoencoders, the denoisers and the evaluator.

Attention is written as matmul and softmax: for sequences this short it trains 1.5 times faster on a CPU than torch's
fused kernel, and it exports as it reads.

Shapes: b batch, s sequence, d width, h heads.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional


def split_heads(x: Tensor, heads: int) -> Tensor:
    """Split (b, s, d) into heads (b, h, s, d/h)."""
    batch, length, width = x.shape
    return x.reshape(batch, length, heads, width // heads).transpose(1, 2)


def merge_heads(x: Tensor) -> Tensor:
    """Merge heads (b, h, s, d/h) into (b, s, d)."""
    batch, heads, length, width = x.shape
    return x.transpose(1, 2).reshape(batch, length, heads * width)


def attend(query: Tensor, key: Tensor, value: Tensor, bias: Tensor | None) -> Tensor:
    """Compute softmax(q k^T / sqrt(d/h) + bias) v.

    Args:
        query: q, (b, h, queries, d/h).
        key: k, (b, h, keys, d/h).
        value: v, (b, h, keys, d/h).
        bias: broadcasts to (b, h, queries, keys); PADDING_BIAS hides a key.

    Returns:
        (b, h, queries, d/h).
    """
    scores = query @ key.transpose(-1, -2) * (1.0 / math.sqrt(query.shape[-1]))
    if bias is not None:
        scores = scores + bias
    return torch.softmax(scores, dim=-1) @ value


class SelfAttention(nn.Module):
    """Multi-head self-attention; `bias` is (b, 1, 1, s), 0 or PADDING_BIAS."""

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
    """Stack of layers with long skip connections, as in MLD.

    Of 2k or 2k + 1 layers, each of the last k reads the output of the layer before it beside that of its mirror image
    among the first k, projected from 2d to d.
    """

    def __init__(self, layers: list[nn.Module], width: int) -> None:
        super().__init__()
        self.layers = nn.ModuleList(layers)
        self.joins = nn.ModuleList(nn.Linear(2 * width, width) for _ in range(len(layers) // 2))
        self.norm = nn.LayerNorm(width)

    def join(self, index: int, x: Tensor, skips: list[Tensor]) -> Tensor:
        """Compute the input of layer `index` from the output before it and the outputs of the first half, a stack."""
        first = len(self.layers) - len(self.joins)
        if index < first:
            return x
        return self.joins[index - first](torch.cat([x, skips.pop()], dim=-1))

    def forward(self, x: Tensor, bias: Tensor | None) -> Tensor:
        skips: list[Tensor] = []
        for index, layer in enumerate(self.layers):
            x = layer(self.join(index, x, skips), bias)
            if index < len(self.layers) // 2:
                skips.append(x)
        return self.norm(x)


def sinusoid(position: Tensor, width: int) -> Tensor:
    """Encode real positions (...,) as (..., width): sines, then cosines (Vaswani et al., 2017)."""
    half = width // 2
    frequency = torch.exp(torch.arange(half, device=position.device) * (-math.log(10000.0) / half))
    angle = position[..., None] * frequency
    return torch.cat([torch.sin(angle), torch.cos(angle)], dim=-1)


def smooth_l1(difference: Tensor, beta: float = 1.0) -> Tensor:
    """Compute SmoothL1 of each element of a difference."""
    return functional.smooth_l1_loss(difference, torch.zeros_like(difference), beta=beta, reduction="none")
