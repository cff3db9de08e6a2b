"""Transformer blocks of the released GraphMotion and MLD, with the parameter names of their checkpoints.

Post-norm layers in a stack with skip connections. Attention is written plainly, so that exporting may replace it by
onnxruntime's own operator (`official.graphs.FUSED`).

Shapes: b batch, s sequence, m memory, d width, h heads.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from kinegraph.bundle.contract import PADDING_BIAS
from kinegraph_training.models.transformer import attend, merge_heads, split_heads

POSITIONS = 500
"""Rows of every table of positions."""


class PackedAttention(nn.Module):
    """Multi-head attention whose projections of query, key and value are rows of one matrix, in that order."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.in_proj_weight = nn.Parameter(torch.empty(3 * width, width))
        self.in_proj_bias = nn.Parameter(torch.empty(3 * width))
        self.out_proj = nn.Linear(width, width)

    def attend(self, query: Tensor, key: Tensor, value: Tensor, mask: Tensor | None) -> Tensor:
        """Split projected (b, s, d), (b, m, d), (b, m, d) into heads, attend and project; mask (b, m) is 1 on keys."""
        bias = None if mask is None else ((1.0 - mask) * PADDING_BIAS)[:, None, None, :]
        heads = (split_heads(part, self.heads) for part in (query, key, value))
        return self.out_proj(merge_heads(attend(*heads, bias)))


class PackedSelfAttention(PackedAttention):
    """Attention of a sequence to itself."""

    def forward(self, x: Tensor, mask: Tensor | None) -> Tensor:
        """Attend: x (b, s, d), mask (b, s) 1 on visible tokens or None -> (b, s, d)."""
        projected = functional.linear(x, self.in_proj_weight, self.in_proj_bias)
        return self.attend(*projected.chunk(3, dim=-1), mask)


class PackedCrossAttention(PackedAttention):
    """Attention of a sequence to a memory."""

    def forward(self, x: Tensor, memory: Tensor) -> Tensor:
        """Attend: x (b, s, d), memory (b, m, d) -> (b, s, d)."""
        weights, biases = self.in_proj_weight.chunk(3), self.in_proj_bias.chunk(3)
        query = functional.linear(x, weights[0], biases[0])
        key, value = (functional.linear(memory, weights[part], biases[part]) for part in (1, 2))
        return self.attend(query, key, value, None)


class PostNormEncoderLayer(nn.Module):
    """Self-attention and feed-forward (exact GELU), each added and then normalised."""

    def __init__(self, width: int, heads: int, feed_forward: int) -> None:
        super().__init__()
        self.self_attn = PackedSelfAttention(width, heads)
        self.linear1 = nn.Linear(width, feed_forward)
        self.linear2 = nn.Linear(feed_forward, width)
        self.norm1 = nn.LayerNorm(width)
        self.norm2 = nn.LayerNorm(width)

    def forward(self, x: Tensor, mask: Tensor | None) -> Tensor:
        """Transform x (b, s, d); mask (b, s) is 1 on visible tokens."""
        x = self.norm1(x + self.self_attn(x, mask))
        return self.norm2(x + self.linear2(functional.gelu(self.linear1(x))))


class PostNormDecoderLayer(nn.Module):
    """Self-attention, cross-attention to a memory and feed-forward, each added and then normalised."""

    def __init__(self, width: int, heads: int, feed_forward: int) -> None:
        super().__init__()
        self.self_attn = PackedSelfAttention(width, heads)
        self.multihead_attn = PackedCrossAttention(width, heads)
        self.linear1 = nn.Linear(width, feed_forward)
        self.linear2 = nn.Linear(feed_forward, width)
        self.norm1 = nn.LayerNorm(width)
        self.norm2 = nn.LayerNorm(width)
        self.norm3 = nn.LayerNorm(width)

    def forward(self, x: Tensor, mask: Tensor, memory: Tensor) -> Tensor:
        """Transform x (b, s, d); mask (b, s) is 1 on visible tokens, memory (b, m, d) is visible throughout."""
        x = self.norm1(x + self.self_attn(x, mask))
        x = self.norm2(x + self.multihead_attn(x, memory))
        return self.norm3(x + self.linear2(functional.gelu(self.linear1(x))))


class PostNormSkipStack(nn.Module):
    """2k + 1 layers: the last k read the output before them beside that of their mirror image among the first k."""

    def __init__(self, layers: list[nn.Module], width: int) -> None:
        super().__init__()
        half = len(layers) // 2
        self.input_blocks = nn.ModuleList(layers[:half])
        self.middle_block = layers[half]
        self.output_blocks = nn.ModuleList(layers[half + 1 :])
        self.linear_blocks = nn.ModuleList(nn.Linear(2 * width, width) for _ in range(half))
        self.norm = nn.LayerNorm(width)

    def forward(self, x: Tensor, *others: Tensor | None) -> Tensor:
        """Run all layers on x (b, s, d); the other arguments go to each of them."""
        skips = []
        for block in self.input_blocks:
            x = block(x, *others)
            skips.append(x)
        x = self.middle_block(x, *others)
        for join, block in zip(self.linear_blocks, self.output_blocks, strict=True):
            x = block(join(torch.cat([x, skips.pop()], dim=-1)), *others)
        return self.norm(x)


class PositionTable(nn.Module):
    """Learned vectors that are added to the tokens of a sequence."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.pe = nn.Parameter(torch.empty(POSITIONS, 1, width))

    def forward(self, first: int, count: int) -> Tensor:
        """Return the vectors (count, d) of `count` tokens, from token `first` on."""
        return self.pe[first : first + count, 0]
