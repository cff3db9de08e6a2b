"""Write hours of made motion as shards, then train on them, and tell the peak memory of each process.

    PYTHONPATH=tests:benchmarks python tests/support/many_hours.py --hours 300 --work /tmp/hours

The motion is a few walks, turned: cheap to make, and as large as any. Training is what the first batches take: for the
autoencoder listing the clips, measuring the normalisation, and drawing features; for the denoisers captions, tables,
latents, and drawing all of them. Captions are not parsed and encoded but made, at a twelfth of the width, which would
take a day and 10 GB of disk; autoencoders have untrained weights, few channels, and latents as large as any. Of these
the last `ENCODED` are computed, by blocks as all would be, behind others that are zeros: holes in files of full size.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from numpy.lib.format import open_memmap

from kinegraph_benchmarks.speed.clip_process import peak_memory
from kinegraph_training.data.folder import PreparedClip
from kinegraph_training.data.shards import write_shards
from support.motions import walk

SECONDS = 8
FRAMES = 20 * SECONDS
BATCHES = 200
NODES, WIDTH = 20, 32
"""Of the graph of a made caption; the width of a real one is 384."""
ENCODED = 4096
"""Latents that are computed."""


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
    draw(batches)


def draw(batches: object) -> None:
    for number, _ in enumerate(batches):  # type: ignore[arg-type, var-annotated]
        if number == BATCHES:
            break


def make_graphs(captions: Sequence[str], *_: object) -> Iterator[object]:
    """Make graphs in place of those of captions: a sentence, two actions, and what hangs on them."""
    from kinegraph.conditioning import GraphArrays

    rng = np.random.Generator(np.random.PCG64(len(captions)))
    relation = np.where(np.eye(NODES, dtype=bool), 11, -1)
    relation[0, 1:3] = relation[1:3, 0] = 10
    kind = np.array([0, 1, 1, *[2] * (NODES - 3)])
    for _caption in captions:
        nodes = rng.standard_normal((NODES, WIDTH), dtype=np.float32)
        weights = np.ones((NODES, NODES), dtype=np.float32)
        owner = np.arange(NODES)
        yield GraphArrays(nodes, relation, weights, kind, owner, np.ones(NODES, dtype=np.float32), owner)


def write_autoencoders(run: Path) -> None:
    """Write autoencoders whose latents are as large as those of the edge preset."""
    import torch

    from kinegraph_training.config import read_preset
    from kinegraph_training.models.vae import MotionVae, VaeConfig

    for level, real in read_preset("edge").vae.items():
        config = VaeConfig(real.features, real.tokens, real.latent_width, 16, 1, 2, 16, frame_channels=16)
        torch.manual_seed(0)
        weights = {f"vae.{name}": value for name, value in MotionVae(config).state_dict().items()}
        statistics = {"mean": torch.zeros(real.features), "std": torch.ones(real.features)}
        (run / f"vae_{level}").mkdir(parents=True, exist_ok=True)
        content = {"hyper_parameters": {"config": vars(config)}, "state_dict": weights | statistics}
        torch.save(content, run / f"vae_{level}" / "last.ckpt")


def store_behind_holes(folder: Path, stamp: str, shapes: Mapping[str, tuple[int, ...]], compute: Any) -> Any:
    """Store rows as a run does that was stopped before the last `ENCODED`, and whose rows until there are zeros."""
    from kinegraph_training.stored_rows import PROGRESS, store_rows

    done = min(shape[0] for shape in shapes.values()) - ENCODED
    if done > 0 and not (folder / PROGRESS).is_file():
        folder.mkdir(parents=True)
        for name, shape in shapes.items():
            open_memmap(folder / f"{name}.npy", mode="w+", dtype=np.float16, shape=shape)
        (folder / PROGRESS).write_text(json.dumps({"stamp": stamp, "rows": done}))
    return store_rows(folder, stamp, shapes, compute)


def denoise(work: Path, hours: float) -> None:
    """Do what training the denoisers of the edge preset does before its first step, and draw batches."""
    import torch

    from kinegraph.bundle.reader import text_files_folder
    from kinegraph_training import latents
    from kinegraph_training import train_denoisers as stage
    from kinegraph_training.config import read_preset
    from kinegraph_training.data import caption_cache
    from kinegraph_training.layouts import JOINTS_137

    torch.set_num_threads(1)
    preset, run = read_preset("edge"), work / "run"
    if not (run / "vae_motion").is_dir():
        write_autoencoders(run)
    arguments = argparse.Namespace(data=work / "data", held_out=None, more=[])
    clips = stage.load_clips(arguments, preset.data, JOINTS_137)
    with mock.patch.object(caption_cache, "_encode_missing", make_graphs):
        captions = stage.encode_captions(clips, preset.denoiser.condition, text_files_folder(), run)
    stage.write_bundle_tables(run, clips.train, captions)
    stage.write_shown_captions(run, stage.without_motion(clips.train.clips), recorded=stage.read_ids(arguments.data))
    with mock.patch.object(latents, "store_rows", store_behind_holes):
        encoded = stage.encode_latents(clips, preset.denoiser.levels, run)
    batches, _ = stage.make_loaders(clips, captions, encoded, preset)
    draw(batches)


STAGES = {"write": write, "train": train, "denoise": denoise}


def peak_of(stage: str, work: Path, hours: float) -> dict[str, float]:
    """Run a stage in a process of its own; returns its seconds and peak memory in MB, that of its children apart."""
    receive, send = get_context("spawn").Pipe(duplex=False)
    process = get_context("spawn").Process(target=_measured, args=(stage, work, hours, send))
    start = time.perf_counter()
    process.start()
    send.close()  # or a stage that fails would be waited for
    own, children = receive.recv()
    process.join()
    return {"seconds": time.perf_counter() - start, "peak_mb": own, "largest_child_mb": children}


def _measured(stage: str, work: Path, hours: float, send: object) -> None:
    STAGES[stage](work, hours)
    # Not ru_maxrss of its own: that also counts the process that started this one.
    children = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    send.send((peak_memory(), children))  # type: ignore[attr-defined]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--hours", type=float, default=2)
    parser.add_argument("--work", type=Path, required=True)
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    for name in STAGES:
        print(name, json.dumps(peak_of(name, options.work, options.hours)), flush=True)
