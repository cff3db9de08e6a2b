"""Convert a published data set into a data folder for training.

    python -m kinegraph_training.prepare --humanml3d HumanML3D --out data/humanml3d
    python -m kinegraph_training.prepare --kit KIT-ML --out data/kit

The splits are the published ones. `kinegraph_training.prepare` hands these options on to here.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from tqdm import tqdm

from kinegraph.errors import KinegraphError, OutputError
from kinegraph_training.data.folder import SPLITS, PreparedClip, write_data
from kinegraph_training.data.humanml3d_reader import FPS, HUMANML3D, KIT, PublishedSet, read_published

SETS: Final[dict[str, PublishedSet]] = {data.option: data for data in (HUMANML3D, KIT)}
"""Option of the command line -> data set."""


def prepare_published(
    folder: Path, data: PublishedSet, out: Path, *, skip_broken: bool = False, force: bool = False
) -> list[PreparedClip]:
    """Read, convert and write a data set; nothing is written unless all can be.

    Args:
        folder: of the data set.
        data: which it is.
        out: data folder to write.
        skip_broken: leave out clips that cannot be used; they are named on stderr.
        force: replace data that `out` holds.

    Raises:
        InvalidInputError: see `data.humanml3d_reader.read_published`.
        OutputError: `out` holds data already, or cannot be written.
    """
    taken = sorted(path.name for path in out.glob("*") if path.suffix in (".npz", ".jsonl")) if out.is_dir() else []
    if taken and not force:
        raise OutputError(f"{out} holds {', '.join(taken)}; choose another folder or replace them with --force")
    clips, problems = read_published(folder, data, skip_broken=skip_broken, progress=_shown)
    for problem in problems:
        print(f"left out: {problem}", file=sys.stderr)
    write_data(out, clips, FPS)
    return clips


def _shown(names: Sequence[str]) -> Iterator[str]:
    return iter(tqdm(names, desc="reading", unit="clip", disable=None))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns 2 on bad input, with the reason on stderr."""
    parser = argparse.ArgumentParser(
        prog="python -m kinegraph_training.prepare", description="A published data set -> training data"
    )
    source = parser.add_mutually_exclusive_group(required=True)
    for option, data in SETS.items():
        source.add_argument(option, type=Path, help=f"folder of {data.name}")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")
    parser.add_argument("--skip-broken", action="store_true", help="leave out clips that cannot be used")
    parser.add_argument("--force", action="store_true", help="replace the data in --out")
    parsed = parser.parse_args(arguments)
    option = next(option for option in SETS if getattr(parsed, option.strip("-")) is not None)
    folder = getattr(parsed, option.strip("-"))
    try:
        clips = prepare_published(folder, SETS[option], parsed.out, skip_broken=parsed.skip_broken, force=parsed.force)
    except KinegraphError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    counts = ", ".join(f"{sum(clip.split == split for clip in clips)} {split}" for split in SPLITS)
    print(f"{parsed.out}: {len(clips)} clips ({counts}) at {FPS:g} frames per second")
    return 0
