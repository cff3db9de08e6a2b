"""Convert a published data set into a data folder for training.

    python -m kinegraph_training.prepare --humanml3d HumanML3D --out data/humanml3d
    python -m kinegraph_training.prepare --kit KIT-ML --out data/kit
    python -m kinegraph_training.prepare --bones-seed bones-seed --splits benchmark/splits --out data/seed
    python -m kinegraph_training.prepare --amass AMASS --body-models models --captions captions.csv --out data/amass

The splits are the published ones, where there are any. Motion is written in shards (`data.shards`), by a process for
each core; the same command goes on where it was stopped. `kinegraph_training.prepare` hands these options on to here.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from kinegraph.errors import KinegraphError
from kinegraph_training.data.amass import find_files, read_amass
from kinegraph_training.data.bones_seed import find_recordings, read_seed
from kinegraph_training.data.folder import SPLITS, PreparedClip
from kinegraph_training.data.humanml3d_reader import FPS, SETS, find_clips, read_clips
from kinegraph_training.data.shards import check_out, write_shards

Jobs = tuple[Sequence[Any], Callable[[Any], Sequence[PreparedClip]], list[str]]
"""Recordings, the function that converts one, and remarks on what is left out."""


def _humanml3d(option: str, parsed: argparse.Namespace) -> Jobs:
    folder = getattr(parsed, option.strip("-"))
    return find_clips(folder, SETS[option]), partial(read_clips, folder, option), []


def _bones_seed(parsed: argparse.Namespace) -> Jobs:
    recordings, remarks = find_recordings(parsed.bones_seed, parsed.splits)
    return recordings, read_seed, remarks


def _amass(parsed: argparse.Namespace) -> Jobs:
    files = find_files(parsed.amass, parsed.captions, parsed.body_models, val=parsed.val, test=parsed.test)
    return files, read_amass, []


READERS: Final[dict[str, Callable[[argparse.Namespace], Jobs]]] = {
    **{option: partial(_humanml3d, option) for option in SETS},
    "--bones-seed": _bones_seed,
    "--amass": _amass,
}
"""Option that names the folder -> how its recordings are found."""
_NEEDED_BY_AMASS: Final = ("captions", "body_models")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m kinegraph_training.prepare", description="A published data set -> training data"
    )
    source = parser.add_mutually_exclusive_group(required=True)
    for option, data in SETS.items():
        source.add_argument(option, type=Path, help=f"folder of {data.name}")
    source.add_argument("--bones-seed", type=Path, help="folder of BONES-SEED, its archives extracted")
    source.add_argument("--amass", type=Path, help="folder of AMASS; needs --captions and --body-models")
    add = parser.add_argument
    add("--out", type=Path, required=True, help="folder to write")
    add("--splits", type=Path, help="BONES-SEED: folder of the benchmark's train_split_paths.txt")
    add("--captions", type=Path, help="AMASS: captions as .jsonl, .csv or .tsv")
    add("--body-models", type=Path, help="AMASS: folder of the body models, SMPL-H or SMPL-X as .npz")
    add("--val", type=float, default=0.05, help="AMASS: share of files for model selection (default 0.05)")
    add("--test", type=float, default=0.05, help="AMASS: share of files kept for a test (default 0.05)")
    add("--processes", type=int, help="processes that convert (default: one for each core)")
    add("--skip-broken", action="store_true", help="leave out clips that cannot be used")
    add("--force", action="store_true", help="replace the data in --out")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns 2 on bad input, with the reason on stderr."""
    parser = _parser()
    parsed = parser.parse_args(arguments)
    option = next(name for name in READERS if getattr(parsed, name.strip("-").replace("-", "_")) is not None)
    lacking = [name for name in _NEEDED_BY_AMASS if option == "--amass" and getattr(parsed, name) is None]
    if lacking:
        parser.error(f"--amass needs {', '.join('--' + name.replace('_', '-') for name in lacking)}")
    try:
        check_out(parsed.out, parsed.force)
        jobs, convert, remarks = READERS[option](parsed)
        for remark in remarks:
            print(remark, file=sys.stderr)
        options = {"skip_broken": parsed.skip_broken, "force": parsed.force, "processes": parsed.processes}
        written = write_shards(parsed.out, jobs, convert, FPS, **options)
    except KinegraphError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    for problem in written.problems:
        print(f"left out: {problem}", file=sys.stderr)
    counts = ", ".join(f"{written.clips[split]} {split}" for split in SPLITS)
    hours = written.frames / FPS / 3600
    print(f"{parsed.out}: {written.clips.total()} clips ({counts}), {hours:.2f} hours at {FPS:g} frames per second")
    return 0
