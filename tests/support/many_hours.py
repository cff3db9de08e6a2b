"""Write hours of made motion as shards, then train on them, and tell the peak memory of each process.

    PYTHONPATH=tests:benchmarks python tests/support/many_hours.py --hours 300 --work /tmp/hours

The motion is a few walks, turned: cheap to make, and as large as any. Training is what the first batches take: listing
the clips, measuring the normalisation, and drawing batches of features for the autoencoder.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from kinegraph_benchmarks.speed.clip_process import peak_memory
from kinegraph_training.data.folder import PreparedClip
from kinegraph_training.data.shards import write_shards
from support.motions import walk

SECONDS = 8
FRAMES = 20 * SECONDS
BATCHES = 200


@lru_cache(maxsize=1)
def walks() -> tuple[np.ndarray, ...]:
    return tuple(walk(FRAMES, turning=0.005 * n) for n in range(-3, 4))


def make_clip(number: int) -> list[PreparedClip]:
    """Make one recording: a walk, turned about the vertical."""
    angle = 0.001 * number
    cos, sin = np.float32(np.cos(angle)), np.float32(np.sin(angle))
    joints = walks()[number % 7] @ np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]], dtype=np.float32)
    captions = tuple(f"a person walks ahead, number {number}, told in words of kind {kind}" for kind in range(4))
    split = "val" if number % 400 == 0 else "train"
    return [PreparedClip(f"2207/walk_{number:06d}__A001", joints, captions, "made", split, partial_captions=("walks",))]


def write(work: Path, hours: float) -> None:
    """Write the shards, by one process for each core."""
    write_shards(work / "data", range(int(hours * 3600 / SECONDS)), make_clip, 20.0, force=True)


def train(work: Path, hours: float) -> None:
    """Draw batches as the autoencoder of the edge preset does."""
    from kinegraph_training.config import read_preset
    from kinegraph_training.dataset import training_set, validation_set
    from kinegraph_training.train_vae import make_loaders

    preset = read_preset("edge")
    dataset = training_set(work / "data", preset.data, None)
    val = validation_set(work / "data", "val", preset.data, dataset.mean, dataset.std)
    batches, _ = make_loaders(dataset, val, preset, "motion")
    for number, _ in enumerate(batches):
        if number == BATCHES:
            break


def peak_of(stage: str, work: Path, hours: float) -> dict[str, float]:
    """Run a stage in a process of its own; returns its seconds and peak memory in MB, that of its children apart."""
    receive, send = get_context("spawn").Pipe(duplex=False)
    process = get_context("spawn").Process(target=_measured, args=(stage, work, hours, send))
    start = time.perf_counter()
    process.start()
    own, children = receive.recv()
    process.join()
    return {"seconds": time.perf_counter() - start, "peak_mb": own, "largest_child_mb": children}


def _measured(stage: str, work: Path, hours: float, send: object) -> None:
    {"write": write, "train": train}[stage](work, hours)
    # Not ru_maxrss of its own: that also counts the process that started this one.
    children = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    send.send((peak_memory(), children))  # type: ignore[attr-defined]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--hours", type=float, default=2)
    parser.add_argument("--work", type=Path, required=True)
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    for name in ("write", "train"):
        print(name, json.dumps(peak_of(name, options.work, options.hours)), flush=True)
