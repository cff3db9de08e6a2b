"""A valid manifest as JSON, the paths of its keys, and copies with one value changed."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

from support.synthetic_bundle import manifest_object

GOOD = manifest_object()


def paths(value: Any, here: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path of every key, and of the first item of every list."""
    items = value.items() if isinstance(value, dict) else list(enumerate(value))[:1] if isinstance(value, list) else ()
    for key, inner in items:
        yield (*here, key)
        yield from paths(inner, (*here, key))


def changed(path: tuple[Any, ...], value: object) -> dict[str, Any]:
    """Copy the valid manifest with another value at a path."""
    copied = copy.deepcopy(GOOD)
    parent: Any = copied
    for key in path[:-1]:
        parent = parent[key]
    parent[path[-1]] = value
    return copied


def dotted(path: tuple[Any, ...]) -> str:
    """Write a path as error messages do: "files.decoder.onnx.bytes"."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path).lstrip(".")


def value_at(path: tuple[Any, ...]) -> Any:
    """Return the value of the valid manifest at a path."""
    value: Any = GOOD
    for key in path:
        value = value[key]
    return value


ALL_PATHS = list(paths(GOOD))
