"""Arrays with a row for each clip, in files that are mapped into memory: written block by block, resumable.

    latents/motion.mean.npy   (clips, ...) 16-bit floats
    latents/progress.json     how many rows are there, and of what

What is mapped is the system's to hold or to drop.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np
from numpy.lib.format import open_memmap
from numpy.typing import NDArray
from tqdm import tqdm

from kinegraph.arrays import FloatArray
from kinegraph.files import write_atomically

BLOCK: Final = 512
"""Rows that are computed before they are written."""
PROGRESS: Final = "progress.json"


def store_rows(
    folder: Path,
    stamp: str,
    shapes: Mapping[str, tuple[int, ...]],
    compute: Callable[[NDArray[np.int64]], Mapping[str, FloatArray]],
) -> dict[str, NDArray[np.float16]]:
    """Compute arrays into files, from where a stopped run left off.

    Args:
        folder: to write.
        stamp: of what the rows are computed from; what another stamp wrote is replaced.
        shapes: name of an array -> its shape; all have as many rows.
        compute: numbers of some rows -> these rows of every array.

    Returns:
        The arrays by name, mapped into memory; what is written to them stays out of the files.
    """
    paths = {name: folder / f"{name}.npy" for name in shapes}
    count = min(shape[0] for shape in shapes.values())
    done = _read_progress(folder / PROGRESS, stamp) if all(path.is_file() for path in paths.values()) else 0
    if not done:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / PROGRESS).unlink(missing_ok=True)
        for name, path in paths.items():
            open_memmap(path, mode="w+", dtype=np.float16, shape=shapes[name])
    with tqdm(desc=folder.name, unit="clip", total=count, initial=done, disable=None) as progress:
        for start in range(done, count, BLOCK):
            rows = np.arange(start, min(start + BLOCK, count))
            for name, values in compute(rows).items():
                _write_rows(paths[name], start, values)
            write_atomically(folder / PROGRESS, json.dumps({"stamp": stamp, "rows": start + len(rows)}).encode())
            progress.update(len(rows))
    return {name: np.load(path, mmap_mode="c", allow_pickle=False) for name, path in paths.items()}


def _read_progress(path: Path, stamp: str) -> int:
    """Read how many rows are there; 0 if they are of another stamp."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return int(content["rows"]) if content["stamp"] == stamp else 0
    except (OSError, ValueError, KeyError, TypeError):
        return 0


def _write_rows(path: Path, start: int, values: FloatArray) -> None:
    """Write rows of a file, and let go of the pages that were touched."""
    stored = open_memmap(path, mode="r+")
    stored[start : start + len(values)] = values
    stored.flush()
