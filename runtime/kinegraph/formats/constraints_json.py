"""`.json` of constraints: a list of objects, in files, in requests to the service and to the playground alike.

    {"type": "path", "points": [[0, 0], [1, 2]], "times": [0, 4], "heading": "along", "weight": 1}
    {"type": "waypoint", "seconds": 2.5, "position": [1, 2], "heading": 90, "weight": 1}
    {"type": "joint", "joint": "left hand", "position": [0.3, 1.5, null], "seconds": 2 or [2, 3], "weight": 1}
    {"type": "keyframe", "seconds": 1, "joints": 22 of [x, y, z], "anywhere": false, "weight": 1}
    {"type": "keyframe", "seconds": 1, "rotations": 22 of [w, x, y, z], "root": [0, 0.9, 0]}: `Keyframe.from_rotations`
    {"type": "start", "joints": frames of 22 of [x, y, z], "fps": 20, "weight": 1}     the same for "end"
    {"type": "loop", "weight": 1}

Keys are the fields of `kinegraph.constraints`, with their meaning, units and defaults. Entries of kimodo's files may
stand among them: see `kimodo_json`.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path as FilePath
from typing import Any, Final, NoReturn

import numpy as np

from kinegraph.constraints import Constraint, EndPose, JointTarget, Keyframe, Loop, Path, StartPose, Waypoint
from kinegraph.errors import InvalidInputError
from kinegraph.formats import kimodo_json
from kinegraph.limits import MAX_CONSTRAINTS
from kinegraph.validation import short_repr

MAX_BYTES: Final = 8_000_000
"""Of a file: several times what the limits of one clip allow."""
MAX_LISTS: Final = 300_000
"""Lists and objects of a file: empty ones would take twenty times the memory of their text."""
TYPES: Final[dict[str, type]] = {
    "path": Path,
    "waypoint": Waypoint,
    "joint": JointTarget,
    "keyframe": Keyframe,
    "start": StartPose,
    "end": EndPose,
    "loop": Loop,
}
"""Type of an entry -> its class, whose fields are its keys."""
_POSED_KEYS: Final = ("seconds", "rotations", "root", "rest_offsets", "weight", "anywhere")
"""Keys of a keyframe by rotations: the arguments of `Keyframe.from_rotations`."""
_OPTIONAL: Final = frozenset(("times", "heading", "weight", "anywhere", "fps", "rest_offsets"))


def read(path: str | os.PathLike[str]) -> tuple[Constraint, ...]:
    """Read a file of constraints.

    Raises:
        InvalidInputError: it cannot be read, is too large, or is no list of constraints; the message names the entry.
    """
    if not isinstance(path, str | os.PathLike):
        raise InvalidInputError(f"constraints are read from a path, not from {short_repr(path)}")
    file = FilePath(path)
    try:
        if not file.is_file():
            raise InvalidInputError(f"there is no file of constraints {str(file)[:200]!r}")
        with file.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        if isinstance(error, InvalidInputError):
            raise
        raise InvalidInputError(f"cannot read constraints from {str(file)[:200]!r}: {error}") from error
    try:
        return decode(parse(data))
    except InvalidInputError as error:
        raise InvalidInputError(f"{str(file)[:200]!r}: {error}") from error


def parse(data: bytes) -> object:
    """Parse JSON; repeated keys, NaN and infinity are errors.

    Raises:
        InvalidInputError: more than `MAX_BYTES` or `MAX_LISTS`, or not such JSON.
    """
    if len(data) > MAX_BYTES:
        raise InvalidInputError(f"a file of constraints has at most {MAX_BYTES // 1_000_000} MB")
    if data.count(b"[") + data.count(b"{") > MAX_LISTS:
        raise InvalidInputError(f"a file of constraints has at most {MAX_LISTS:,} lists")

    def refuse_constant(token: str) -> NoReturn:
        raise InvalidInputError(f"{token} is not a number")

    def refuse_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        record = dict(pairs)
        if len(record) != len(pairs):
            raise InvalidInputError(f"an object has a key twice; its keys are {', '.join(record)[:200]}")
        return record

    try:
        return json.loads(data.decode("utf-8-sig"), parse_constant=refuse_constant, object_pairs_hook=refuse_repeats)
    except InvalidInputError:
        raise
    except (ValueError, RecursionError) as error:  # ValueError: JSON, UTF-8, and integers of thousands of digits
        raise InvalidInputError(f"it is not valid JSON: {str(error)[:200]}") from error


def decode(entries: object) -> tuple[Constraint, ...]:
    """Make constraints of parsed JSON.

    Args:
        entries: list of objects, ours and kimodo's.

    Raises:
        InvalidInputError: not such a list, or an entry is not valid; the message names the entry.
    """
    if not isinstance(entries, list):
        raise InvalidInputError(f"constraints must be a list of objects, not {short_repr(entries)}")
    if len(entries) > MAX_CONSTRAINTS:
        raise InvalidInputError(f"{len(entries)} constraints; {MAX_CONSTRAINTS} at most for one clip")
    made: list[Constraint] = []
    for index, entry in enumerate(entries):
        try:
            made += _decode_entry(entry)
        except InvalidInputError as error:
            raise InvalidInputError(f"constraints[{index}]: {error}") from error
    return tuple(made)


def encode(constraints: Sequence[Constraint]) -> bytes:
    """Encode constraints as a file that `read` reads; equal ones give equal bytes."""
    lines = ",\n".join(json.dumps(_to_entry(constraint)) for constraint in constraints)
    return f"[\n{lines}\n]\n".encode()


def _decode_entry(entry: object) -> list[Constraint]:
    """Make the constraints of one entry; kimodo's may have several."""
    if not isinstance(entry, dict):
        raise InvalidInputError(f"it must be an object with a type, not {short_repr(entry)}")
    kind = entry.get("type")
    if isinstance(kind, str) and kind in kimodo_json.TYPES:
        return kimodo_json.decode_entry(entry)
    if not isinstance(kind, str) or kind not in TYPES:
        allowed = ", ".join([*TYPES, *kimodo_json.TYPES])
        raise InvalidInputError(f"there is no type {short_repr(kind)}; the types are {allowed}")
    make: Callable[..., Constraint] = TYPES[kind]
    names = [field.name for field in fields(TYPES[kind])]
    if make is Keyframe and "rotations" in entry:
        make, names = Keyframe.from_rotations, list(_POSED_KEYS)
    for key in entry:
        if key != "type" and key not in names:
            raise InvalidInputError(f"unknown key {short_repr(key)}; a {kind} has {', '.join(names)}")
    for name in names:
        if name not in entry and name not in _OPTIONAL:
            raise InvalidInputError(f"a {kind} needs the key {name!r}")
    return [make(**{name: entry[name] for name in names if name in entry})]


def _to_entry(constraint: Constraint) -> dict[str, Any]:
    """Turn a constraint into JSON; keys that have their default are left out."""
    kind = next(name for name, made in TYPES.items() if type(constraint) is made)
    entry: dict[str, Any] = {"type": kind}
    for field in fields(constraint):
        value = getattr(constraint, field.name)
        if isinstance(value, np.ndarray):
            # the shortest decimals that give the same float32; float64 has them already
            value = json.loads(json.dumps(value.tolist())) if value.dtype == np.float64 else _shortest(value)
        if field.name not in _OPTIONAL or value != field.default:
            entry[field.name] = value
    return entry


def _shortest(values: np.ndarray[Any, Any]) -> Any:
    """Convert float32 to the shortest decimals that are read back as the same numbers."""
    return np.array([float(str(value)) for value in values.ravel()]).reshape(values.shape).tolist()
