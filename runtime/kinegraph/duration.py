"""How long a clip should be when nobody says: a linear model of the logarithm of its frames, learnt from the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinegraph.conditions import ACTION, GraphArrays
from kinegraph.manifest import Manifest
from kinegraph.options import GenerateOptions

FloatArray = NDArray[np.float32]

EXTRA = 3
"""Inputs besides the sentence's features: number of actions, number of nodes, and 1."""


def duration_inputs(graph: GraphArrays) -> NDArray[np.float64]:
    """What the length is read off: (D + 3,); the sentence is the motion node before graph attention."""
    counts = [np.count_nonzero(graph.kind == ACTION), len(graph.kind), 1]
    return np.concatenate([graph.nodes[0].astype(np.float64), counts])


def expected_frames(weights: FloatArray, graphs: Sequence[GraphArrays], shortest: int, longest: int) -> int:
    """Frames for the longest of some sentences, within what the model takes.

    Args:
        weights: (1, D + 3), log frames = weights . inputs.
        graphs: of the sentences that the clip is for.
        shortest: fewest frames.
        longest: most frames.
    """
    logs = [float(weights[0].astype(np.float64) @ duration_inputs(graph)) for graph in graphs]
    # clipped before exp: a sentence unlike any other must not overflow
    return int(np.clip(round(np.exp(np.clip(max(logs), 0.0, 20.0))), shortest, longest))


def with_own_length(
    options: GenerateOptions, weights: FloatArray | None, manifest: Manifest, arrays: Sequence[GraphArrays]
) -> GenerateOptions:
    """The length that the longest of some sentences asks for; as it is, where the bundle cannot tell."""
    if weights is None:
        return options
    frames = expected_frames(weights, arrays, manifest.frames.min, manifest.frames.max)
    return replace(options, frames=frames, seconds=frames / manifest.fps)
