"""A good manifest, every place in it, and the same with one place changed."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

from support.synthetic_bundle import manifest_object

GOOD = manifest_object()


def paths(value: Any, here: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Every key and the first item of every list."""
    items = value.items() if isinstance(value, dict) else list(enumerate(value))[:1] if isinstance(value, list) else ()
    for key, inner in items:
        yield (*here, key)
        yield from paths(inner, (*here, key))


def changed(path: tuple[Any, ...], value: object) -> dict[str, Any]:
    copied = copy.deepcopy(GOOD)
    place: Any = copied
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return copied


def dotted(path: tuple[Any, ...]) -> str:
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path).lstrip(".")


def leaf(path: tuple[Any, ...]) -> Any:
    place: Any = GOOD
    for key in path:
        place = place[key]
    return place


ALL_PATHS = list(paths(GOOD))
