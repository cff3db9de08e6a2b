"""A user's captions.

JSON lines `{"file": "walk.bvh", "captions": ["a person walks"]}`, or a table with the columns file and
caption.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from kinegraph.errors import InvalidInputError
from kinegraph.limits import MAX_TEXT

Line = tuple[int, str, str]
"""Number in the file, name of a motion file, caption."""

_SHOWN = 10


def read_captions(path: Path) -> dict[str, tuple[str, ...]]:
    """Captions by the name of the motion file, as written; the suffix of `path` says what it is.

    Raises:
        InvalidInputError: unreadable, of another kind, or a line that breaks the format; the message says.
    """
    readers = {".jsonl": _json_lines, ".csv": _comma_rows, ".tsv": _tab_rows}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InvalidInputError(f"{path} must end in {', '.join(readers)}")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InvalidInputError(f"{path} cannot be read ({error.strerror}); check the name") from error
    except UnicodeDecodeError as error:
        raise InvalidInputError(f"{path} is not UTF-8 ({error.reason}); save it as UTF-8") from error
    captions: dict[str, list[str]] = {}
    for number, name, caption in reader(path, text):
        words = " ".join(caption.split())
        if not any(letter.isalnum() for letter in words) or len(words) > MAX_TEXT:
            allowed = f"must have words and at most {MAX_TEXT} characters"
            raise InvalidInputError(f"{path}, line {number}: the caption {words[:40]!r} {allowed}")
        if not name.strip():
            raise InvalidInputError(f"{path}, line {number}: no file is named")
        captions.setdefault(name.strip(), []).append(words)
    if not captions:
        raise InvalidInputError(f"{path} holds no captions")
    return {name: tuple(texts) for name, texts in captions.items()}


def matched(captions: Mapping[str, tuple[str, ...]], ids: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Captions by clip id.

    A file may be named by its path below the folder or, if only one has it, by its name alone; with its
    suffix or without.

    Raises:
        InvalidInputError: captions without a file, or files without captions; the message names them.
    """
    by_name: dict[str, list[str]] = {}
    for each in ids:
        for name in {each, each.rpartition("/")[2]}:
            by_name.setdefault(name, []).append(each)
    result: dict[str, tuple[str, ...]] = {each: () for hits in by_name.values() for each in hits}
    lost = []
    for name, texts in captions.items():
        plain = name.replace("\\", "/").removeprefix("./")
        plain = plain[: -len(".bvh")] if plain.lower().endswith(".bvh") else plain
        hits = [plain] if plain in result else by_name.get(plain, [])
        if len(hits) == 1:
            result[hits[0]] += texts
        else:
            lost.append(f"{name} (which of {', '.join(hits)}?)" if hits else name)
    bare = [each for each, texts in result.items() if not texts]
    problems = [f"captions without a BVH file: {_some(lost)}"] if lost else []
    problems += [f"BVH files without a caption: {_some(bare)}"] if bare else []
    if problems:
        raise InvalidInputError("; ".join(problems))
    return result


def _some(names: list[str]) -> str:
    more = len(names) - _SHOWN
    return ", ".join(sorted(names)[:_SHOWN]) + (f" and {more} more" if more > 0 else "")


def _json_lines(path: Path, text: str) -> Iterator[Line]:
    for number, line in enumerate(text.split("\n"), start=1):
        if not line.strip():
            continue
        try:
            row = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise InvalidInputError(f"{path}, line {number}: no JSON ({error})") from error
        match row:
            case {"file": str() as name, "captions": [*texts]} if texts and all(isinstance(t, str) for t in texts):
                yield from ((number, name, caption) for caption in texts)
            case {"file": str() as name, "caption": str() as caption}:
                yield number, name, caption
            case _:
                raise InvalidInputError(f'{path}, line {number}: must be {{"file": "x.bvh", "captions": ["..."]}}')


def _comma_rows(path: Path, text: str) -> Iterator[Line]:
    return _rows(path, text, ",")


def _tab_rows(path: Path, text: str) -> Iterator[Line]:
    return _rows(path, text, "\t")


def _rows(path: Path, text: str, delimiter: str) -> Iterator[Line]:
    reader = csv.reader(text.splitlines(), delimiter=delimiter)
    try:
        for row in reader:
            if not row or [cell.strip().lower() for cell in row] == ["file", "caption"]:
                continue
            if len(row) != 2:
                raise InvalidInputError(
                    f"{path}, line {reader.line_num}: {len(row)} columns instead of file and caption; "
                    "put captions with separators in quotes"
                )
            yield reader.line_num, row[0], row[1]
    except csv.Error as error:
        raise InvalidInputError(f"{path}, line {reader.line_num}: {error}") from error
