"""Fit the length of clips to their captions (`kinegraph.duration`), in closed form."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from kinegraph.conditions import GraphArrays
from kinegraph.duration import duration_inputs

PENALTY = 10.0
"""Of the ridge; between 1 and 100 the error on held-out clips moves by a fifth."""


def fit_duration(pairs: Iterable[tuple[GraphArrays, int]]) -> NDArray[np.float32]:
    """Ridge regression of log frames on `duration_inputs`: (1, D + 3), from (graph of a caption, frames) pairs."""
    rows, targets = [], []
    for graph, frames in pairs:
        rows.append(duration_inputs(graph))
        targets.append(np.log(frames))
    design = np.stack(rows)
    gram = design.T @ design + PENALTY * np.eye(design.shape[1])
    return np.linalg.solve(gram, design.T @ np.array(targets))[None].astype(np.float32)
