"""Folders of motion files: which files there are, and the reader of each format."""

from __future__ import annotations

import unicodedata
from collections import Counter
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Final, cast

from kinegraph.errors import InvalidInputError
from kinegraph_training.data.captions_file import match_captions, read_captions
from kinegraph_training.data.recording import Recording, Take

READERS: Final = {
    ".bvh": "kinegraph_training.data.bvh:read_recording",
    ".glb": "kinegraph_training.data.glb:read_recording",
}
"""Suffix -> module:function that reads a file of that format, imported when it is used."""

OTHER_MOTION: Final = frozenset(
    {".amc", ".asf", ".blend", ".c3d", ".dae", ".fbx", ".gltf", ".npy", ".npz", ".pkl", ".trc"}
)
"""Suffixes of motion that is not read: it is told that such files were left out."""


def find_takes(folder: Path, captions: Path) -> tuple[list[Take], list[str]]:
    """List the motion files of a folder and its subfolders with their captions; reads no motion yet.

    Args:
        folder: searched.
        captions: captions file (`read_captions`).

    Returns:
        The takes in the order of their ids, and remarks on files that are left out.

    Raises:
        InvalidInputError: no folder, no motion files, two of one id, a name that is no text, or captions that do not
            match.
    """
    files, remarks = _find_files(folder)
    texts = match_captions(read_captions(captions), files)
    takes = [
        Take(name, files[name].relative_to(folder).as_posix(), texts[name], _reading(files[name]))
        for name in sorted(files)
    ]
    return takes, remarks


def _reading(path: Path) -> Callable[[], Recording]:
    """Return the call that reads a file."""
    module, _, function = READERS[path.suffix.lower()].partition(":")

    def read() -> Recording:
        reader = cast("Callable[[Path], Recording]", getattr(import_module(module), function))
        return reader(path)

    return read


def _find_files(folder: Path) -> tuple[dict[str, Path], list[str]]:
    """List motion files by id: the path below the folder, without suffix; and remarks on others."""
    if not folder.is_dir():
        raise InvalidInputError(f"{folder} is no folder; --bvh must name the folder with the motion files")
    files: dict[str, Path] = {}
    others: Counter[str] = Counter()
    for path in sorted(folder.rglob("*")):
        suffix = path.suffix.lower()
        if suffix in READERS and not path.is_dir():
            if not path.is_file():
                raise InvalidInputError(f"{path} is a pipe, a device or a broken link, no file; remove it")
            name = path.relative_to(folder).with_suffix("").as_posix()
            if name in files:
                raise InvalidInputError(f"{files[name]} and {path} would get the same id; rename one")
            if any(unicodedata.category(letter) in ("Cs", "Cc") for letter in name):
                raise InvalidInputError(f"the name of {str(path)!r} is no readable text; rename it")
            files[name] = path
        elif suffix in OTHER_MOTION and path.is_file():
            others[suffix] += 1
    if not files:
        raise InvalidInputError(f"{folder} holds no {' or '.join(READERS)} files{_list_others(others)}")
    return files, [f"left out{_list_others(others)}"] if others else []


def _list_others(others: Counter[str]) -> str:
    if not others:
        return ""
    counts = ", ".join(f"{count} {suffix}" for suffix, count in sorted(others.items()))
    return f": {counts} are not read; convert them to .bvh or .glb"
