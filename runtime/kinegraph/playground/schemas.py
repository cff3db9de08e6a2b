"""Requests of the playground: their JSON as typed values, or an error that says what is wrong.

In the JSON of `/api/file` a clip request is called "wish".
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeVar

from kinegraph.bundle.strict_json import parse_object
from kinegraph.clip import Clip
from kinegraph.concepts import Concept
from kinegraph.constraints import Constraint
from kinegraph.edits import masked, replaced, with_action, with_argument, without
from kinegraph.errors import BundleFormatError, InvalidInputError
from kinegraph.formats import check_names, check_root, constraints_json, encode
from kinegraph.formats.character import DEFAULT_FPS, decode_character
from kinegraph.graph import SemanticGraph
from kinegraph.layers import Layer
from kinegraph.motion.skeleton import DEFAULT_NAMES
from kinegraph.options import Guidance, Steps, parse_numbers
from kinegraph.text.parser import check_caption
from kinegraph.validation import check_fps, short_repr

N = TypeVar("N", int, float)

MAX_NESTING: Final = 16
"""Objects and lists inside one another; a file of an edited graph has 7."""
MAX_CHARACTER_LINE: Final = 64 * 1024
"""Bytes of the line of JSON in front of a character."""
CHARACTER_SUFFIXES: Final = (".glb", ".vrm")
MAX_NAME: Final = 200
"""Characters of the name of a file."""
_STRING: Final = re.compile(rb'"[^"\\]*(?:\\.[^"\\]*)*"?', re.DOTALL)
"""One that does not end is matched too: tried again from each of its quotes, it would take quadratic time."""
_BRACKET: Final = re.compile(rb"[\[\]{}]")

_SAMPLING_KEYS: Final = frozenset(("seconds", "seed", "steps", "guidance", "foot_fix"))
_SEQUENCE_KEYS: Final = frozenset(("layers", "seed_offsets"))
_COMPOSITION_KEYS: Final = frozenset(("method", "lambdas", "agd"))
_CONSTRAINT_KEYS: Final = frozenset(("constraints", "constraint_weight"))
_SHAPE_KEYS: Final = frozenset(("loop", "in_place"))
_FILE_KEYS: Final = frozenset(("names", "root", "fps"))


@dataclass(frozen=True)
class ClipRequest:
    """Request for one clip: of a sentence or a graph, of concepts, or of sentences that follow one another.

    Options hold what the JSON says: `MotionPipeline.generate`, `compose` and `sequence` check them.
    """

    text: str | SemanticGraph | None = None
    """Sentence or graph; for concepts their joint sentence, None for the default one."""
    concepts: tuple[Concept, ...] | None = None
    """Concepts to compose; None for one sentence."""
    texts: tuple[str | SemanticGraph, ...] | None = None
    """Sentences or graphs of a sequence; None for another clip."""
    method: str = "auto"
    lambdas: tuple[float, float, float] | None = None
    agd: tuple[float, float] | None = None
    seconds: Any = None
    """Length, or the lengths of a sequence's parts."""
    seed: int | None = None
    seed_offsets: Any = None
    """Of the sentences of a sequence, against its seed."""
    steps: Steps | None = None
    guidance: Guidance | None = None
    foot_fix: bool = True
    constraints: tuple[Constraint, ...] = ()
    """What the clip has to do besides, and where; of a sequence, times and places of the whole."""
    constraint_weight: float = 1.0
    layers: tuple[Layer, ...] = ()
    """Concepts over spans of a sequence."""
    draft: bool = False
    """Bend the clip that was made last to the constraints, instead of making it (`playground.drafts`)."""
    loop: bool = False
    in_place: bool = False


@dataclass(frozen=True)
class FileRequest:
    """Request for a file of one clip; `Clip.save` and `Clip.resampled` document the options."""

    clip: ClipRequest
    suffix: str = ".glb"
    names: str = DEFAULT_NAMES
    root: bool = False
    fps: float | None = None
    """Frames per second; None is the clip's own rate."""

    def encode(self, clip: Clip) -> tuple[bytes, float]:
        """Encode the file, and return it with its frame rate.

        Raises:
            KinegraphError: as in `formats.encode`.
        """
        clip = clip if self.fps is None else clip.resampled(self.fps)
        return encode(clip, self.suffix, self.names, self.root), clip.fps


@dataclass(frozen=True)
class CharacterRequest:
    """Request for a clip on a character that comes with it."""

    clip: ClipRequest
    name: str
    """Of the character's file."""
    data: bytes
    fps: float
    root: bool

    def encode(self, clip: Clip) -> bytes:
        """Encode the character's file with the clip.

        Raises:
            KinegraphError: as in `formats.character.decode_character` and `Clip.onto`.
        """
        return clip.onto(decode_character(self.data, self.name), fps=self.fps, root=self.root).encode()


def parse_json(data: bytes) -> dict[str, Any]:
    """Parse the body of a request.

    Raises:
        InvalidInputError: not UTF-8, not JSON, not an object, repeated keys, NaN, half a surrogate pair, or nested too
            deep.
    """
    # Counted before anything is parsed: the parser, and whatever shows a value, would go as deep as the request says.
    depth = 0
    for bracket in _BRACKET.findall(_STRING.sub(b"", data)):
        depth += 1 if bracket in b"[{" else -1
        if depth > MAX_NESTING:
            raise InvalidInputError(
                f"the request is not valid JSON for this server: nested more than {MAX_NESTING} deep"
            )
    try:
        record = parse_object(data, "the request")
    except BundleFormatError as error:
        raise InvalidInputError(str(error)) from error
    if b"\\u" in data:
        try:
            json.dumps(record, ensure_ascii=False).encode("utf-8")
        except UnicodeEncodeError:
            raise InvalidInputError("the request is not valid JSON: half of a surrogate pair is no character") from None
    return record


def parse_caption(record: Mapping[str, Any]) -> str:
    """Read the sentence of a request {text}.

    Raises:
        InvalidInputError: unknown keys, or an invalid sentence.
    """
    _check_keys(record, {"text"})
    text = record.get("text")
    check_caption(text)
    return str(text)


def parse_graph(record: Mapping[str, Any]) -> SemanticGraph:
    """Read the graph of a request {graph}.

    Raises:
        InvalidInputError: unknown keys.
        InvalidGraphError: an invalid graph.
    """
    _check_keys(record, {"graph"})
    return SemanticGraph.from_dict(record.get("graph"))


def parse_clip_request(record: Mapping[str, Any], *, drafts: bool = False) -> ClipRequest:
    """Read a request for a clip.

    Args:
        record: one of {text}, {graph}, {concepts} and {texts}, and options. Beside a graph, `text` is ignored; beside
            concepts, it is their joint sentence.
        drafts: whether a draft can be asked for.

    Raises:
        InvalidInputError: unknown keys, or invalid values.
    """
    what = {"text", "graph", "concepts", "texts", *({"draft"} if drafts else ())}
    _check_keys(record, {*what, *_COMPOSITION_KEYS, *_SAMPLING_KEYS, *_SHAPE_KEYS, *_CONSTRAINT_KEYS, *_SEQUENCE_KEYS})
    concepts: tuple[Concept, ...] | None = None
    texts: tuple[str | SemanticGraph, ...] | None = None
    if "texts" not in record and (misplaced := sorted(_SEQUENCE_KEYS & record.keys())):
        raise InvalidInputError(f"{misplaced[0]} is for a sequence, which has texts")
    if "texts" in record:
        if beside := sorted(record.keys() & {"text", "graph", "concepts", *_COMPOSITION_KEYS}):
            raise InvalidInputError(f"{beside[0]} is not for a sequence, which has texts")
        text, texts = None, _texts(record["texts"])
    elif "concepts" in record:
        if "graph" in record:
            raise InvalidInputError("give either concepts or the graph of a sentence")
        text, concepts = record.get("text"), _concepts(record["concepts"])
    elif misplaced := sorted(_COMPOSITION_KEYS & set(record)):
        raise InvalidInputError(f"{misplaced[0]} is for concepts")
    elif "graph" in record:
        text = SemanticGraph.from_dict(record["graph"])
    else:
        text = parse_caption({"text": record.get("text")})
    return ClipRequest(
        text=text,
        concepts=concepts,
        texts=texts,
        method=record.get("method", "auto"),
        lambdas=_numbers(record, "lambdas", float),
        agd=_numbers(record, "agd", float),
        seconds=_numbers(record, "seconds", float) if texts else _number(record, "seconds", float),
        seed=_number(record, "seed", int),
        seed_offsets=record.get("seed_offsets"),
        steps=_numbers(record, "steps", int),
        guidance=_numbers(record, "guidance", float),
        foot_fix=record.get("foot_fix", True),
        constraints=constraints_json.decode(record["constraints"]) if "constraints" in record else (),
        constraint_weight=record.get("constraint_weight", 1.0),
        layers=_layers(record["layers"]) if "layers" in record else (),
        draft=_flag(record, "draft"),
        loop=_flag(record, "loop"),
        in_place=_flag(record, "in_place"),
    )


def parse_file_request(record: Mapping[str, Any], suffixes: Sequence[str]) -> FileRequest:
    """Read a request for a file {wish, suffix, names, root, fps}.

    Raises:
        InvalidInputError: unknown keys, invalid values, or no seed.
    """
    _check_keys(record, {"wish", "suffix", *_FILE_KEYS})
    suffix, wish = record.get("suffix"), record.get("wish")
    if not isinstance(suffix, str) or suffix not in suffixes:
        raise InvalidInputError(f"suffix must be one of {', '.join(suffixes)}, not {short_repr(suffix)}")
    if not isinstance(wish, dict):
        raise InvalidInputError("wish must be a JSON object")
    clip = parse_clip_request(wish)
    if clip.seed is None:
        raise InvalidInputError("a file needs the seed of its clip: without one it would be another clip")
    options = parse_file_options(record)
    check_names(suffix, options["names"])
    check_root(suffix, options["root"])
    return FileRequest(clip, suffix, **options)


def parse_character_request(data: bytes) -> CharacterRequest:
    """Read a request for a clip on a character: a line of JSON {wish, name, root, fps}, then the character's file.

    Raises:
        InvalidInputError: no such line, unknown keys, invalid values, or no `.glb` or `.vrm`.
    """
    line, _, file = data.partition(b"\n")
    if len(line) > MAX_CHARACTER_LINE:
        raise InvalidInputError("a character comes behind a line of JSON {wish, name, root, fps}")
    record = parse_json(line)
    _check_keys(record, {"wish", "name", "root", "fps"})
    wish, name = record.get("wish"), record.get("name")
    if not isinstance(wish, dict):
        raise InvalidInputError("wish must be a JSON object")
    if not isinstance(name, str) or not name.lower().endswith(CHARACTER_SUFFIXES) or len(name) > MAX_NAME:
        raise InvalidInputError(f"a character is a .glb or .vrm file with a name of at most {MAX_NAME} characters")
    clip, options = parse_clip_request(wish), parse_file_options({k: v for k, v in record.items() if k != "wish"})
    if clip.seed is None:
        raise InvalidInputError("a character needs the seed of its clip: without one it would be another clip")
    return CharacterRequest(clip, name, file, options["fps"] or DEFAULT_FPS, options["root"])


def parse_file_options(record: Mapping[str, Any]) -> dict[str, Any]:
    """Read the options of a file: {names, root, fps}.

    Raises:
        InvalidInputError: of another type, or not a frame rate.
    """
    names, fps = record.get("names", DEFAULT_NAMES), record.get("fps")
    if not isinstance(names, str):
        raise InvalidInputError(f"names must be text, not {short_repr(names)}")
    if fps is not None:
        check_fps(fps)
    return {"names": names, "root": _flag(record, "root"), "fps": fps}


def apply_edit(record: Mapping[str, Any]) -> SemanticGraph:
    """Edit the graph of a request {graph, edit: {kind, node, text, role}}.

    Raises:
        InvalidInputError: there is no such edit.
        InvalidGraphError: an invalid graph, node or text.
    """
    _check_keys(record, {"graph", "edit"})
    graph, edit = SemanticGraph.from_dict(record.get("graph")), record.get("edit")
    if not isinstance(edit, dict):
        raise InvalidInputError("edit must be a JSON object")
    _check_keys(edit, {"kind", "node", "text", "role"})
    # The functions of `kinegraph.edits` check node, text and role.
    kind, node, text = edit.get("kind"), edit.get("node"), edit.get("text")
    if kind == "drop":
        return without(graph, node)  # type: ignore[arg-type]
    if kind == "mask":
        return masked(graph, node)  # type: ignore[arg-type]
    if kind == "replace":
        return replaced(graph, node, text)  # type: ignore[arg-type]
    if kind == "action":
        return with_action(graph, text)  # type: ignore[arg-type]
    if kind == "argument":
        return with_argument(graph, node, edit.get("role"), text)  # type: ignore[arg-type]
    raise InvalidInputError(f"edit.kind must be drop, mask, replace, action or argument, not {short_repr(kind)}")


def _check_keys(record: Mapping[str, Any], known: set[str]) -> None:
    unknown = sorted(set(record) - known)
    if unknown:
        raise InvalidInputError(f"unknown {', '.join(map(repr, unknown))[:200]}; known are {', '.join(sorted(known))}")


def _concepts(value: object) -> tuple[Concept, ...]:
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        raise InvalidInputError("concepts must be a list of {text, weight}")
    for item in value:
        _check_keys(item, {"text", "weight"})
    return tuple(Concept(item.get("text"), item.get("weight", 1.0)) for item in value)


def _layers(value: object) -> tuple[Layer, ...]:
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        raise InvalidInputError("layers must be a list of {text, begin, end, weight}")
    for item in value:
        _check_keys(item, {"text", "begin", "end", "weight"})
    return tuple(Layer(item.get("text"), item.get("begin"), item.get("end"), item.get("weight", 1.0)) for item in value)


def _texts(value: object) -> tuple[str | SemanticGraph, ...]:
    """Read the sentences of a sequence; an object among them is a graph."""
    if not isinstance(value, list) or not value or not all(isinstance(item, str | dict) for item in value):
        raise InvalidInputError("texts must be a list of sentences, or of graphs")
    return tuple(SemanticGraph.from_dict(item) if isinstance(item, dict) else item for item in value)


def _flag(record: Mapping[str, Any], key: str) -> bool:
    value = record.get(key, False)
    if not isinstance(value, bool):
        raise InvalidInputError(f"{key} must be true or false, not {short_repr(value)}")
    return value


def _number(record: Mapping[str, Any], name: str, kind: type[N]) -> Any:
    """Read a number that may be text, as typed: "2.5"; JavaScript would round a seed beyond 2**53."""
    value = record.get(name)
    if not isinstance(value, str):
        return value
    try:
        return kind(value)
    except ValueError:
        raise InvalidInputError(f"{name}: {value[:40]!r} is not a number") from None


def _numbers(record: Mapping[str, Any], name: str, kind: type[N]) -> Any:
    """Read one number or several, which may be text, as typed: "15,15,20"."""
    value = record.get(name)
    if not isinstance(value, str):
        return value
    try:
        return parse_numbers(value, kind)
    except InvalidInputError as error:
        raise InvalidInputError(f"{name}: {error}") from None
