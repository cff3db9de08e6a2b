"""Requests of the service: a clip of a sentence, a graph, concepts or a sequence, and the file it is wanted in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from kinegraph.clip import Clip
from kinegraph.errors import InvalidInputError
from kinegraph.formats import check_names, check_root
from kinegraph.formats.character import DEFAULT_FPS, READ_SUFFIXES, check_no_names, read_character
from kinegraph.playground.schemas import FileRequest, parse_clip_request, parse_file_options
from kinegraph.validation import short_repr

MEDIA_TYPES: Final = {
    ".glb": "model/gltf-binary",
    ".bvh": "text/plain; charset=utf-8",
    ".npz": "application/zip",
    ".json": "application/json",
    ".vrma": "model/gltf-binary",
}
"""Format of an answer -> its media type."""
_FILE_KEYS: Final = frozenset(("format", "names", "root", "fps", "character"))


@dataclass(frozen=True)
class ServiceRequest(FileRequest):
    """One clip, and the file in which it is answered."""

    character: Path | None = None

    def encode(self, clip: Clip) -> tuple[bytes, float]:
        """Encode the file, and return it with its frame rate.

        Raises:
            KinegraphError: as in `formats.encode` and `read_character`.
        """
        if self.character is None:
            return super().encode(clip)
        character = read_character(self.character)
        if character.suffix != self.suffix:
            raise InvalidInputError(f"a clip on this character is a {character.suffix}, not a {self.suffix}")
        shown = clip.onto(character, fps=self.fps or DEFAULT_FPS, root=self.root)
        return shown.encode(), shown.fps


def parse_request(record: Mapping[str, Any], characters: Path | None) -> ServiceRequest:
    """Read a request.

    Args:
        record: one of text, graph, concepts and texts, sampling options, and options of the file.
        characters: folder whose files a request may name; None if there is none.

    Raises:
        InvalidInputError: unknown keys or invalid values; nothing has been made.
    """
    clip = parse_clip_request({key: value for key, value in record.items() if key not in _FILE_KEYS})
    suffix = f".{record.get('format', 'glb')}"
    if suffix not in MEDIA_TYPES:
        formats = ", ".join(name[1:] for name in MEDIA_TYPES)
        raise InvalidInputError(f"format must be one of {formats}, not {short_repr(record['format'])}")
    options = parse_file_options(record)
    character = None if record.get("character") is None else _character(record["character"], characters)
    if character is None:
        check_names(suffix, options["names"])
        check_root(suffix, options["root"])
    else:
        check_no_names(options["names"])
    return ServiceRequest(clip, suffix, **options, character=character)


def _character(name: object, folder: Path | None) -> Path:
    """Find a character in the server's folder; a request cannot name a path."""
    if folder is None:
        raise InvalidInputError("this server has no characters; start it with --characters FOLDER")
    known = sorted(path.name for path in folder.iterdir() if path.suffix.lower() in READ_SUFFIXES)
    if not isinstance(name, str) or name not in known:
        raise InvalidInputError(
            f"there is no character {short_repr(name)}; there are {', '.join(known)[:400] or 'none'}"
        )
    return folder / name
