"""A request's JSON as what the pipeline takes; everything else is an error that says what was wrong."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from kinegraph.cli.inputs import level_numbers, level_steps
from kinegraph.concepts import Concept
from kinegraph.edits import masked, replaced, with_action, with_argument, without
from kinegraph.errors import InvalidInputError
from kinegraph.graph import SemanticGraph
from kinegraph.text.parser import check_caption

_SAMPLING: Final = frozenset(("seconds", "seed", "steps", "guidance", "foot_fix"))
_COMPOSING: Final = frozenset(("method", "lambdas", "agd"))


@dataclass(frozen=True)
class ClipRequest:
    """One clip to be made."""

    text: str | SemanticGraph | None = None
    """A sentence or its graph; None for concepts."""
    concepts: tuple[Concept, ...] | None = None
    composing: Mapping[str, Any] = field(default_factory=dict)
    """Those of method, text, lambdas and agd that are given; `MotionPipeline.compose` checks them."""
    sampling: Mapping[str, Any] = field(default_factory=dict)
    """Those of seconds, seed, steps, guidance and foot_fix that are given; `MotionPipeline.generate` checks them."""


def parse_json(data: bytes) -> dict[str, Any]:
    """The object of a request.

    Raises:
        InvalidInputError: not UTF-8, not JSON, or no object.
    """
    try:
        value = json.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InvalidInputError(f"the request is not valid JSON: {error}") from error
    if not isinstance(value, dict):
        raise InvalidInputError("the request must be a JSON object")
    return value


def caption_of(request: Mapping[str, Any]) -> str:
    """The sentence of a request to parse."""
    _known(request, {"text"})
    text = request.get("text")
    check_caption(text)
    return str(text)


def clip_request(request: Mapping[str, Any]) -> ClipRequest:
    """The wish of a request for a clip. Beside concepts, `text` is their joint sentence.

    Raises:
        InvalidInputError: unknown keys, or values that cannot be.
    """
    _known(request, {"text", "graph", "concepts", *_COMPOSING, *_SAMPLING})
    sampling = {name: _option(name, request[name]) for name in _SAMPLING & set(request)}
    if "concepts" in request:
        if "graph" in request:
            raise InvalidInputError("give either concepts or the graph of a sentence")
        composing = {name: _option(name, request[name]) for name in (_COMPOSING | {"text"}) & set(request)}
        return ClipRequest(concepts=_concepts(request["concepts"]), composing=composing, sampling=sampling)
    if alone := sorted(_COMPOSING & set(request)):
        raise InvalidInputError(f"{alone[0]} is for concepts")
    if "graph" in request:
        return ClipRequest(SemanticGraph.from_dict(request["graph"]), sampling=sampling)
    return ClipRequest(caption_of({"text": request.get("text")}), sampling=sampling)


def edited_graph(request: Mapping[str, Any]) -> SemanticGraph:
    """The graph of a request after its edit: {graph, edit: {kind, node, text, role}}.

    Raises:
        InvalidInputError: an edit that there is not.
        InvalidGraphError: a graph, node or words that cannot be.
    """
    _known(request, {"graph", "edit"})
    graph, edit = SemanticGraph.from_dict(request.get("graph")), request.get("edit")
    if not isinstance(edit, dict):
        raise InvalidInputError("edit must be a JSON object")
    _known(edit, {"kind", "node", "text", "role"})
    kind, node, text = edit.get("kind"), edit.get("node"), edit.get("text")
    if kind == "drop":
        return without(graph, node)  # type: ignore[arg-type]  # the edits check what they are given
    if kind == "mask":
        return masked(graph, node)  # type: ignore[arg-type]
    if kind == "replace":
        return replaced(graph, node, text)  # type: ignore[arg-type]
    if kind == "action":
        return with_action(graph, text)  # type: ignore[arg-type]
    if kind == "argument":
        return with_argument(graph, node, edit.get("role"), text)  # type: ignore[arg-type]
    raise InvalidInputError(f"edit.kind must be drop, mask, replace, action or argument, not {kind!r}")


def _known(record: Mapping[str, Any], keys: set[str]) -> None:
    unknown = sorted(set(record) - keys)
    if unknown:
        raise InvalidInputError(f"unknown {', '.join(map(repr, unknown))[:200]}; known are {', '.join(sorted(keys))}")


def _concepts(value: object) -> tuple[Concept, ...]:
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        raise InvalidInputError("concepts must be a list of {text, weight}")
    for item in value:
        _known(item, {"text", "weight"})
    return tuple(Concept(item.get("text"), item.get("weight", 1.0)) for item in value)


def _option(name: str, value: object) -> object:
    """Numbers may come as typed text: "7", "2.5", "15,15,20"; a seed beyond 2**53 must, as JSON would round it."""
    if not isinstance(value, str) or name in ("foot_fix", "method", "text"):
        return value
    try:
        if name == "seed":
            return int(value)
        if name == "seconds":
            return float(value)
        return level_steps(value) if name == "steps" else level_numbers(value)
    except Exception as error:
        raise InvalidInputError(f"{name}: {value[:40]!r} is not a number") from error
