"""Motion and text encoders into one joint space, after Guo et al. (2022) and TMR (Petrovich et al., 2023).

They measure generated motion, are trained apart from the generator, and are no part of a bundle. Shapes: b clips or
captions, l frames, s tokens, f features, e joint width.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from kinegraph.bundle.contract import PADDING_BIAS
from kinegraph_training.models.transformer import EncoderLayer, sinusoid


@dataclass(frozen=True)
class EvaluatorConfig:
    """Shape of both encoders."""

    features: int = 137
    text_width: int = 384
    joint_width: int = 64
    """At most 64: the covariance of a few hundred clips must not be singular (FID)."""
    width: int = 160
    motion_layers: int = 4
    text_layers: int = 2
    heads: int = 4
    feed_forward: int = 320
    dropout: float = 0.1
    frames_per_token: int = 4


class SequenceEncoder(nn.Module):
    """Transformer over tokens with sinusoidal positions; the mean over real tokens becomes a unit vector."""

    def __init__(self, config: EvaluatorConfig, token_width: int, layers: int) -> None:
        super().__init__()
        self.width = config.width
        self.token_in = nn.Linear(token_width, config.width)
        layer = (config.width, config.heads, config.feed_forward, config.dropout)
        self.layers = nn.ModuleList(EncoderLayer(*layer) for _ in range(layers))
        self.norm = nn.LayerNorm(config.width)
        self.out = nn.Linear(config.width, config.joint_width)

    def forward(self, tokens: Tensor, mask: Tensor) -> Tensor:
        """Encode tokens (b, s, token_width) with mask (b, s), 1 for real ones, to (b, e) of unit length."""
        position = torch.cumsum(torch.ones_like(mask), dim=1) - 1.0
        x = self.token_in(tokens) + sinusoid(position, self.width)
        bias = ((1.0 - mask) * PADDING_BIAS)[:, None, None, :]
        for layer in self.layers:
            x = layer(x, bias)
        pooled = (self.norm(x) * mask[..., None]).sum(dim=1) / mask.sum(dim=1, keepdim=True).clamp(min=1.0)
        return functional.normalize(self.out(pooled), dim=-1)


class MotionEncoder(SequenceEncoder):
    """Encoder of motion; its tokens are groups of frames."""

    def __init__(self, config: EvaluatorConfig) -> None:
        super().__init__(config, config.features * config.frames_per_token, config.motion_layers)
        self.group = config.frames_per_token

    def forward(self, features: Tensor, frame_mask: Tensor) -> Tensor:
        """Encode normalised features (b, l, f) with mask (b, l), l a multiple of the group, to (b, e)."""
        batch, frames, width = features.shape
        tokens = (features * frame_mask[..., None]).reshape(batch, frames // self.group, self.group * width)
        return super().forward(tokens, frame_mask[:, :: self.group])


class TextEncoder(SequenceEncoder):
    """Encoder of captions; its tokens are the hidden states of the frozen text encoder."""

    def __init__(self, config: EvaluatorConfig) -> None:
        super().__init__(config, config.text_width, config.text_layers)


def contrastive_loss(motion: Tensor, text: Tensor, same: Tensor, temperature: float) -> Tensor:
    """Compute symmetric InfoNCE (TMR, Eq. 3-4) without false negatives.

    Args:
        motion: (b, e) unit vectors.
        text: (b, e), row i describes motion i.
        same: (b, b) True where caption j, of another clip, describes motion i too.
        temperature: of the softmax.
    """
    scores = motion @ text.T / temperature
    diagonal = torch.eye(len(scores), dtype=torch.bool, device=scores.device)
    scores = scores.masked_fill(same & ~diagonal, PADDING_BIAS)
    target = torch.arange(len(scores), device=scores.device)
    return 0.5 * (functional.cross_entropy(scores, target) + functional.cross_entropy(scores.T, target))
