"""onnxruntime's fused operators, emitted on purpose: its optimiser does not find attention in these graphs.

A module here takes the place of the trained one that it is made from and emits the same function in one node. In torch
it returns zeros of the right shape, so exported graphs are compared with the trained module.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn
from torch.onnx.ops import symbolic

from kinegraph_training.models.denoiser import AdaptiveNorm, CrossAttention, RowMixing
from kinegraph_training.models.transformer import SelfAttention

MICROSOFT = "com.microsoft"


def emitted(operator: str, inputs: list[Tensor | None], like: Tensor, version: int, **attributes: Any) -> Tensor:
    """One node whose output has the shape and type of `like`."""
    return symbolic(operator, inputs, attributes, dtype=like.dtype, shape=like.shape, version=version)


class FusedSelfAttention(nn.Module):
    """`Attention`, which quantises to QAttention; with a bias `MultiHeadAttention`, because QAttention takes none."""

    def __init__(self, trained: SelfAttention) -> None:
        super().__init__()
        self.heads, self.qkv, self.out = trained.heads, trained.qkv, trained.out

    def forward(self, x: Tensor, bias: Tensor | None) -> Tensor:
        """As `SelfAttention`."""
        if bias is None:
            weights: list[Tensor | None] = [x, self.qkv.weight.t().contiguous(), self.qkv.bias]
            return self.out(emitted(f"{MICROSOFT}::Attention", weights, x, 1, num_heads=self.heads))
        query, key, value = self.qkv(x).chunk(3, dim=-1)
        full = bias.expand(-1, -1, x.shape[1], -1)
        inputs: list[Tensor | None] = [query, key, value, None, None, full]
        return self.out(emitted(f"{MICROSOFT}::MultiHeadAttention", inputs, x, 1, num_heads=self.heads))


class FusedCrossAttention(nn.Module):
    """`MultiHeadAttention` over cached keys and values; rows are mixed before the output projection, as trained."""

    def __init__(self, trained: CrossAttention) -> None:
        super().__init__()
        self.heads, self.query, self.out = trained.heads, trained.query, trained.out

    def forward(self, x: Tensor, key: Tensor, value: Tensor, bias: Tensor, mixing: RowMixing) -> Tensor:
        """As `CrossAttention`."""
        tokens, width = x.shape[1:]
        rows = x.new_empty(key.shape[0], tokens, width)
        query = emitted("Gather", [self.query(x), mixing.src], rows, 13, axis=0)
        inputs: list[Tensor | None] = [query, key, value, None, None, bias]
        attended = emitted(f"{MICROSOFT}::MultiHeadAttention", inputs, rows, 1, num_heads=self.heads)
        mixed = mixing.combine @ attended.reshape(-1, tokens * width)
        return self.out(mixed.reshape(-1, tokens, width))


class FusedNorm(nn.Module):
    """`LayerNormalization`, whose scale and shift may differ from row to row."""

    def __init__(self, trained: AdaptiveNorm) -> None:
        super().__init__()
        self.epsilon = trained.eps

    def forward(self, x: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
        """As `AdaptiveNorm`."""
        return emitted("LayerNormalization", [x, scale, shift], x, 17, axis=-1, epsilon=self.epsilon)


FUSED: dict[type[nn.Module], Callable[[Any], nn.Module]] = {
    SelfAttention: FusedSelfAttention,
    CrossAttention: FusedCrossAttention,
    AdaptiveNorm: FusedNorm,
}


@torch.no_grad()
def fused(module: nn.Module) -> nn.Module:
    """A copy for export."""
    found = copy.deepcopy(module)
    for parent in list(found.modules()):
        for name, child in list(parent.named_children()):
            if type(child) in FUSED:
                setattr(parent, name, FUSED[type(child)](child))
    return found.eval()
