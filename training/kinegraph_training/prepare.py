"""Convert a folder of BVH or GLB files and a captions file into a data folder for training.

    python -m kinegraph_training.prepare --bvh FOLDER --captions captions.csv --out data/mine

Every clip is brought to the 22 joints, metres, 20 frames per second and Y up, with the floor at 0, starting at the
origin and facing +Z; up, left and right and the unit are found from the body. Long recordings are cut into windows. The
split of a recording depends on its name alone, so that it stays when others are added.

Published data sets come by `--humanml3d FOLDER`, `--kit FOLDER`, `--bones-seed FOLDER` or `--amass FOLDER` instead
(`kinegraph_training.prepare_published`).
"""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from tqdm import tqdm

from kinegraph.arrays import FloatArray
from kinegraph.errors import InvalidInputError, KinegraphError
from kinegraph.files import check_target
from kinegraph.motion.skeleton import canonicalise
from kinegraph_training import prepare_published
from kinegraph_training.data.body import UP_AXES, UnclearUpError
from kinegraph_training.data.bvh import read_recording
from kinegraph_training.data.folder import SPLITS, PreparedClip, assign_splits, write_data
from kinegraph_training.data.motion_files import find_takes
from kinegraph_training.data.recording import Take
from kinegraph_training.data.retargeting import Source, read_map
from kinegraph_training.data.shards import check_out
from kinegraph_training.data.understanding import Stated, Understood, understand
from kinegraph_training.data.windows import cut_windows, holds_at_any_moment

MAX_FPS: Final = 240

_MAX_LISTED: Final = 10
"""Faults that an error message lists."""


@dataclass(frozen=True)
class PrepareOptions:
    """Options of reading motion and dividing it into splits."""

    fps: float = 20.0
    scale: float | None = None
    """Metres per unit of the files; None finds it from the length of the legs."""
    up: str | None = None
    """Axis that points up in the files, of `UP_AXES`; None finds it from the body."""
    handedness: str | None = None
    """Of the files' axes: "right" or "left"; None is right, and refuses files that look left-handed."""
    joint_sources: Mapping[str, Source] = field(default_factory=dict)
    """Entries of a map file, which come before the built-in naming conventions."""
    val: float = 0.05
    """Share of recordings for model selection."""
    test: float = 0.05
    """Share of recordings kept for a final test."""
    skip_broken: bool = False
    """Leave out files that cannot be used, instead of refusing all."""
    captions_hold: bool = False
    """All captions describe every part of their recording, so that windows of long ones keep them."""

    @property
    def stated(self) -> Stated:
        """What is stated of the files."""
        return Stated(self.scale, self.up, self.handedness, self.joint_sources)


@dataclass(frozen=True)
class Prepared:
    """Recording that was understood, with the clips that it is worth."""

    take: Take
    motion: Understood
    clips: tuple[PreparedClip, ...]
    """Without their split."""
    warnings: tuple[str, ...]


def prepare(
    bvh: Path,
    captions: Path,
    out: Path | None,
    options: PrepareOptions,
    *,
    force: bool = False,
    preview: Path | None = None,
) -> list[PreparedClip]:
    """Read, convert and write all clips; nothing is written unless all can be.

    What was understood of each file is printed as a table before anything is written.

    Args:
        bvh: folder with motion files, searched with its subfolders.
        captions: captions file.
        out: data folder to write; None looks only.
        options: see `PrepareOptions`.
        force: replace data that `out` holds, and `preview`.
        preview: PNG file to write a contact sheet to.

    Returns:
        The clips that were written.

    Raises:
        InvalidInputError: files, captions, names or options that do not fit; the message names them.
        MissingExtraError: `preview` or a .glb file needs a package that is not installed.
        OutputError: `out` holds data already, or cannot be written.
    """
    check_targets(options, out, preview, force)
    takes, remarks = find_takes(bvh, captions)
    return write_takes(takes, remarks, out, options, preview=preview)


def check_targets(options: PrepareOptions, out: Path | None, preview: Path | None, force: bool) -> None:
    """Refuse options out of range and places that cannot be written to, before anything is read.

    Raises:
        InvalidInputError: an option; the message names it.
        OutputError: `out` or `preview` exists, without `force`, or cannot be written.
    """
    _check_options(options)
    if out is not None:
        check_out(out, force)
    if preview is not None:
        check_target(preview, force, (".png",))


def write_takes(
    takes: Sequence[Take], remarks: Sequence[str], out: Path | None, options: PrepareOptions, *, preview: Path | None
) -> list[PreparedClip]:
    """Understand recordings of any source, print the table, and write their clips; see `prepare`.

    Args:
        takes: recordings to read.
        remarks: of the source, on what it left out; printed.
        out: data folder to write; None looks only.
        options: see `PrepareOptions`.
        preview: PNG file to write a contact sheet to.
    """
    prepared, problems = prepare_takes(takes, options)
    print("\n".join(table_lines(prepared)))
    for remark in (*remarks, *(f"left out: {problem}" for problem in problems)):
        print(remark, file=sys.stderr)
    clips = split_clips(prepared, options)
    if preview is not None:
        from kinegraph_training.data.preview import write_preview

        print(f"{preview}: {write_preview(preview, clips, options.fps)} of {len(clips)} clips")
    if out is not None:
        write_data(out, clips, options.fps)
    return clips


def prepare_takes(takes: Sequence[Take], options: PrepareOptions) -> tuple[list[Prepared], list[str]]:
    """Read, understand and cut recordings of any source.

    Where a body does not tell what is up, the others of its folder do, if they agree.

    Returns:
        What can be used, in the order of `takes`, and the problems of the others.

    Raises:
        InvalidInputError: some cannot be used and `skip_broken` is off, or none can; the message names them.
    """
    done: dict[str, Prepared] = {}
    unclear: dict[str, Take] = {}
    problems: dict[str, str] = {}
    for take in tqdm(takes, desc="reading", unit="file", disable=None):
        try:
            done[take.id] = prepare_take(take, options)
        except KinegraphError as error:
            problems[take.id] = f"{take.source_file}: {error}"
            if isinstance(error, UnclearUpError):
                unclear[take.id] = take
    axes = {prepared.motion.up for prepared in done.values()}
    if len(axes) == 1:
        shared = replace(options, up=axes.pop())
        for take in unclear.values():
            try:
                prepared = prepare_take(take, shared)
            except KinegraphError as error:
                problems[take.id] = f"{take.source_file}: {error}"
                continue
            note = f"up is {shared.up} as in the other files; this body alone does not tell"
            others = tuple(warning for warning in prepared.warnings if not warning.startswith("--up="))
            done[take.id] = replace(prepared, warnings=(*others, note))
            del problems[take.id]
    if problems and (not options.skip_broken or not done):
        listed = "\n".join(list(problems.values())[:_MAX_LISTED])
        raise InvalidInputError(
            f"{len(problems)} of {len(takes)} files cannot be used (--skip-broken leaves them out):\n{listed}"
        )
    return [done[take.id] for take in takes if take.id in done], list(problems.values())


def prepare_take(take: Take, options: PrepareOptions) -> Prepared:
    """Read, understand and cut one recording.

    Raises:
        KinegraphError: it cannot be used; the message does not name it.
    """
    motion = understand(take.read(), options.stated, options.fps)
    windows = cut_windows(motion.joints)
    if len(windows) == 1:
        clip = PreparedClip(take.id, motion.joints, take.captions, take.source_file, "")
        return Prepared(take, motion, (clip,), motion.warnings)
    held = tuple(text for text in take.captions if options.captions_hold or holds_at_any_moment(text))
    lost = [repr(text[:80]) for text in take.captions if text not in held]
    length = f"{len(motion.joints) / options.fps:.1f} s are {len(windows)} windows"
    if not held:
        raise InvalidInputError(
            f"{length}, and no caption describes each of them: {', '.join(lost[:3])}. Cut the file into takes with "
            "captions of their own, add a caption without order, number or end, or pass --captions-hold if all of "
            "them hold at any moment"
        )
    clips = tuple(
        PreparedClip(
            f"{take.id}#{number}",
            canonicalise(motion.joints[first:end]),
            held,
            take.source_file,
            "",
            start=first / options.fps,
        )
        for number, (first, end) in enumerate(windows, start=1)
    )
    notes = (length, *([f"not kept for them: {', '.join(lost)}"] if lost else []))
    return Prepared(take, motion, clips, (*motion.warnings, *notes))


def split_clips(prepared: Sequence[Prepared], options: PrepareOptions) -> list[PreparedClip]:
    """Assign clips to splits: windows of one recording to the same one.

    Raises:
        InvalidInputError: two clips have one id.
    """
    splits = assign_splits([each.take.id for each in prepared], val=options.val, test=options.test)
    clips = [replace(clip, split=splits[each.take.id]) for each in prepared for clip in each.clips]
    clips.sort(key=lambda clip: clip.id)
    for first, second in pairwise(clips):
        if first.id == second.id:
            raise InvalidInputError(f"{first.source_file} and {second.source_file} give clips of one id; rename one")
    return clips


def table_lines(prepared: Sequence[Prepared]) -> list[str]:
    """Lay out what was understood of each file as the lines of a table, its warnings below it."""
    heading = ("file", "frames", "fps", "seconds", "clips", "up", "facing", "unit", "height", "names")
    rows = [heading]
    for each in prepared:
        motion = each.motion
        height = float(np.median(motion.joints[..., 1].max(axis=1) - motion.joints[..., 1].min(axis=1)))
        rows.append(
            (
                each.take.source_file,
                str(motion.frames),
                f"{motion.fps:g}",
                f"{motion.frames / motion.fps:.1f}",
                str(len(each.clips)),
                motion.up,
                motion.facing,
                motion.unit,
                f"{height:.2f} m",
                motion.names,
            )
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    result = lines[:1]
    for line, each in zip(lines[1:], prepared, strict=True):
        result += [line, *(f"    {warning}" for warning in each.warnings)]
    return result


def clip_joints(path: Path, options: PrepareOptions) -> FloatArray:
    """Read the joints of one BVH file in metres, Y up, starting at the origin and facing +Z.

    Returns:
        (frames, 22, 3).

    Raises:
        InvalidInputError: see `understanding.understand`; the message names the file.
    """
    try:
        return understand(read_recording(path), options.stated, options.fps).joints
    except InvalidInputError as error:
        raise InvalidInputError(f"{path}: {error}") from error


def _check_options(options: PrepareOptions) -> None:
    if not 0 < options.fps <= MAX_FPS:
        raise InvalidInputError(f"--fps is {options.fps}; it must be above 0 and at most {MAX_FPS}")
    if options.scale is not None and not (np.isfinite(options.scale) and options.scale > 0):
        raise InvalidInputError(f"--scale is {options.scale}; it must be finite and above 0")
    if options.up is not None and options.up not in UP_AXES:
        raise InvalidInputError(f"--up is {options.up!r}; it must be one of {', '.join(UP_AXES)}")
    if options.handedness not in (None, "right", "left"):
        raise InvalidInputError(f"--handedness is {options.handedness!r}; it must be right or left")
    if not (options.val >= 0 and options.test >= 0 and options.val + options.test < 1):
        raise InvalidInputError(
            f"--val {options.val} and --test {options.test} must be 0 or more and leave something to train on"
        )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m kinegraph_training.prepare", description="BVH and GLB files -> training data"
    )
    add = parser.add_argument
    add("--bvh", type=Path, required=True, help="folder with .bvh and .glb files, searched with its subfolders")
    add("--captions", type=Path, required=True, help="captions as .jsonl, .csv or .tsv")
    add("--out", type=Path, help="folder to write; may be left out with --preview")
    add("--preview", type=Path, help="PNG file: a contact sheet of what was understood")
    add("--fps", type=float, default=20.0, help="frames per second of the result (default 20)")
    add("--map", type=Path, help='JSON file {"pelvis": "Hips", "spine1": ["Hips", "Spine", 0.5], ...}')
    add("--scale", type=float, help="metres per unit of the files; default: found from the legs")
    add("--up", choices=UP_AXES, help="axis that points up in the files, --up=-y with a sign; default: found")
    add("--handedness", choices=("right", "left"), help="left negates an axis; default: right, and checked")
    add("--val", type=float, default=0.05, help="share of recordings for model selection (default 0.05)")
    add("--test", type=float, default=0.05, help="share of recordings kept for a test (default 0.05)")
    add("--skip-broken", action="store_true", help="leave out files that cannot be used")
    add("--captions-hold", action="store_true", help="captions of long clips hold at any moment: windows keep all")
    add("--force", action="store_true", help="replace the data in --out, and the preview")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns 2 on bad input, with the reason on stderr."""
    given = sys.argv[1:] if arguments is None else arguments
    if any(argument.partition("=")[0] in prepare_published.READERS for argument in given):
        return prepare_published.main(arguments)
    parser = _parser()
    parsed = parser.parse_args(arguments)
    if parsed.out is None and parsed.preview is None:
        parser.error("the following arguments are required: --out, or --preview to look only")
    if isinstance(sys.stdout, io.TextIOWrapper):  # names of files may have letters that the terminal lacks
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        options = PrepareOptions(
            fps=parsed.fps,
            scale=parsed.scale,
            up=parsed.up,
            handedness=parsed.handedness,
            joint_sources=read_map(parsed.map) if parsed.map else {},
            val=parsed.val,
            test=parsed.test,
            skip_broken=parsed.skip_broken,
            captions_hold=parsed.captions_hold,
        )
        clips = prepare(parsed.bvh, parsed.captions, parsed.out, options, force=parsed.force, preview=parsed.preview)
    except KinegraphError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if parsed.out is not None:
        counts = ", ".join(f"{sum(clip.split == split for clip in clips)} {split}" for split in SPLITS)
        print(f"{parsed.out}: {len(clips)} clips ({counts}) at {parsed.fps:g} frames per second")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
