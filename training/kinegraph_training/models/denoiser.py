"""Cross-attention denoisers of the three levels (GraphMotion, section 3.2; cross-attention as in EnergyMoGen).

A denoiser is split by how often its parts run. `ContextEncoder` computes the keys and values of every layer once per
sample, `AdaLNModulation` runs once for all diffusion steps, `NoisePredictor` at every step, on the latent tokens alone.

Shapes: r latent rows, a attention rows (r = a in training), c latent tokens, z latent width, n nodes, s context
tokens, d width, h heads, m modulations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from kinegraph.bundle.contract import KINDS, LEVELS, MODULATIONS, NODE_KINDS, NULL_KIND, PARTIAL_KIND
from kinegraph.errors import InvalidInputError
from kinegraph_training.models.transformer import (
    EncoderLayer,
    FeedForward,
    SelfAttention,
    SkipStack,
    attend,
    merge_heads,
    sinusoid,
    split_heads,
)

KeyValue = list[tuple[Tensor, Tensor]]


@dataclass(frozen=True)
class DenoiserConfig:
    """Shape of the denoisers and of the graph encoder."""

    width: int
    layers: int
    heads: int
    feed_forward: int
    text_width: int = 384
    dropout: float = 0.1
    train_steps: int = 1000
    max_frames: int = 196
    max_order: int = 16
    """Number of embeddings for the order of actions; later actions share the last."""
    kind: str = "cross"
    """"cross": cross-attention to the conditions; "frames": the same on the motion features themselves; "concat": one
    sequence with the latent, GraphMotion as published (for comparison, cannot be exported)."""
    condition: str = "graph"
    """Conditions: the semantic "graph", the "tokens" of the caption, or the "sentence" alone (as in MLD)."""
    reasoning: bool = True
    """Whether graph attention (GraphMotion, Eq. 1-3) runs over the nodes first."""
    nodes_seen: str = "level"
    """Nodes of the graph that a level attends to: those of its "level" and the coarser ones, or "all"."""
    words: bool = False
    """Whether the words of the caption stand beside the nodes, at every level."""
    context_layers: int = 0
    """Layers of self-attention among the context tokens, once per sample; as wide as the denoiser."""
    levels: tuple[str, ...] = LEVELS
    """Coarse to fine; ("specific",) alone is one-stage latent diffusion."""
    frames_per_token: int = 1
    """Frames of a token in skeleton space."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "levels", tuple(self.levels))
        choices = {
            "kind": ("cross", "frames", "concat"),
            "condition": ("graph", "tokens", "sentence"),
            "nodes_seen": ("level", "all"),
        }
        for name, allowed in choices.items():
            if getattr(self, name) not in allowed:
                raise InvalidInputError(f"{name} must be one of {', '.join(allowed)}, not {getattr(self, name)!r}")
        known = [level for level in LEVELS if level in self.levels]
        if not self.levels or self.levels[-1] != LEVELS[-1] or self.levels != tuple(known):
            raise InvalidInputError(f"levels must be some of {', '.join(LEVELS)}, in order, up to the last one")

    def kinds_seen(self, level: str) -> tuple[str, ...]:
        """Return the kinds of tokens that a level sees, see `contract.NODE_KINDS`.

        All tokens of a caption without a graph are of the motion kind.
        """
        if self.condition != "graph":
            return NODE_KINDS[:1]
        nodes = NODE_KINDS[:3] if self.nodes_seen == "all" else NODE_KINDS[: LEVELS.index(level) + 1]
        return (*nodes, "word") if self.words else nodes


@dataclass(frozen=True)
class LatentShape:
    """Shape of the latent of one level."""

    tokens: int
    width: int


@dataclass(frozen=True)
class RowMixing:
    """Mapping between latent rows and attention rows of a composition; None in training, where they are the same."""

    src: Tensor
    """(a,) index of the latent row that each attention row reads."""
    combine: Tensor
    """(r, a) coefficients that combine attention outputs into latent rows."""


class ContextTokens(nn.Module):
    """Embedding of nodes, words and the coarser latent as tokens of model width that have seen one another."""

    def __init__(self, config: DenoiserConfig, coarse: LatentShape | None) -> None:
        super().__init__()
        width = config.width
        self.last_order = config.max_order - 1
        self.node_in = nn.Linear(config.text_width, width)
        self.kind = nn.Embedding(len(KINDS), width)
        self.order = nn.Embedding(config.max_order, width)
        self.coarse_in = nn.Linear(coarse.width, width) if coarse else None
        self.coarse_position = nn.Parameter(torch.randn(coarse.tokens, width) * 0.02) if coarse else None
        self.norm = nn.LayerNorm(width)
        self.mixing = nn.ModuleList(
            EncoderLayer(width, config.heads, 2 * width, config.dropout) for _ in range(config.context_layers)
        )
        for layer in self.mixing:
            # A new layer changes nothing, so that training may start from weights without it.
            for out in (layer.self_attention.out, layer.feed[-1]):
                nn.init.zeros_(out.weight)
                nn.init.zeros_(out.bias)

    def forward(self, nodes: Tensor, kind: Tensor, order: Tensor, bias: Tensor, coarse: Tensor | None = None) -> Tensor:
        """Embed nodes, words and the coarser latent, and let them attend to one another.

        Tokens of kind NULL_KIND and PARTIAL_KIND are learned, whatever their features.

        Args:
            nodes: (a, n, D).
            kind: (a, n).
            order: (a, n).
            bias: (a, s) log path weight of every token; PADDING_BIAS hides one, as in the denoiser's own attention.
            coarse: (a, c', z) latent of the level above; None at the first level.

        Returns:
            (a, s, d).
        """
        has_text = ((kind != NULL_KIND) & (kind != PARTIAL_KIND)).to(nodes.dtype)[..., None]
        context = self.node_in(nodes) * has_text + self.kind(kind)
        context = context + self.order(order.clamp(max=self.last_order)) * has_text
        if self.coarse_in is not None:
            context = torch.cat([context, self.coarse_in(coarse) + self.coarse_position], dim=1)
        context = self.norm(context)
        for layer in self.mixing:
            context = layer(context, bias[:, None, None, :])
        return context


class ContextEncoder(ContextTokens):
    """Projection of the context tokens to the keys and values of every layer."""

    def __init__(self, config: DenoiserConfig, coarse: LatentShape | None) -> None:
        super().__init__(config, coarse)
        self.heads = config.heads
        self.key_value = nn.ModuleList(nn.Linear(config.width, 2 * config.width) for _ in range(config.layers))

    def forward(  # type: ignore[override]
        self, nodes: Tensor, kind: Tensor, order: Tensor, bias: Tensor, coarse: Tensor | None = None
    ) -> KeyValue:
        """Compute key and value (a, h, s, d/h) of every layer; arguments as in `ContextTokens.forward`."""
        context = super().forward(nodes, kind, order, bias, coarse)
        pairs = (layer(context).chunk(2, dim=-1) for layer in self.key_value)
        return [(split_heads(key, self.heads), split_heads(value, self.heads)) for key, value in pairs]


class TimestepLengthEmbedding(nn.Module):
    """Sum of the embeddings of the diffusion timestep and of the clip's length.

    A denoiser that does not know the length of the clip makes time-warped motion.
    """

    def __init__(self, config: DenoiserConfig) -> None:
        super().__init__()
        self.width = config.width
        self.time, self.length = (
            nn.Sequential(nn.Linear(config.width, config.width), nn.SiLU(), nn.Linear(config.width, config.width))
            for _ in range(2)
        )

    def forward(self, step: Tensor, frames: Tensor) -> Tensor:
        """Embed timesteps and frames, of shapes that broadcast to (...,), as (..., d)."""
        return self.time(sinusoid(step.float(), self.width)) + self.length(sinusoid(frames.float(), self.width))


class AdaLNModulation(TimestepLengthEmbedding):
    """Adaptive LayerNorm (Peebles & Xie, 2023): scale and shift of every normalisation, from timestep and length."""

    def __init__(self, config: DenoiserConfig) -> None:
        super().__init__(config)
        self.out = nn.Linear(config.width, config.layers * MODULATIONS * config.width)
        nn.init.zeros_(self.out.weight)
        start = torch.zeros(config.layers, MODULATIONS // 2, 2, config.width)
        start[:, :, 0] = 1.0
        self.out.bias = nn.Parameter(start.flatten())

    def forward(self, step: Tensor, frames: Tensor) -> Tensor:
        """Compute (..., m, d), m = layers x MODULATIONS; arguments as in `TimestepLengthEmbedding.forward`."""
        modulation = self.out(nn.functional.silu(super().forward(step, frames)))
        return modulation.unflatten(-1, (-1, self.width))


class CrossAttention(nn.Module):
    """Attention of latent tokens to a context, given as keys and values.

    In a composition, attention rows are combined *before* the output projection, inside every layer (z' of EnergyMoGen,
    Eq. 9).
    """

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.query = nn.Linear(width, width)
        self.out = nn.Linear(width, width)

    def forward(self, x: Tensor, key: Tensor, value: Tensor, bias: Tensor, mixing: RowMixing | None) -> Tensor:
        return self.combine_rows(attend(self.queries(x, mixing), key, value, bias), mixing)

    def queries(self, x: Tensor, mixing: RowMixing | None) -> Tensor:
        """Project (r, c, d) to queries (a, h, c, d/h)."""
        query = split_heads(self.query(x), self.heads)
        return query if mixing is None else query[mixing.src]

    def combine_rows(self, attended: Tensor, mixing: RowMixing | None) -> Tensor:
        """Combine attention outputs (a, h, c, d/h) into latent rows, and project them: (r, c, d)."""
        merged = merge_heads(attended)
        if mixing is None:
            return self.out(merged)
        rows, tokens, width = merged.shape
        return self.out((mixing.combine @ merged.reshape(rows, tokens * width)).reshape(-1, tokens, width))


class AdaptiveNorm(nn.LayerNorm):
    """LayerNorm with scale and shift from `AdaLNModulation`."""

    def __init__(self, width: int) -> None:
        super().__init__(width, elementwise_affine=False)

    def forward(self, x: Tensor, scale: Tensor, shift: Tensor) -> Tensor:  # type: ignore[override]
        """Normalise x (r, c, d) with scale and shift (r, 1, d)."""
        return super().forward(x) * scale + shift


class DenoiserLayer(nn.Module):
    """Pre-norm self-attention over latent tokens, cross-attention to the context, feed-forward."""

    def __init__(self, config: DenoiserConfig) -> None:
        super().__init__()
        self.norm = AdaptiveNorm(config.width)
        self.self_attention = SelfAttention(config.width, config.heads)
        self.cross_attention = CrossAttention(config.width, config.heads)
        self.feed = FeedForward(config.width, config.feed_forward)
        self.dropout = nn.Dropout(config.dropout)

    def forward(
        self,
        x: Tensor,
        modulation: Sequence[Tensor],
        pair: tuple[Any, ...],
        bias: Tensor,
        mixing: RowMixing | None,
        padding: Tensor | None = None,
    ) -> Tensor:
        """Run the layer on x (r, c, d).

        Args:
            x: latent tokens.
            modulation: scale and shift of the three normalisations, (r, 1, d) each.
            pair: key and value of the context; with AGD, the context that the layer projects itself.
            bias: (a, 1, 1 or c, s) of the context.
            mixing: rows of a composition.
            padding: bias of the self-attention, (r, 1, 1, c); None where all latent tokens are seen.
        """
        scale_self, shift_self, scale_cross, shift_cross, scale_feed, shift_feed = modulation
        x = x + self.dropout(self.self_attention(self.norm(x, scale_self, shift_self), padding))
        x = x + self.dropout(self.cross_attention(self.norm(x, scale_cross, shift_cross), *pair, bias, mixing))
        return x + self.dropout(self.feed(self.norm(x, scale_feed, shift_feed)))


class NoisePredictor(SkipStack):
    """Predictor of the noise in a latent at one diffusion step."""

    def __init__(self, config: DenoiserConfig, latent: LatentShape) -> None:
        super().__init__([DenoiserLayer(config) for _ in range(config.layers)], config.width)
        self.latent_in = nn.Linear(latent.width, config.width)
        self.position = nn.Parameter(torch.randn(latent.tokens, config.width) * 0.02)
        self.noise_out = nn.Linear(config.width, latent.width)

    def embed(self, latent: Tensor) -> Tensor:
        """Embed latent tokens (r, c, z) at the width of the network, (r, c, d)."""
        return self.latent_in(latent) + self.position

    def forward(  # type: ignore[override]
        self,
        latent: Tensor,
        modulation: Tensor,
        context: Sequence[tuple[Any, ...]],
        bias: Tensor,
        mixing: RowMixing | None = None,
        padding: Tensor | None = None,
    ) -> Tensor:
        """Predict the noise.

        Args:
            latent: z_t, (r, c, z).
            modulation: (r, m, d) of `AdaLNModulation`.
            context: per layer key and value (a, h, s, d/h).
            bias: (a, 1, 1 or c, s) of the context.
            mixing: rows of a composition.
            padding: (r, 1, 1, c) bias that hides latent tokens from one another; None where all are seen.

        Returns:
            eps', (r, c, z).
        """
        x = self.embed(latent)
        rows = modulation.split(1, dim=1)
        skips: list[Tensor] = []
        for index, (layer, pair) in enumerate(zip(self.layers, context, strict=True)):
            layer_modulation = rows[MODULATIONS * index : MODULATIONS * (index + 1)]
            x = layer(self.join(index, x, skips), layer_modulation, pair, bias, mixing, padding)
            if index < len(self.layers) // 2:
                skips.append(x)
        return self.read_out(x, padding)

    def read_out(self, x: Tensor, padding: Tensor | None) -> Tensor:
        """Read the prediction (r, c, z) off the last layer's tokens (r, c, d); padding as in `forward`."""
        return self.noise_out(self.norm(x))


class Denoiser(nn.Module):
    """Denoiser of one level."""

    def __init__(self, config: DenoiserConfig, latent: LatentShape, coarse: LatentShape | None) -> None:
        super().__init__()
        self.context = ContextEncoder(config, coarse)
        self.clock = AdaLNModulation(config)
        self.step = NoisePredictor(config, latent)
