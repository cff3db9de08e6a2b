"""Read BONES-SEED from its folder, as Bones Studio publishes it with its archives extracted.

    metadata/seed_metadata_v004.csv                        a row for each recording (or .parquet)
    metadata/seed_metadata_v002_temporal_labels.jsonl      timelines: what happens from when to when, in seconds
    soma_uniform/bvh/220713/jump_and_land_001__A001.bvh    77 joints of SOMA, centimetres, Y up, 120 a second

The files of NVIDIA's benchmark (Kimodo-Motion-Gen-Benchmark) divide it: lines such as `220713/jump_and_land_001__A001`
in train_split_paths.txt, test_content_split_paths.txt and test_repetition_split_paths.txt. Recordings that are mirror
images of others are left out: training mirrors every clip.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from kinegraph.errors import InvalidInputError, MissingExtraError
from kinegraph_training.data.bvh import parse_bvh, recording_of
from kinegraph_training.data.folder import PreparedClip, assign_splits
from kinegraph_training.data.recording import Recording, read_bytes
from kinegraph_training.data.timeline import Stretch, cut_recording, usable_captions
from kinegraph_training.data.understanding import Stated, understand

FPS: Final = 20.0
"""Of prepared clips."""
DESCRIPTIONS: Final = (
    *(f"content_natural_desc_{number}" for number in range(1, 5)),
    *("content_short_description", "content_short_description_2"),
)
"""Columns that hold captions. The technical description names angles and joints, as nobody types them."""
BODIES: Final = ("soma_uniform", "soma_proportional")
"""Folders of motion, the first that is there: one body for all, or each performer's own."""
SPLIT_FILES: Final = {
    "train_split_paths.txt": "train",
    "test_content_split_paths.txt": "test",
    "test_repetition_split_paths.txt": "test",
}
VAL_SHARE: Final = 0.02
"""Of the contents of training that select the model: the benchmark has no split for that."""
OWN_TEST_SHARE: Final = 0.05
"""Of the contents that are kept for a test where the benchmark's files are not there."""
_HEADER: Final = re.compile(r"(Frames\s*:\s*)(\d+)(\s+Frame\s*Time\s*:\s*)(\S+)", re.IGNORECASE)


@dataclass(frozen=True)
class SeedRecording:
    """One recording, to be converted."""

    name: str
    """Date and file name, as in the split files."""
    path: Path
    split: str
    stretches: tuple[Stretch, ...]


def find_recordings(folder: Path, splits: Path | None) -> tuple[list[SeedRecording], list[str]]:
    """List the recordings with their captions and splits; reads no motion.

    Args:
        folder: of BONES-SEED.
        splits: folder of the benchmark's split files; None looks in `folder` and in its `splits`.

    Returns:
        Recordings in the order of their names, and remarks on what was left out.

    Raises:
        InvalidInputError: a file is missing, or is not what is published.
        MissingExtraError: the metadata are Parquet, and pyarrow is not installed.
    """
    body = _body(folder)
    rows = dict(_named_rows(folder, body))
    kept = {name: row for name, row in rows.items() if not _is_mirror(name, row)}
    remarks = [f"{len(rows) - len(kept)} mirror images are left out: training mirrors every clip"] * (rows != kept)
    split_of, more = _splits(kept, folder, splits)
    timelines, unlabelled = _timelines(folder)
    recordings = []
    for name in sorted(kept.keys() & split_of.keys()):
        whole = usable_captions([str(kept[name].get(column) or "") for column in DESCRIPTIONS])
        parts = timelines.get(name.rpartition("/")[2], ())
        stretches = (*((Stretch(0.0, 0.0, whole),) if whole else ()), *parts)
        if stretches:
            recordings.append(SeedRecording(name, folder / body / "bvh" / f"{name}.bvh", split_of[name], stretches))
    untold = len(kept.keys() & split_of.keys()) - len(recordings)
    remarks += [*more, *unlabelled, *([f"{untold} recordings have no description: left out"] if untold else [])]
    if not recordings:
        raise InvalidInputError(f"{folder} has no recording that is in a split and has a description")
    return recordings, remarks


def read_seed(recording: SeedRecording) -> list[PreparedClip]:
    """Read a recording and cut it by its timeline.

    Raises:
        InvalidInputError: the file is missing or not what is published.
    """
    try:
        motion = understand(read_thinned(recording.path), Stated(scale=0.01, up="y"), FPS)
    except InvalidInputError as error:
        raise InvalidInputError(f"{recording.path}: {error}") from error
    source = "/".join(recording.path.parts[-4:])
    stretches = [stretch.later(-motion.start) for stretch in recording.stretches]
    return cut_recording(recording.name, motion.joints, stretches, source, recording.split, FPS)


def read_thinned(path: Path) -> Recording:
    """Read a BVH file at a sixth of its frames: a sixth of the numbers, and just the frames of `FPS`."""
    text = read_bytes(path).decode("utf-8-sig", errors="replace")
    head, motion, body = text.partition("\nMOTION")
    lines = body.strip().splitlines()
    header = _HEADER.match("\n".join(lines[:2])) if motion else None
    step = 1
    if header is not None and float(header[4]) > 0:
        step = max(1, round(1 / (float(header[4]) * FPS)))
    if header is None or step == 1:
        return recording_of(parse_bvh(text))
    frames = [line for line in lines[2:] if line.strip()]
    if len(frames) != int(header[2]):
        raise InvalidInputError(f"it says {header[2]} frames and holds {len(frames)}; extract or download it again")
    thin = frames[::step]
    said = f"{header[1]}{len(thin)}{header[3]}{float(header[4]) * step:.9f}"
    return recording_of(parse_bvh("\n".join([head, "MOTION", said, *thin]) + "\n"))


def _body(folder: Path) -> str:
    """Find the folder of the motion."""
    if not folder.is_dir():
        raise InvalidInputError(f"{folder} is no folder; --bones-seed names that of BONES-SEED")
    for name in BODIES:
        if (folder / name / "bvh").is_dir():
            return name
    packed = sorted(path.name for path in folder.glob("soma_*.tar*"))
    todo = f"extract {packed[-1]} there" if packed else f"it needs {' or '.join(f'{name}/bvh' for name in BODIES)}"
    raise InvalidInputError(f"{folder} holds no motion; {todo}")


def _newest(folder: Path, pattern: str) -> Path | None:
    """Find the file of the highest version."""
    return max([*folder.glob(f"metadata/{pattern}"), *folder.glob(pattern)], key=lambda path: path.name, default=None)


def _named_rows(folder: Path, body: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the rows of the metadata by the name of the recording."""
    table, column = _newest(folder, "seed_metadata_*.csv"), f"move_{body}_path"
    rows: Iterator[dict[str, Any]]
    if table is not None:
        rows = _csv_rows(table, column)
    else:
        table = _newest(folder, "seed_metadata_*.parquet")
        if table is None:
            raise InvalidInputError(f"{folder} lacks metadata/seed_metadata_*.csv (or .parquet)")
        rows = _parquet_rows(table, column)
    marker = f"{body}/bvh/"
    for row in rows:
        path = str(row.get(column) or "").replace("\\", "/")
        if not path:
            continue
        if marker not in path or not path.endswith(".bvh") or ".." in path.split("/"):
            raise InvalidInputError(f"{table}: {column} is {path[:80]!r}; it must be {marker}DATE/NAME.bvh")
        yield path.partition(marker)[2].removesuffix(".bvh"), row


def _csv_rows(path: Path, column: str) -> Iterator[dict[str, Any]]:
    wanted = (column, "is_mirror", "content_name", *DESCRIPTIONS)
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file)
            _check_columns(path, reader.fieldnames or (), column)
            for row in reader:
                yield {name: row.get(name) for name in wanted}
    except (UnicodeDecodeError, csv.Error) as error:
        raise InvalidInputError(f"{path} is no CSV in UTF-8: {error}") from error


def _parquet_rows(path: Path, column: str) -> Iterator[dict[str, Any]]:
    try:
        from pyarrow import ArrowException, parquet
    except ImportError as error:
        raise MissingExtraError(
            f"{path} needs the package pyarrow (pip install pyarrow); or put the .csv beside it, which needs nothing"
        ) from error
    try:
        file = parquet.ParquetFile(path)
        _check_columns(path, file.schema_arrow.names, column)
        wanted = [
            name for name in (column, "is_mirror", "content_name", *DESCRIPTIONS) if name in file.schema_arrow.names
        ]
        for batch in file.iter_batches(columns=wanted):
            yield from batch.to_pylist()
    except (ArrowException, OSError) as error:
        raise InvalidInputError(f"{path} cannot be read as Parquet: {error}") from error


def _check_columns(path: Path, names: Sequence[str], column: str) -> None:
    missing = [name for name in (column, DESCRIPTIONS[0]) if name not in names]
    if missing:
        raise InvalidInputError(f"{path} lacks the columns {', '.join(missing)}; it must be BONES-SEED's metadata")


def _is_mirror(name: str, row: Mapping[str, Any]) -> bool:
    return str(row.get("is_mirror")).lower() in ("true", "1", "1.0") or name.endswith("_M")


def _splits(
    rows: Mapping[str, Mapping[str, Any]], folder: Path, splits: Path | None
) -> tuple[dict[str, str], list[str]]:
    """Assign recordings to splits: by the benchmark's files, or by a hash of their content where there are none."""
    places = [splits] if splits else [folder, folder / "splits"]
    place = next((place for place in places if (place / "train_split_paths.txt").is_file()), None)
    contents = {name: str(row.get("content_name") or name) for name, row in rows.items()}
    if place is None:
        if splits is not None:
            raise InvalidInputError(
                f"{splits} lacks train_split_paths.txt; --splits names the benchmark's folder of them"
            )
        by_content = assign_splits(sorted(set(contents.values())), val=VAL_SHARE, test=OWN_TEST_SHARE)
        remark = "the benchmark's train_split_paths.txt is not there: splits go by a hash of the content (see --splits)"
        return {name: by_content[content] for name, content in contents.items()}, [remark]
    split_of = {name: split for name, split in _read_splits(place).items() if name in rows or not name.endswith("_M")}
    lost = [name for name in split_of if name not in rows]
    for name in lost:
        del split_of[name]
    training = sorted({contents[name] for name, split in split_of.items() if split == "train"})
    by_content = assign_splits(training, val=VAL_SHARE, test=0.0)
    split_of |= {name: by_content[contents[name]] for name, split in split_of.items() if split == "train"}
    remarks = [f"{len(lost)} recordings of the split files are not in the metadata, first {lost[0]}"] if lost else []
    unused = len(rows.keys() - split_of.keys())
    return split_of, remarks + ([f"{unused} recordings are in no split file: left out"] if unused else [])


def _read_splits(folder: Path) -> dict[str, str]:
    split_of: dict[str, str] = {}
    for file, split in SPLIT_FILES.items():
        path = folder / file
        try:
            names = path.read_text(encoding="utf-8").replace("\\", "/").split()
        except (OSError, UnicodeDecodeError) as error:
            raise InvalidInputError(f"{path} cannot be read: {error}; take all three from the benchmark") from error
        for line in names:
            name = line.removesuffix(".bvh").rpartition("bvh/")[2]
            if split_of.setdefault(name, split) != split:
                raise InvalidInputError(f"{path}: {name} is in the training split too; a recording has one split")
    return split_of


def _timelines(folder: Path) -> tuple[dict[str, tuple[Stretch, ...]], list[str]]:
    """Read what happens from when to when, by file name; none where the file is not there, which is remarked."""
    path = _newest(folder, "seed_metadata_*_temporal_labels.jsonl") or _newest(folder, "timelines.jsonl")
    if path is None:
        return {}, ["no temporal labels are there: clips have the captions of their whole recording alone"]
    timelines: dict[str, tuple[Stretch, ...]] = {}
    with path.open(encoding="utf-8") as file:
        for number, line in enumerate(file, start=1):
            if line.strip():
                try:
                    row = json.loads(line)
                    timelines[str(row["filename"])] = tuple(_stretches(row["events"]))
                except (ValueError, TypeError, KeyError, AttributeError) as error:
                    raise InvalidInputError(f"{path}, line {number}: no timeline ({error!r})") from error
    return timelines, []


def _stretches(events: Sequence[Mapping[str, Any]]) -> Iterator[Stretch]:
    for event in events:
        start, end = float(event["start_time"]), float(event["end_time"])
        captions = usable_captions([str(event["description"])])
        if not 0.0 <= start <= end < float("inf"):
            raise ValueError(f"an event from {start:g} to {end:g} seconds")
        if captions and start < end:
            yield Stretch(start, end, captions)
