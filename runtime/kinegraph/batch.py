"""Clips of many sentences: a table of prompts in, a folder of files and a manifest out, on all cores.

A row is made by a process that has loaded the bundle once, with one thread. Rows have fixed seeds, so that a row gives
the same file whenever, wherever and next to whichever other rows it is made. The manifest is appended to, a JSON line
for each row: a run that was interrupted goes on where it stopped.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import multiprocessing
import os
import re
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any, Final

from kinegraph.bundle.reader import manifest_digest
from kinegraph.clip import Clip
from kinegraph.errors import InvalidInputError, KinegraphError, ModelError, OutputError
from kinegraph.files import check_target
from kinegraph.formats import WRITERS, check_clip_target, check_names, check_root, constraints_json
from kinegraph.formats.character import DEFAULT_FPS, Character, check_no_names, read_character
from kinegraph.options import MAX_SEED
from kinegraph.pipeline import MotionPipeline
from kinegraph.validation import check_fps, short_repr

COLUMNS: Final = ("text", "seconds", "seed", "name", "constraints")
MANIFEST: Final = "manifest.jsonl"
MAX_ROWS: Final = 1_000_000
MAX_TABLE_BYTES: Final = 1 << 28
_AHEAD: Final = 4
"""Rows handed to each process before it asks for more."""


@dataclass(frozen=True)
class BatchRow:
    """One clip to make."""

    row: int
    """Number of the row, from 1; the head of the table does not count."""
    text: str
    seconds: float | None
    """None lets the sentence decide."""
    seed: int
    name: str
    """File name without suffix."""
    constraints: str | None = None
    """Path of a file of constraints, see `formats.constraints_json`."""


@dataclass(frozen=True)
class BatchOptions:
    """What all clips share; `Clip.save`, `resampled`, `looped`, `in_place` and `onto` document it."""

    suffix: str = ".npz"
    bundle: str | None = None
    fps: float | None = None
    names: str = "smpl"
    root: bool = False
    in_place: bool = False
    loop: bool = False
    strict: bool = False
    character: str | None = None

    def check(self) -> None:
        """Refuse options that no clip could be saved with; a character is read, and refused if it cannot be used.

        Raises:
            KinegraphError: as in `formats.encode` and `read_character`.
        """
        if self.fps is not None:
            check_fps(self.fps)
        if self.character is not None:
            suffix = read_character(self.character).suffix
            if self.suffix != suffix:
                raise InvalidInputError(f"clips on {self.character!r} are saved as {suffix}, not {self.suffix!r}")
            check_no_names(self.names)
            return
        if self.suffix not in WRITERS:
            raise InvalidInputError(f"format {self.suffix!r} must be one of {', '.join(sorted(WRITERS))}")
        check_names(self.suffix, self.names)
        check_root(self.suffix, self.root)


def read_table(path: str | os.PathLike[str], seed: int = 0) -> list[BatchRow]:
    """Read a CSV file with a head: the column text, and seconds, seed, name and constraints where wanted.

    Args:
        path: file in UTF-8; the files of constraints that it names are found from its folder.
        seed: of the first row without one; that of row k is seed + k - 1.

    Raises:
        InvalidInputError: no such file, other columns, or a value that is none; the row is named.
    """
    text, where = _read_text(Path(path)), str(path)
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        head = [name.strip().lower() for name in next(reader, [])]
        if "text" not in head or len(set(head)) != len(head) or not set(head) <= set(COLUMNS):
            shown = ",".join(head)[:80]
            raise InvalidInputError(
                f"{where}: the head is {shown!r}; it must be text, with seconds, seed, name, constraints"
            )
        filled = _filled_rows(reader, len(head), where)
        rows = [
            _row(number, dict(zip(head, values, strict=True)), seed, Path(path).parent) for number, values in filled
        ]
    except csv.Error as error:
        raise InvalidInputError(f"{where}, line {reader.line_num}: {error}") from error
    if not 1 <= len(rows) <= MAX_ROWS:
        raise InvalidInputError(f"{where} has {len(rows)} rows; 1 to {MAX_ROWS} are made")
    names: dict[str, int] = {}
    for row in rows:
        if (other := names.setdefault(row.name.lower(), row.row)) != row.row:
            raise InvalidInputError(f"{where}: rows {other} and {row.row} have the same name {row.name!r}")
    return rows


def make_batch(
    rows: Sequence[BatchRow], folder: str | os.PathLike[str], options: BatchOptions, *, workers: int | None = None
) -> Iterator[dict[str, Any]]:
    """Make the clips of a table, and yield each one's line of the manifest when it is written.

    Rows that the folder's manifest has already, with the same text, options and bundle, are left out if their file is
    there; a bundle is the same if all its files are. A row that fails gets a line with its error, and the others go on.

    Args:
        rows: from `read_table`.
        folder: for the files and `manifest.jsonl`; made if it does not exist.
        options: of all clips.
        workers: processes; None is one for each core this process may use. 1 stays in this process.

    Raises:
        InvalidInputError: options that no clip could be saved with.
        BundleError: the bundle cannot be used.
        OutputError: the folder cannot be written to.
        ModelError: a process ended, mostly for lack of memory; the manifest has what was made.
    """
    options.check()
    target = Path(folder)
    try:
        target.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"{str(target)!r} cannot be made ({error.strerror}); choose another folder") from error
    check_target(target / MANIFEST, True, (".jsonl",))
    pending = unfinished(rows, target, options)
    count = min(workers or _cores(), len(pending))
    with (target / MANIFEST).open("a+b") as manifest:
        if manifest.tell() and not _ends_line(manifest):
            manifest.write(b"\n")  # a run was killed while it wrote: its last line stays alone
        for record in _records(pending, target, options, count):
            manifest.write(json.dumps(record, ensure_ascii=False).encode() + b"\n")
            manifest.flush()
            yield record


def unfinished(rows: Sequence[BatchRow], folder: str | os.PathLike[str], options: BatchOptions) -> list[BatchRow]:
    """List the rows that `make_batch` would make."""
    target = Path(folder)
    done = _finished(target / MANIFEST)
    digest = manifest_digest(options.bundle) if done else ""

    def is_there(row: BatchRow) -> bool:
        if row.name not in done or not (target / _file(row, options)).is_file():
            return False
        try:
            return done[row.name] == (_key(row, options), digest)
        except InvalidInputError:  # a file that the row names is gone: `make` tells it
            return False

    return [row for row in rows if not is_there(row)]


class ClipMaker:
    """One process's bundle and character; makes one row at a time."""

    def __init__(self, folder: Path, options: BatchOptions, threads: int | None = 1) -> None:
        self._folder, self._options = folder, options
        self._pipeline = MotionPipeline.load(options.bundle, threads=threads)
        self._digest = manifest_digest(options.bundle)
        self._character: Character | None = None
        if options.character is not None:
            self._character = read_character(options.character)

    def make(self, row: BatchRow) -> dict[str, Any]:
        """Make and write a clip, and return its line of the manifest; an error is a line, too."""
        start = time.perf_counter()
        record = asdict(row)
        try:
            record |= {"key": _key(row, self._options), "bundle_sha256": self._digest}
            clip = self._pipeline.generate(
                row.text,
                constraints=() if row.constraints is None else constraints_json.read(row.constraints),
                seconds=row.seconds,
                seed=row.seed,
                strict=self._options.strict,
            )
            file = _file(row, self._options)
            frames, fps = self._save(clip, self._folder / file)
        except KinegraphError as error:
            return {**record, "error": " ".join(str(error).split()), "kind": type(error).__name__}
        return {
            **record,
            "file": file,
            "frames": frames,
            "fps": fps,
            "bundle": clip.bundle,
            "unknown": [words.to_dict() for words in clip.unknown],
            "notes": list(clip.notes),
            "misses": [asdict(miss) for miss in clip.misses],
            "ms": round(1000 * (time.perf_counter() - start), 1),
        }

    def _save(self, clip: Clip, path: Path) -> tuple[int, float]:
        """Write a clip as the options say, and return its frames and frame rate."""
        options = self._options
        clip = clip.looped() if options.loop else clip
        clip = clip.in_place() if options.in_place else clip
        if self._character is not None:
            shown = clip.onto(self._character, fps=options.fps or DEFAULT_FPS, root=options.root)
            shown.save(path, force=True)
            return shown.frames, shown.fps
        clip = clip if options.fps is None else clip.resampled(options.fps)
        check_clip_target(path, True)
        clip.save(path, force=True, names=options.names, root=options.root)
        return clip.frames, clip.fps


_MAKER: ClipMaker | None = None
"""Of a worker process; set once, when it starts."""


def _start(folder: Path, options: BatchOptions) -> None:
    global _MAKER
    _MAKER = ClipMaker(folder, options)


def _make(row: BatchRow) -> dict[str, Any]:
    if _MAKER is None:
        raise ModelError("the process has not loaded a bundle")
    return _MAKER.make(row)


def _records(rows: Sequence[BatchRow], folder: Path, options: BatchOptions, workers: int) -> Iterator[dict[str, Any]]:
    """Make rows in this process or in others, and yield their lines as they come."""
    if not rows:
        return
    if workers == 1:
        maker = ClipMaker(folder, options)
        yield from map(maker.make, rows)
        return
    # spawn: a fork of a process with threads may hang, and Windows has none
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, _start, (folder, options)) as pool:
        waiting = iter(rows)
        running: set[Future[dict[str, Any]]] = set()
        try:
            while True:
                # a few rows ahead of each process: a table of a million is not handed over at once
                while len(running) < _AHEAD * workers and (row := next(waiting, None)) is not None:
                    running.add(pool.submit(_make, row))
                if not running:
                    return
                finished, running = wait(running, return_when=FIRST_COMPLETED)
                for future in finished:
                    yield future.result()
        except BrokenProcessPool as error:
            raise ModelError(
                "a process ended while it made a clip, or could not load the bundle; try fewer --workers, or "
                "`kinegraph verify`. What was made stays, and the same command goes on"
            ) from error
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _cores() -> int:
    """Count the cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _file(row: BatchRow, options: BatchOptions) -> str:
    return row.name + options.suffix


def _key(row: BatchRow, options: BatchOptions) -> str:
    """Digest what a file depends on: the row but its number, the options, and age and size of the files they name.

    Raises:
        InvalidInputError: one of these files is gone.
    """
    made_of: dict[str, Any] = {**asdict(row), "row": None, **asdict(options)}
    if row.constraints is None:
        del made_of["constraints"]  # folders made before rows had constraints go on
    for name in ("character", "constraints"):
        if made_of.get(name) is not None:
            try:
                status = Path(made_of[name]).stat()
            except OSError as error:
                raise InvalidInputError(f"there is no file {made_of[name]!r} any more ({error.strerror})") from error
            made_of[name] = [made_of[name], status.st_size, status.st_mtime_ns]
    return hashlib.sha256(json.dumps(made_of, sort_keys=True).encode()).hexdigest()[:16]


def _finished(manifest: Path) -> dict[str, tuple[str, str]]:
    """Read which names a manifest has, with key and digest of the bundle.

    The last line of a name counts, torn lines do not. Lines without a digest, of earlier versions, are made again.
    """
    done: dict[str, tuple[str, str]] = {}
    if not manifest.is_file():
        return done
    with manifest.open(encoding="utf-8", errors="replace") as lines:
        for line in lines:
            try:
                record = json.loads(line)
                done[record["name"]] = (
                    (record["key"], record.get("bundle_sha256", "")) if "file" in record else ("", "")
                )
            except (ValueError, KeyError, TypeError, RecursionError):
                continue
    return done


def _ends_line(file: IO[bytes]) -> bool:
    file.seek(-1, os.SEEK_END)
    return file.read(1) == b"\n"


def _read_text(path: Path) -> str:
    try:
        if not path.is_file():
            raise InvalidInputError(f"there is no file {str(path)!r}; give a table with the column text")
        if path.stat().st_size > MAX_TABLE_BYTES:
            raise InvalidInputError(f"{str(path)!r} is larger than {MAX_TABLE_BYTES >> 20} MiB; split it")
        return path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        if isinstance(error, KinegraphError):
            raise
        raise InvalidInputError(f"{str(path)!r} cannot be read ({error}); save it as CSV in UTF-8") from error


def _filled_rows(reader: Iterator[list[str]], width: int, where: str) -> Iterator[tuple[int, list[str]]]:
    """Number the rows that are not blank, and refuse those of another width."""
    number = 0
    for values in reader:
        if not any(value.strip() for value in values):
            continue
        number += 1
        if len(values) != width:
            found = f"{len(values)} values for {width} columns"
            raise InvalidInputError(f"{where}, row {number}: {found}; quote texts with commas")
        yield number, values


def _row(number: int, values: dict[str, str], seed: int, folder: Path) -> BatchRow:
    text, seconds, own_seed, name, constraints = (values.get(column, "").strip() for column in COLUMNS)
    try:
        length = float(seconds) if seconds else None
    except ValueError:
        raise InvalidInputError(
            f"row {number}: seconds is {short_repr(seconds)}; write a number, or leave it empty"
        ) from None
    try:
        chosen = int(own_seed) if own_seed else seed + number - 1
    except ValueError:
        chosen = -1
    if not 0 <= chosen < MAX_SEED:
        raise InvalidInputError(
            f"row {number}: seed is {short_repr(own_seed or chosen)}; write a whole number from 0 to 2**63 - 1, or "
            "leave it empty"
        )
    if not name:
        slug = "-".join(re.findall(r"[a-z0-9]+", text.lower()))[:40].strip("-")
        name = f"{number:06}" + (f"_{slug}" if slug else "")
    if not re.fullmatch(r"[\w][\w .-]{0,119}", name) or name.lower() == Path(MANIFEST).stem:
        raise InvalidInputError(f"row {number}: {name[:60]!r} is no name for a file; use letters, digits, - and _")
    file = folder / constraints if constraints else None
    if file is not None and not file.is_file():
        raise InvalidInputError(f"row {number}: there is no file of constraints {str(file)[:200]!r}")
    return BatchRow(number, text, length, chosen, name, None if file is None else str(file))
