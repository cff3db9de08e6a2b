"""Strict decoding of JSON into frozen dataclasses: the type hints are the schema, any deviation is an error."""

from __future__ import annotations

import dataclasses
import json
import math
import types
from collections.abc import Mapping
from typing import Any, Literal, NoReturn, TypeVar, cast, get_args, get_origin, get_type_hints

from kinegraph.errors import BundleFormatError
from kinegraph.validation import short_repr

T = TypeVar("T")


def parse_object(data: bytes, where: str) -> dict[str, Any]:
    """Parse one JSON object; repeated keys, NaN and infinity are errors.

    Args:
        data: UTF-8 text.
        where: name of the source, for messages.

    Raises:
        BundleFormatError: the bytes are not such an object.
    """

    def refuse_constant(token: str) -> NoReturn:
        raise BundleFormatError(f"{where}: {token} is not a number")

    def refuse_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        record = dict(pairs)
        if len(record) != len(pairs):
            seen: set[str] = set()
            for key, _ in pairs:
                if key in seen:
                    raise BundleFormatError(f"{where}: repeated key {short_repr(key)}")
                seen.add(key)
        return record

    try:
        value = json.loads(data.decode("utf-8"), parse_constant=refuse_constant, object_pairs_hook=refuse_repeats)
    except (ValueError, RecursionError) as error:  # ValueError: JSON, UTF-8, and integers of thousands of digits
        raise BundleFormatError(f"{where} is not valid JSON: {error}") from error
    if not isinstance(value, dict):
        raise BundleFormatError(f"{where} must be a JSON object, found {_kind(value)}")
    return value


def decode(kind: type[T], value: object, where: str) -> T:
    """Build a value of a type from parsed JSON.

    Supported are dataclasses, `tuple[X, ...]`, `Mapping[str, X]`, `Literal`, unions of scalars, str, int and float.
    An int is also a float, a bool is neither. Numbers must be finite and strings printable. Keys of fields that have a
    default may be missing: older files do not know them. None is written as a missing key, and never read.

    Args:
        kind: the type.
        value: from `parse_object`, or a part of it.
        where: path of the value, for messages.

    Raises:
        BundleFormatError: the value does not fit; the message names the path of its key.
    """
    return cast("T", _decode(kind, value, where))


def _decode(kind: Any, value: object, where: str) -> object:
    origin = get_origin(kind)
    if dataclasses.is_dataclass(kind):
        return _decode_record(kind, value, where)
    if origin is types.UnionType and dataclasses.is_dataclass(get_args(kind)[0]):
        return _decode_record(get_args(kind)[0], value, where)
    if origin is tuple:
        items = _expect(list, value, where)
        return tuple(_decode(get_args(kind)[0], item, f"{where}[{index}]") for index, item in enumerate(items))
    if origin is Mapping:
        record = _expect(dict, value, where)
        inner = get_args(kind)[1]
        return types.MappingProxyType({_text(k, where): _decode(inner, v, f"{where}.{k}") for k, v in record.items()})
    if origin is Literal:
        if not isinstance(value, str) or value not in get_args(kind):
            raise BundleFormatError(f"{where} must be one of {list(get_args(kind))}, found {short_repr(value)}")
        return value
    return _decode_scalar(get_args(kind) or (kind,), value, where)


def _decode_record(kind: Any, value: object, where: str) -> object:
    record = _expect(dict, value, where)
    hints = get_type_hints(kind)
    fields = dataclasses.fields(kind)
    names = [field.name for field in fields]
    for key in record:
        if key not in names:
            raise BundleFormatError(f"{where}: unknown key {short_repr(key)}; allowed are {names}")
    for field in fields:
        if field.name not in record and field.default is dataclasses.MISSING:
            raise BundleFormatError(f"{where}: missing key {field.name!r}")
    return kind(**{name: _decode(hints[name], record[name], f"{where}.{name}") for name in names if name in record})


def _decode_scalar(allowed: tuple[type, ...], value: object, where: str) -> object:
    if type(value) is str and str in allowed:
        return _text(value, where)
    if type(value) is int and int in allowed:
        return value
    if type(value) in (int, float) and float in allowed:
        number = _as_float(cast("float", value))
        if not math.isfinite(number):
            raise BundleFormatError(f"{where} must be a finite number")
        return number
    raise BundleFormatError(f"{where} must be {' or '.join(kind.__name__ for kind in allowed)}, found {_kind(value)}")


def _as_float(value: float) -> float:
    try:
        return float(value)
    except OverflowError:  # an integer beyond 1e308
        return math.inf


def _expect(kind: type[T], value: object, where: str) -> T:
    if not isinstance(value, kind):
        name = "a list" if kind is list else "an object"
        raise BundleFormatError(f"{where} must be {name}, found {_kind(value)}")
    return value


def _text(value: str, where: str) -> str:
    if not value.isprintable():
        raise BundleFormatError(f"{where}: {short_repr(value)} holds characters that cannot be printed")
    return value


def _kind(value: object) -> str:
    """Name the type of a value, and show a scalar; a list may be nested deeper than `repr` can follow."""
    if value is None:
        return "null"
    name = type(value).__name__
    return f"{name} {short_repr(value)}" if isinstance(value, str | int | float) else name


def to_plain(value: object) -> Any:
    """Convert dataclasses, tuples and mappings to the dicts and lists of JSON: the reverse of `decode`."""
    if dataclasses.is_dataclass(value):
        fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return {name: to_plain(item) for name, item in fields.items() if item is not None}
    if isinstance(value, Mapping):
        return {key: to_plain(item) for key, item in value.items()}
    if isinstance(value, tuple):
        return [to_plain(item) for item in value]
    return value
