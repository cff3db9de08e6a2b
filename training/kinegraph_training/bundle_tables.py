"""Small arrays that a run measures on its data and the exporter puts into the bundle's tables.npz.

Fit the length of clips to their captions (`kinegraph.conditioning`), in closed form."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from kinegraph.arrays import FloatArray
from numpy.typing import NDArray

from kinegraph.conditioning import GraphArrays, duration_inputs
from kinegraph.motion.skeleton import bone_lengths

FILE = "tables.npz"
SAME_BODY = 1e-3
"""Metres by which a bone may differ between clips of one body."""


def common_bone_lengths(clips: Iterable[FloatArray]) -> FloatArray | None:
    """(1, 21) metres if all motions (frames, 22, 3) show one and the same body, else None."""
    means = np.stack([bone_lengths(joints).mean(axis=0) for joints in clips])
    if means.std(axis=0).max() > SAME_BODY:
        return None
    return means.mean(axis=0, keepdims=True).astype(np.float32)


def write_tables(run: Path, tables: Mapping[str, FloatArray]) -> None:
    """Beside the stages of a run."""
    run.mkdir(parents=True, exist_ok=True)
    np.savez(run / FILE, **dict(tables))


def read_tables(run: Path) -> dict[str, FloatArray]:
    """What `write_tables` wrote; nothing for a run without it."""
    path = run / FILE
    if not path.is_file():
        return {}
    with np.load(path, allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}


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
