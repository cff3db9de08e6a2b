"""Captions files of users.

Either JSON lines such as `{"file": "walk.bvh", "captions": ["a person walks"]}`, or a table with the columns file and
caption.
"""

from __future__ import annotations

import csv
import io
import json
import re
import unicodedata
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from kinegraph.errors import InvalidInputError
from kinegraph.limits import MAX_TEXT
from kinegraph.validation import short_repr
from kinegraph_training.data.recording import read_bytes

_KEYS = frozenset(("file", "caption", "captions"))

Line = tuple[int, str, str]
"""Line number, name of a motion file, caption."""

_MAX_LISTED = 10
"""Names that an error message lists."""


def read_captions(path: Path) -> dict[str, tuple[str, ...]]:
    """Read a captions file; its suffix tells the format.

    Returns:
        Captions by the name of the motion file, as written.

    Raises:
        InvalidInputError: unreadable, an unknown suffix, or a line that breaks the format; the message names it.
    """
    readers = {".jsonl": _json_lines, ".csv": _comma_rows, ".tsv": _tab_rows}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InvalidInputError(f"{path} must end in {', '.join(readers)}")
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InvalidInputError(f"{path} is not UTF-8 ({error.reason}); save it as UTF-8") from error
    except InvalidInputError as error:
        raise InvalidInputError(f"{path}: {error}") from error
    captions: dict[str, list[str]] = {}
    for number, name, caption in reader(path, text):
        words = " ".join(caption.split())
        if not any(letter.isalnum() for letter in words) or len(words) > MAX_TEXT:
            allowed = f"must have words and at most {MAX_TEXT} characters"
            raise InvalidInputError(f"{path}, line {number}: the caption {words[:40]!r} {allowed}")
        _check_characters(f"{path}, line {number}", name + words)
        if not name.strip():
            raise InvalidInputError(f"{path}, line {number}: no file is named")
        captions.setdefault(name.strip(), []).append(words)
    if not captions:
        raise InvalidInputError(f"{path} holds no captions")
    return {name: tuple(texts) for name, texts in captions.items()}


def match_captions(captions: Mapping[str, tuple[str, ...]], ids: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Match captions to clips.

    A file may be named by its path below the folder or, if unique, by its name alone; with its suffix or without.

    Args:
        captions: of `read_captions`.
        ids: of the clips: paths below the folder, without suffix.

    Returns:
        Captions by clip id.

    Raises:
        InvalidInputError: captions without a file, or files without captions; the message names them.
    """
    by_name: dict[str, list[str]] = {}
    for clip_id in ids:
        for name in {clip_id, clip_id.rpartition("/")[2]}:
            by_name.setdefault(name, []).append(clip_id)
    result: dict[str, tuple[str, ...]] = {clip_id: () for hits in by_name.values() for clip_id in hits}
    unmatched = []
    for name, texts in captions.items():
        plain = name.replace("\\", "/").removeprefix("./")
        plain = re.sub(r"\.(bvh|glb)$", "", plain, flags=re.IGNORECASE)
        hits = [plain] if plain in result else by_name.get(plain, [])
        if len(hits) == 1:
            result[hits[0]] += texts
        else:
            unmatched.append(f"{name} (which of {', '.join(hits)}?)" if hits else name)
    uncaptioned = [clip_id for clip_id, texts in result.items() if not texts]
    problems = [f"captions without a file: {_list_names(unmatched)}"] if unmatched else []
    problems += [f"files without a caption: {_list_names(uncaptioned)}"] if uncaptioned else []
    if problems:
        raise InvalidInputError("; ".join(problems))
    return result


def _list_names(names: list[str]) -> str:
    more = len(names) - _MAX_LISTED
    return ", ".join(sorted(names)[:_MAX_LISTED]) + (f" and {more} more" if more > 0 else "")


def _json_lines(path: Path, text: str) -> Iterator[Line]:
    for number, line in enumerate(text.split("\n"), start=1):
        if not line.strip():
            continue
        try:
            row = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise InvalidInputError(f"{path}, line {number}: no JSON ({str(error)[:200]})") from error
        if isinstance(row, dict) and (set(row) - _KEYS or set(row) >= _KEYS):
            raise InvalidInputError(
                f"{path}, line {number}: has {', '.join(map(short_repr, list(row)[:10]))}; must have file, and either "
                "caption or captions"
            )
        match row:
            case {"file": str() as name, "captions": [*texts]} if texts and all(isinstance(t, str) for t in texts):
                yield from ((number, name, caption) for caption in texts)
            case {"file": str() as name, "caption": str() as caption}:
                yield number, name, caption
            case _:
                raise InvalidInputError(f'{path}, line {number}: must be {{"file": "x.bvh", "captions": ["..."]}}')


def _check_characters(where: str, text: str) -> None:
    """Refuse halves of surrogate pairs and control characters: no file can hold the first, nobody means the second."""
    bad = next((letter for letter in text if unicodedata.category(letter) in ("Cs", "Cc")), None)
    if bad is not None:
        raise InvalidInputError(f"{where}: the character U+{ord(bad):04X} is no text; remove it")


def _comma_rows(path: Path, text: str) -> Iterator[Line]:
    return _rows(path, text, _find_separator(text))


def _tab_rows(path: Path, text: str) -> Iterator[Line]:
    return _rows(path, text, "\t")


def _find_separator(text: str) -> str:
    """Find what separates the columns of a .csv: a comma, or the semicolon or tab that some programs write.

    The first separator in the first line is it, unless the line is quoted up to another one: names of files have none.
    """
    first = next((line for line in text.splitlines() if line.strip()), "")
    outside = re.sub(r'^\s*"(?:[^"]|"")*"', "", first)
    return min(",;\t", key=lambda separator: (outside.find(separator) % (len(outside) + 1), ",;\t".index(separator)))


def _rows(path: Path, text: str, separator: str) -> Iterator[Line]:
    # newline="": line ends within quotes are left to csv, which keeps them
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
    name = {";": "semicolon", "\t": "tab"}.get(separator, "comma")
    try:
        for row in reader:
            if not any(cell.strip() for cell in row) and len(row) < 2:
                continue
            if [cell.strip().lower() for cell in row] == ["file", "caption"]:
                continue
            if len(row) != 2:
                raise InvalidInputError(
                    f"{path}, line {reader.line_num}: {len(row)} columns instead of file and caption, separated by a "
                    f"{name}; put captions with separators in quotes"
                )
            yield reader.line_num, row[0], row[1]
    except csv.Error as error:
        raise InvalidInputError(f"{path}, line {reader.line_num}: {error}") from error
