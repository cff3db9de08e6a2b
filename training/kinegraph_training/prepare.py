"""Convert a folder of BVH files and a captions file into a data folder for training.

    python -m kinegraph_training.prepare --bvh FOLDER --captions captions.csv --out data/mine

Every clip is brought to the 22 joints, metres, 20 frames per second and Y up, with the floor at 0, starting at the
origin and facing +Z. The split of a clip depends on its name alone, so that it stays when clips are added.

Published data sets come by `--humanml3d FOLDER` or `--kit FOLDER` instead (`kinegraph_training.prepare_published`).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from tqdm import tqdm

from kinegraph.arrays import FloatArray, Floats
from kinegraph.errors import InvalidInputError, KinegraphError, OutputError
from kinegraph.motion.skeleton import JOINT_INDEX, PELVIS, canonicalise
from kinegraph_training import prepare_published
from kinegraph_training.data.bvh import joint_positions, read_bvh, resample_bvh
from kinegraph_training.data.captions_file import match_captions, read_captions
from kinegraph_training.data.folder import SPLITS, STEP_METRES, PreparedClip, assign_splits, write_data
from kinegraph_training.data.retargeting import Source, find_joint_map, map_joints, read_map

UNITS: Final[dict[str, float]] = {
    "metres": 1.0,
    "CMU units of 1/0.45 inch": 0.0254 / 0.45,
    "inches": 0.0254,
    "centimetres": 0.01,
    "millimetres": 0.001,
}
"""Metres per unit, of the units that files come in."""
LEG_METRES: Final = (0.6, 1.2)
"""Range of thigh plus shank of an adult; at most one of `UNITS` brings a leg into it."""
MAX_FPS: Final = 240

_LEGS: Final = (("left_hip", "left_knee", "left_ankle"), ("right_hip", "right_knee", "right_ankle"))
_MAX_LISTED: Final = 10
"""Faults that an error message lists."""


@dataclass(frozen=True)
class PrepareOptions:
    """Options of reading BVH files and dividing them into splits."""

    fps: float = 20.0
    scale: float | None = None
    """Metres per unit of the files; None guesses it from the length of the legs."""
    up: str = "y"
    """Axis that points up in the files: "y" or "z"."""
    joint_sources: Mapping[str, Source] = field(default_factory=dict)
    """Entries of a map file, which come before the built-in naming conventions."""
    val: float = 0.05
    """Share of clips for model selection."""
    test: float = 0.05
    """Share of clips kept for a final test."""
    skip_broken: bool = False
    """Leave out files that cannot be read, instead of refusing all."""


def prepare(
    bvh: Path, captions: Path, out: Path, options: PrepareOptions, *, force: bool = False
) -> list[PreparedClip]:
    """Read, convert and write all clips; nothing is written unless all can be.

    Args:
        bvh: folder, searched with its subfolders.
        captions: captions file.
        out: data folder to write.
        options: see `PrepareOptions`.
        force: replace data that `out` holds.

    Returns:
        The clips that were written.

    Raises:
        InvalidInputError: files, captions, names or options that do not fit; the message names them.
        OutputError: `out` holds data already, or cannot be written.
    """
    _check_options(options)
    _check_out(out, force)
    files = _bvh_files(bvh)
    texts = match_captions(read_captions(captions), files)
    joints = _read_all(files, options)
    splits = assign_splits(list(joints), val=options.val, test=options.test)
    clips = [
        PreparedClip(name, joints[name], texts[name], files[name].relative_to(bvh).as_posix(), splits[name])
        for name in sorted(joints)
    ]
    write_data(out, clips, options.fps)
    return clips


def clip_joints(path: Path, options: PrepareOptions) -> FloatArray:
    """Read the joints of one BVH file in metres, Y up, starting at the origin and facing +Z.

    Returns:
        (frames, 22, 3).

    Raises:
        InvalidInputError: broken file, joints that cannot be mapped, no sensible size, or less than two frames.
    """
    motion = read_bvh(path)
    try:
        joint_map = find_joint_map(motion.names, options.joint_sources)
        motion = resample_bvh(motion, options.fps)
        positions = map_joints(joint_positions(motion), motion.names, joint_map)
        if len(positions) < 2:
            raise InvalidInputError(f"less than two frames at {options.fps:g} frames per second; too short to train on")
        scale = guess_unit(positions) if options.scale is None else options.scale
        joints = canonicalise(_to_y_up(positions, options.up) * scale)
        _check_range(joints)
    except InvalidInputError as error:
        raise InvalidInputError(f"{path}: {error}") from error
    return joints


def guess_unit(positions: Floats) -> float:
    """Guess the metres per unit from the mean length of the legs of (frames, 22, 3).

    Raises:
        InvalidInputError: no unit of `UNITS` gives an adult.
    """
    leg = np.mean([_mean_length(positions, a, b) + _mean_length(positions, b, c) for a, b, c in _LEGS])
    for unit in UNITS.values():
        if LEG_METRES[0] <= leg * unit <= LEG_METRES[1]:
            return unit
    raise InvalidInputError(
        f"a leg is {leg:.4g} units long, which fits a grown body in none of {', '.join(UNITS)}; "
        f"pass --scale with the metres per unit, for example --scale {0.85 / leg if leg > 0 else 1:.4g}"
    )


def _mean_length(positions: Floats, start: str, end: str) -> float:
    bones = positions[:, JOINT_INDEX[end]] - positions[:, JOINT_INDEX[start]]
    return float(np.linalg.norm(bones, axis=-1).mean())


def _to_y_up(positions: Floats, up: str) -> Floats:
    if up == "y":
        return positions
    return np.stack([positions[..., 0], positions[..., 2], -positions[..., 1]], axis=-1)


def _check_options(options: PrepareOptions) -> None:
    if not 0 < options.fps <= MAX_FPS:
        raise InvalidInputError(f"--fps is {options.fps}; it must be above 0 and at most {MAX_FPS}")
    if options.scale is not None and not (np.isfinite(options.scale) and options.scale > 0):
        raise InvalidInputError(f"--scale is {options.scale}; it must be finite and above 0")
    if options.up not in ("y", "z"):
        raise InvalidInputError(f"--up is {options.up!r}; it must be y or z")
    if not (options.val >= 0 and options.test >= 0 and options.val + options.test < 1):
        raise InvalidInputError(
            f"--val {options.val} and --test {options.test} must be 0 or more and leave something to train on"
        )


def _check_range(joints: FloatArray) -> None:
    """Refuse joints that 16-bit multiples of `STEP_METRES` cannot hold."""
    relative = joints * [1, 1, 1]
    relative[..., [0, 2]] -= joints[:, PELVIS : PELVIS + 1, [0, 2]]
    if not np.isfinite(joints).all() or np.abs(relative).max() / STEP_METRES > np.iinfo(np.int16).max:
        raise InvalidInputError("a joint is more than 3.2 m from the body or above the floor; check --scale and --up")


def _check_out(out: Path, force: bool) -> None:
    if out.exists() and not out.is_dir():
        raise OutputError(f"{out} is a file; --out must be a folder")
    taken = sorted(path.name for path in out.glob("*") if path.suffix in (".npz", ".jsonl")) if out.is_dir() else []
    if taken and not force:
        raise OutputError(f"{out} holds {', '.join(taken)}; choose another folder or replace them with --force")


def _bvh_files(folder: Path) -> dict[str, Path]:
    if not folder.is_dir():
        raise InvalidInputError(f"{folder} is no folder; --bvh must name the folder with the BVH files")
    files: dict[str, Path] = {}
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() == ".bvh" and path.is_file():
            name = path.relative_to(folder).with_suffix("").as_posix()
            if name in files:
                raise InvalidInputError(f"{files[name]} and {path} would get the same id; rename one")
            files[name] = path
    if not files:
        raise InvalidInputError(f"{folder} holds no .bvh files")
    return files


def _read_all(files: Mapping[str, Path], options: PrepareOptions) -> dict[str, FloatArray]:
    joints: dict[str, FloatArray] = {}
    problems: list[str] = []
    for name, path in tqdm(files.items(), desc="reading", unit="file", disable=None):
        try:
            joints[name] = clip_joints(path, options)
        except InvalidInputError as error:
            problems.append(str(error))
    if problems and (not options.skip_broken or not joints):
        listed = "\n".join(problems[:_MAX_LISTED])
        raise InvalidInputError(
            f"{len(problems)} of {len(files)} files cannot be used (--skip-broken leaves them out):\n{listed}"
        )
    for problem in problems:
        tqdm.write(f"left out: {problem}", file=sys.stderr)
    return joints


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m kinegraph_training.prepare", description="BVH files -> training data"
    )
    parser.add_argument("--bvh", type=Path, required=True, help="folder with BVH files, searched with its subfolders")
    parser.add_argument("--captions", type=Path, required=True, help="captions as .jsonl, .csv or .tsv")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")
    parser.add_argument("--fps", type=float, default=20.0, help="frames per second of the result (default 20)")
    parser.add_argument("--map", type=Path, help='JSON file {"pelvis": "Hips", "spine1": ["Hips", "Spine", 0.5], ...}')
    parser.add_argument("--scale", type=float, help="metres per unit of the files; default: guessed from the legs")
    parser.add_argument("--up", choices=("y", "z"), default="y", help="axis that points up in the files (default y)")
    parser.add_argument("--val", type=float, default=0.05, help="share of clips for model selection (default 0.05)")
    parser.add_argument("--test", type=float, default=0.05, help="share of clips kept for a test (default 0.05)")
    parser.add_argument("--skip-broken", action="store_true", help="leave out files that cannot be read")
    parser.add_argument("--force", action="store_true", help="replace the data in --out")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns 2 on bad input, with the reason on stderr."""
    given = sys.argv[1:] if arguments is None else arguments
    if any(argument.partition("=")[0] in prepare_published.SETS for argument in given):
        return prepare_published.main(arguments)
    parsed = _parser().parse_args(arguments)
    try:
        options = PrepareOptions(
            fps=parsed.fps,
            scale=parsed.scale,
            up=parsed.up,
            joint_sources=read_map(parsed.map) if parsed.map else {},
            val=parsed.val,
            test=parsed.test,
            skip_broken=parsed.skip_broken,
        )
        clips = prepare(parsed.bvh, parsed.captions, parsed.out, options, force=parsed.force)
    except KinegraphError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    counts = ", ".join(f"{sum(clip.split == split for clip in clips)} {split}" for split in SPLITS)
    print(f"{parsed.out}: {len(clips)} clips ({counts}) at {parsed.fps:g} frames per second")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
