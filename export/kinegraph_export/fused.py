"""Replace modules by onnxruntime's fused operators, because its optimiser does not find attention in these graphs.

Each module here replaces a trained one in a copy for export, and emits the same function as one node. In torch it
returns zeros of the right shape, so exported graphs are compared with the trained module.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor, nn
from torch.onnx.ops import symbolic

from kinegraph_training.models.denoiser import AdaptiveNorm, CrossAttention, RowMixing
from kinegraph_training.models.transformer import SelfAttention

MICROSOFT = "com.microsoft"


def emit_node(operator: str, inputs: list[Tensor | None], like: Tensor, version: int, **attributes: Any) -> Tensor:
    """Emit one ONNX node whose output has the shape and type of `like`.

    Args:
        operator: `domain::OpType`, or an operator of ONNX itself.
        inputs: of the node; None for optional ones that are left out.
        like: a tensor of the output's shape and type.
        version: of the operator's domain.
        attributes: of the node.
    """
    return symbolic(operator, inputs, attributes, dtype=like.dtype, shape=like.shape, version=version)


class FusedSelfAttention(nn.Module):
    """Self-attention as `Attention`, which quantises to QAttention.

    With a bias it is `MultiHeadAttention`, because QAttention takes none.
    """

    def __init__(self, trained: SelfAttention) -> None:
        super().__init__()
        self.heads, self.qkv, self.out = trained.heads, trained.qkv, trained.out

    def forward(self, x: Tensor, bias: Tensor | None) -> Tensor:
        """Emit `SelfAttention.forward`: x (r, c, d), bias (r, 1, 1, c) or None -> (r, c, d)."""
        if bias is None:
            weights: list[Tensor | None] = [x, self.qkv.weight.t().contiguous(), self.qkv.bias]
            return self.out(emit_node(f"{MICROSOFT}::Attention", weights, x, 1, num_heads=self.heads))
        query, key, value = self.qkv(x).chunk(3, dim=-1)
        full = bias.expand(-1, -1, x.shape[1], -1)
        inputs: list[Tensor | None] = [query, key, value, None, None, full]
        return self.out(emit_node(f"{MICROSOFT}::MultiHeadAttention", inputs, x, 1, num_heads=self.heads))


class FusedCrossAttention(nn.Module):
    """Cross-attention as `MultiHeadAttention` over cached keys and values.

    Rows are mixed before the output projection, as in the trained module.
    """

    def __init__(self, trained: CrossAttention) -> None:
        super().__init__()
        self.heads, self.query, self.out = trained.heads, trained.query, trained.out

    def forward(self, x: Tensor, key: Tensor, value: Tensor, bias: Tensor, mixing: RowMixing) -> Tensor:
        """Emit `CrossAttention.forward`."""
        tokens, width = x.shape[1:]
        rows = x.new_empty(key.shape[0], tokens, width)
        query = emit_node("Gather", [self.query(x), mixing.src], rows, 13, axis=0)
        inputs: list[Tensor | None] = [query, key, value, None, None, bias]
        attended = emit_node(f"{MICROSOFT}::MultiHeadAttention", inputs, rows, 1, num_heads=self.heads)
        mixed = mixing.combine @ attended.reshape(-1, tokens * width)
        return self.out(mixed.reshape(-1, tokens, width))


class FusedNorm(nn.Module):
    """Adaptive LayerNorm as `LayerNormalization`, whose scale and shift may differ from row to row."""

    def __init__(self, trained: AdaptiveNorm) -> None:
        super().__init__()
        self.epsilon = trained.eps

    def forward(self, x: Tensor, scale: Tensor, shift: Tensor) -> Tensor:
        """Emit `AdaptiveNorm.forward`."""
        return emit_node("LayerNormalization", [x, scale, shift], x, 17, axis=-1, epsilon=self.epsilon)


FUSED_MODULES: dict[type[nn.Module], Callable[[Any], nn.Module]] = {
    SelfAttention: FusedSelfAttention,
    CrossAttention: FusedCrossAttention,
    AdaptiveNorm: FusedNorm,
}


@torch.no_grad()
def fuse_operators(
    module: nn.Module, replacements: Mapping[type[nn.Module], Callable[[Any], nn.Module]] = FUSED_MODULES
) -> nn.Module:
    """Copy a module for export, with fused operators in place of those that `replacements` name."""
    # parameters are shared: the released networks have a gigabyte of them
    fused = copy.deepcopy(module, {id(value): value for value in module.parameters()})
    for parent in list(fused.modules()):
        for name, child in list(parent.named_children()):
            if type(child) in replacements:
                setattr(parent, name, replacements[type(child)](child))
    return fused.eval()
