"""Small arrays that a run measures on its data and the exporter puts into the bundle's tables.npz."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from kinegraph.motion.skeleton import FloatArray, bone_lengths

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
