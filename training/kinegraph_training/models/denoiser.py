"""Denoisers."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DenoiserConfig:
    """Shape of the three denoisers and of the graph encoder."""

    width: int
    layers: int
    heads: int
    feed_forward: int
    text_width: int = 384
    dropout: float = 0.1
    train_steps: int = 1000
    max_frames: int = 196
    max_order: int = 16
    """Largest order of an action; later ones share the last embedding."""
    kind: str = "cross"
    """`cross` (the product) or `concat` (GraphMotion as published)."""
