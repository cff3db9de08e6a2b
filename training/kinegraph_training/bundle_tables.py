"""Small arrays that are measured on the training clips and end in the bundle's tables.npz.

`fit_duration` fits the length of clips to their captions in closed form, for `kinegraph.conditioning`;
`common_bone_lengths` measures the body, if all clips show the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import FloatArray
from kinegraph.conditioning import GraphArrays, duration_inputs
from kinegraph.errors import InvalidInputError
from kinegraph.motion.skeleton import bone_lengths

FILE = "tables.npz"
BLOCK = 100_000
"""Samples of the duration fit that are in memory at once."""
SAME_BODY = 1e-3
"""Standard deviation in metres up to which the bones of several clips count as those of one body."""
RIDGE_PENALTY = 10.0
"""L2 penalty of the duration fit; between 1 and 100 the error on held-out clips changes by a fifth."""


def common_bone_lengths(clips: Iterable[FloatArray]) -> FloatArray | None:
    """Measure the bones that all clips share.

    Args:
        clips: joints (frames, 22, 3) in metres.

    Returns:
        (1, 21) metres, or None if the clips show different bodies.
    """
    means = np.stack([bone_lengths(joints).mean(axis=0) for joints in clips])
    if means.std(axis=0).max() > SAME_BODY:
        return None
    return means.mean(axis=0, keepdims=True).astype(np.float32)


def fit_duration(samples: Iterable[tuple[GraphArrays, int]]) -> NDArray[np.float32]:
    """Fit log frames to `duration_inputs` by ridge regression.

    Args:
        samples: graph of a caption, and frames of a clip it describes.

    Returns:
        (1, D + 3) weights.
    """
    gram, moments = None, None
    remaining = iter(samples)
    while block := list(islice(remaining, BLOCK)):
        design = np.stack([duration_inputs(graph) for graph, _ in block])
        targets = np.log([frames for _, frames in block])
        first = gram is None
        gram = design.T @ design if first else gram + design.T @ design
        moments = design.T @ targets if first else moments + design.T @ targets
    if gram is None or moments is None:
        raise InvalidInputError("there is no caption to fit lengths to")
    return np.linalg.solve(gram + RIDGE_PENALTY * np.eye(len(gram)), moments)[None].astype(np.float32)


def write_tables(run: Path, tables: Mapping[str, FloatArray]) -> None:
    """Write the tables into the folder of a run, beside its stages."""
    run.mkdir(parents=True, exist_ok=True)
    np.savez(run / FILE, **dict(tables))


def read_tables(run: Path) -> dict[str, FloatArray]:
    """Read the tables that `write_tables` wrote; a run without them has none."""
    path = run / FILE
    if not path.is_file():
        return {}
    with np.load(path, allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}
