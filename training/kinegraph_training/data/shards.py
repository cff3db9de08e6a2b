"""Convert many recordings into a data folder of shards: a process per core, resumable, in little memory.

    shards/00012.joints.npy   (frames, 22, 3) 16-bit multiples of `STEP_METRES`, relative to the pelvis on the floor
    shards/00012.root.npy     (frames, 2) metres of the pelvis
    index.jsonl               a line for each clip, as in any data folder, with `shard` and `first`: its first frame
    captions.jsonl

A shard holds the clips of `JOBS` recordings. While it is written, the folder is called `NAME.partial`; the same command
goes on where it was stopped. It gets its name when all is there. `clips.StoredClips` reads it.
"""

from __future__ import annotations

import hashlib
import io
import json
import shutil
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from tqdm import tqdm

from kinegraph.bundle.sessions import available_cpus
from kinegraph.errors import InvalidInputError, KinegraphError, OutputError
from kinegraph.files import write_atomically
from kinegraph.motion.skeleton import JOINTS
from kinegraph_training.data.clips import SHARDS
from kinegraph_training.data.folder import PreparedClip, caption_row, index_row, pack_joints, to_json_lines

Job = TypeVar("Job")

JOBS: Final = 256
"""Recordings whose clips make a shard: what a process holds in memory."""
PLAN: Final = "plan.json"
_MAX_LISTED: Final = 10


@dataclass(frozen=True)
class Written:
    """What a conversion wrote."""

    clips: Counter[str]
    """By split."""
    frames: int
    problems: tuple[str, ...]
    """Of the recordings that were left out."""


def write_shards(
    out: Path,
    jobs: Sequence[Job],
    convert: Callable[[Job], Sequence[PreparedClip]],
    fps: float,
    *,
    skip_broken: bool = False,
    force: bool = False,
    processes: int | None = None,
) -> Written:
    """Convert recordings into a data folder, which appears when all are converted.

    Args:
        out: folder to write.
        jobs: what tells `convert` of a recording; by their `repr` a resumed run is told from another one.
        convert: recording -> its clips; raises `KinegraphError` if it cannot be used. Sent to other processes.
        fps: of the clips.
        skip_broken: leave out recordings that cannot be used. Without it they are tried again when the run is resumed.
        force: replace the data that `out` holds.
        processes: None is one for each core.

    Raises:
        InvalidInputError: recordings cannot be used, and `skip_broken` is not set, or none can; or two clips have one
            id. What was converted stays in `NAME.partial`.
        OutputError: `out` holds data already, or cannot be written.
    """
    check_out(out, force)
    stage = out.with_name(f"{out.name}.partial")
    try:
        _open_stage(stage, jobs, convert)
        _convert_all(stage, jobs, convert, fps, skip_broken, processes or available_cpus())
        written = _finish_index(stage, len(jobs), skip_broken)
        _give_name(stage, out)
    except BrokenProcessPool as error:
        raise OutputError(
            "a process was killed, perhaps for its memory; give the same command again to go on"
        ) from error
    except OSError as error:
        if isinstance(error, KinegraphError):
            raise
        raise OutputError(
            f"{out} cannot be written ({error.strerror or error}); free some space, then go on"
        ) from error
    return written


def check_out(out: Path, force: bool) -> None:
    """Refuse a file, and without `force` a folder that holds data.

    Raises:
        OutputError: see above.
    """
    if out.exists() and not out.is_dir():
        raise OutputError(f"{out} is a file; --out must be a folder")
    taken = sorted(path.name for path in out.glob("*") if path.suffix in (".npz", ".jsonl")) if out.is_dir() else []
    if taken and not force:
        raise OutputError(f"{out} holds {', '.join(taken)}; choose another folder or replace them with --force")


def _label(convert: Callable[..., object]) -> str:
    """Name a function with the arguments that it is bound to; its `repr` differs from run to run."""
    if isinstance(convert, partial):
        return f"{_label(convert.func)} {convert.args!r} {convert.keywords!r}"
    return f"{convert.__module__}.{convert.__qualname__}"


def _open_stage(stage: Path, jobs: Sequence[object], convert: Callable[..., object]) -> None:
    """Make the unfinished folder, or keep that of the same conversion; that of another one is replaced."""
    digest = hashlib.sha256(_label(convert).encode())
    for job in jobs:
        digest.update(repr(job).encode())
    plan = json.dumps({"jobs": len(jobs), "sha256": digest.hexdigest()})
    if stage.is_dir():
        if (stage / PLAN).is_file() and (stage / PLAN).read_text() == plan:
            return
        print(f"{stage} is of other recordings or options: starting anew", file=sys.stderr)
        shutil.rmtree(stage)
    (stage / SHARDS).mkdir(parents=True)
    write_atomically(stage / PLAN, plan.encode())


def _convert_all(
    stage: Path,
    jobs: Sequence[Job],
    convert: Callable[[Job], Sequence[PreparedClip]],
    fps: float,
    skip_broken: bool,
    processes: int,
) -> None:
    """Write the shards that are not there."""
    chunks = {number: jobs[start : start + JOBS] for number, start in enumerate(range(0, len(jobs), JOBS))}
    todo = {number: chunk for number, chunk in chunks.items() if not _is_done(stage, number, skip_broken)}
    done = len(jobs) - sum(map(len, todo.values()))
    write = partial(_write_shard, stage, convert, fps)
    with tqdm(desc="converting", unit="recording", total=len(jobs), initial=done, disable=None) as progress:
        if min(processes, len(todo)) < 2:
            for number, chunk in todo.items():
                write(number, chunk)
                progress.update(len(chunk))
            return
        with ProcessPoolExecutor(min(processes, len(todo)), mp_context=get_context("spawn")) as pool:
            running = {pool.submit(write, number, chunk): len(chunk) for number, chunk in todo.items()}
            try:
                for future in as_completed(running):
                    future.result()
                    progress.update(running[future])
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise


def _rows_path(stage: Path, number: int) -> Path:
    return stage / SHARDS / f"{number:05d}.jsonl"


def _is_done(stage: Path, number: int, skip_broken: bool) -> bool:
    """Tell whether a shard is there; one with problems only if they may be left out."""
    path = _rows_path(stage, number)
    return path.is_file() and (skip_broken or not any("problem" in row for row in _rows(path)))


def _write_shard(
    stage: Path, convert: Callable[[Job], Sequence[PreparedClip]], fps: float, number: int, jobs: Sequence[Job]
) -> None:
    """Convert some recordings and write their shard, its rows last."""
    rows: list[dict[str, Any]] = []
    packed, roots = [np.zeros((0, JOINTS, 3), dtype=np.int16)], [np.zeros((0, 2), dtype=np.float32)]
    first = 0
    for job in jobs:
        try:
            clips = convert(job)
        except KinegraphError as error:
            rows.append({"problem": str(error)})
            continue
        for clip in clips:
            joints, root = pack_joints(clip.joints)
            packed.append(joints)
            roots.append(root)
            rows.append(
                {"index": {**index_row(clip, fps), "shard": number, "first": first}, "texts": caption_row(clip)}
            )
            first += len(joints)
    for name, array in (("joints", np.concatenate(packed)), ("root", np.concatenate(roots))):
        buffer = io.BytesIO()
        np.save(buffer, array)
        write_atomically(stage / SHARDS / f"{number:05d}.{name}.npy", buffer.getvalue())
    write_atomically(_rows_path(stage, number), to_json_lines(rows))


def _rows(path: Path) -> Iterator[dict[str, Any]]:
    with path.open(encoding="utf-8") as file:
        yield from map(json.loads, file)


def _finish_index(stage: Path, jobs: int, skip_broken: bool) -> Written:
    """Join the rows of all shards into index.jsonl and captions.jsonl, one shard at a time."""
    problems, clips, frames = [], Counter[str](), 0
    seen: set[bytes] = set()
    paths = [_rows_path(stage, number) for number in range(-(-jobs // JOBS))]
    with (stage / "index.jsonl").open("wb") as index, (stage / "captions.jsonl").open("wb") as captions:
        for row in (row for path in paths for row in _rows(path)):
            if "problem" in row:
                problems.append(str(row["problem"]))
                continue
            name = hashlib.sha256(row["index"]["id"].encode()).digest()[:12]
            if name in seen:
                raise InvalidInputError(f"two clips have the id {row['index']['id']!r}; rename one")
            seen.add(name)
            index.write(to_json_lines([row["index"]]))
            captions.write(to_json_lines([row["texts"]]))
            clips[row["index"]["split"]] += 1
            frames += row["index"]["frames"]
    if problems and (not skip_broken or not clips):
        listed = "\n".join(problems[:_MAX_LISTED])
        raise InvalidInputError(
            f"{len(problems)} of {jobs} clips cannot be used (--skip-broken leaves them out):\n{listed}"
        )
    if not clips:
        raise InvalidInputError(f"none of {jobs} recordings gives a clip; they are too short, or too long to be told")
    return Written(clips, frames, tuple(problems))


def _give_name(stage: Path, out: Path) -> None:
    """Bring a complete folder under its name, the index last."""
    for path in [*(stage / SHARDS).glob("*.jsonl"), stage / PLAN]:
        path.unlink()
    if out.is_dir() and not any(out.iterdir()):
        with suppress(OSError):  # a mount point stays
            out.rmdir()
    if not out.exists():
        stage.rename(out)
        return
    names = (SHARDS, "captions.jsonl", "index.jsonl")
    for old in [out / "index.jsonl", *out.glob("*.npz"), out / "captions.jsonl"]:
        old.unlink(missing_ok=True)
    shutil.rmtree(out / SHARDS, ignore_errors=True)
    for name in names:
        (stage / name).rename(out / name)
    stage.rmdir()
