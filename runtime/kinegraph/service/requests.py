"""Requests of the service: a clip of a sentence, a graph, concepts or a sequence, and the file it is wanted in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from kinegraph.clip import Clip
from kinegraph.diffusion.sampling import OnStep
from kinegraph.errors import InvalidInputError
from kinegraph.formats import check_names, check_root, encode
from kinegraph.formats.character import DEFAULT_FPS, read_character
from kinegraph.pipeline import MotionPipeline
from kinegraph.playground.jobs import generate_clip
from kinegraph.playground.schemas import ClipRequest, parse_clip_request
from kinegraph.validation import check_fps, short_repr

MEDIA_TYPES: Final = {
    ".glb": "model/gltf-binary",
    ".bvh": "text/plain; charset=utf-8",
    ".npz": "application/zip",
    ".json": "application/json",
    ".vrma": "model/gltf-binary",
}
"""Format of an answer -> its media type."""
_FILE_KEYS: Final = frozenset(("format", "names", "root", "fps", "in_place", "loop", "character"))
_SEQUENCE_KEYS: Final = frozenset(("texts", "seconds", "seed", "steps", "guidance", "foot_fix"))


@dataclass(frozen=True)
class ServiceRequest:
    """One clip, and the file in which it is answered; `Clip.save` and `onto` document the options."""

    clip: ClipRequest
    texts: tuple[str, ...] | None = None
    """Sentences of a sequence; None for another clip."""
    seconds: Any = None
    """Lengths of a sequence's parts; `MotionPipeline.sequence` checks them."""
    suffix: str = ".glb"
    names: str = "smpl"
    root: bool = False
    fps: float | None = None
    in_place: bool = False
    loop: bool = False
    character: Path | None = None

    def generate(self, pipeline: MotionPipeline, on_step: OnStep) -> Clip:
        """Make the clip, equal to that of the command line for the same arguments.

        Raises:
            KinegraphError: as in `MotionPipeline.generate`, `compose` and `sequence`.
        """
        options = self.clip
        if self.texts is None:
            clip = generate_clip(pipeline, options, on_step)
        else:
            clip = pipeline.sequence(
                self.texts,
                seconds=self.seconds,
                seed=options.seed,
                steps=options.steps,
                guidance=options.guidance,
                foot_fix=options.foot_fix,
                on_step=on_step,
            )
        clip = clip.looped(foot_fix=options.foot_fix) if self.loop else clip
        return clip.in_place() if self.in_place else clip

    def encode(self, clip: Clip) -> tuple[bytes, float]:
        """Encode the file, and return it with its frame rate.

        Raises:
            KinegraphError: as in `formats.encode` and `read_character`.
        """
        if self.character is not None:
            character = read_character(self.character)
            if character.suffix != self.suffix:
                raise InvalidInputError(f"a clip on this character is a {character.suffix}, not a {self.suffix}")
            shown = clip.onto(character, fps=self.fps or DEFAULT_FPS, root=self.root)
            return shown.encode(), shown.fps
        clip = clip if self.fps is None else clip.resampled(self.fps)
        return encode(clip, self.suffix, self.names, self.root), clip.fps


def parse_request(record: Mapping[str, Any], characters: Path | None) -> ServiceRequest:
    """Read a request.

    Args:
        record: one of text, graph, concepts and texts, sampling options, and options of the file.
        characters: folder whose files a request may name; None if there is none.

    Raises:
        InvalidInputError: unknown keys or invalid values; nothing has been made.
    """
    wanted = {key: value for key, value in record.items() if key not in _FILE_KEYS}
    texts, seconds = None, None
    if "texts" in wanted:
        if unknown := sorted(wanted.keys() - _SEQUENCE_KEYS):
            raise InvalidInputError(f"unknown {', '.join(map(repr, unknown))[:200]} beside texts")
        texts, seconds = _texts(wanted.pop("texts")), wanted.pop("seconds", None)
        wanted["text"] = texts[0]
    suffix = f".{record.get('format', 'glb')}"
    if suffix not in MEDIA_TYPES:
        formats = ", ".join(name[1:] for name in MEDIA_TYPES)
        raise InvalidInputError(f"format must be one of {formats}, not {short_repr(record['format'])}")
    flags = {key: _flag(record, key) for key in ("root", "in_place", "loop")}
    names, fps = record.get("names", "smpl"), record.get("fps")
    if not isinstance(names, str):
        raise InvalidInputError(f"names must be a text, not {short_repr(names)}")
    if fps is not None:
        check_fps(fps)
    character = None if record.get("character") is None else _character(record["character"], characters)
    if character is None:
        check_names(suffix, names)
        check_root(suffix, flags["root"])
    return ServiceRequest(
        parse_clip_request(wanted), texts, seconds, suffix, names, fps=fps, character=character, **flags
    )


def _texts(value: object) -> tuple[str, ...]:
    if not isinstance(value, list) or not value or not all(isinstance(text, str) for text in value):
        raise InvalidInputError("texts must be a list of sentences")
    return tuple(value)


def _flag(record: Mapping[str, Any], key: str) -> bool:
    value = record.get(key, False)
    if not isinstance(value, bool):
        raise InvalidInputError(f"{key} must be true or false, not {short_repr(value)}")
    return value


def _character(name: object, folder: Path | None) -> Path:
    """Find a character in the server's folder; a request cannot name a path."""
    if folder is None:
        raise InvalidInputError("this server has no characters; start it with --characters FOLDER")
    known = sorted(path.name for path in folder.iterdir() if path.suffix.lower() in (".glb", ".vrm", ".bvh"))
    if not isinstance(name, str) or name not in known:
        raise InvalidInputError(
            f"there is no character {short_repr(name)}; there are {', '.join(known)[:400] or 'none'}"
        )
    return folder / name
