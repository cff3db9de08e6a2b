"""The description of the service's calls: OpenAPI 3.1, and a page made of it."""

from __future__ import annotations

import html
from typing import Any, Final

from kinegraph import __version__
from kinegraph.service.requests import MEDIA_TYPES

_NUMBER: Final = {"type": "number"}
_TEXT: Final = {"type": "string", "maxLength": 512}
_PROPERTIES: Final[dict[str, dict[str, Any]]] = {
    "text": {**_TEXT, "description": "a sentence, or the joint sentence of concepts"},
    "graph": {"type": "object", "description": "the graph of a sentence, as `kinegraph parse` prints it"},
    "concepts": {
        "type": "array",
        "maxItems": 8,
        "items": {"type": "object", "properties": {"text": _TEXT, "weight": _NUMBER}, "required": ["text"]},
        "description": "motions at once; a negative weight takes one away",
    },
    "texts": {
        "type": "array",
        "items": {"type": ["string", "object"]},
        "description": "sentences or graphs of a sequence",
    },
    "seconds": {"type": ["number", "array"], "description": "length; of a sequence one, or one for each part"},
    "seed": {"type": "integer", "minimum": 0, "description": "the same seed gives the same clip"},
    "seed_offsets": {
        "type": "array",
        "items": {"type": "integer", "minimum": 0},
        "description": "of the sentences of a sequence, against its seed; 0, 1, 2 ... without it",
    },
    "steps": {"type": ["integer", "array"], "description": "diffusion steps, one number or one for each level"},
    "guidance": {"type": ["number", "array"], "description": "guidance scale, one number or one for each level"},
    "foot_fix": {"type": "boolean", "default": True, "description": "hold standing feet"},
    "method": {"enum": ["auto", "fused", "latent", "semantic", "parts"], "description": "for concepts"},
    "lambdas": {"type": "array", "items": _NUMBER, "description": "shares of latent, semantic and joint text in fused"},
    "agd": {"type": "array", "items": _NUMBER, "description": "step sizes of adaptive gradient descent"},
    "constraints": {
        "type": "array",
        "items": {"type": "object", "properties": {"type": {"type": "string"}}, "required": ["type"]},
        "description": "paths, waypoints, joints and poses, as in files of constraints; of a sequence, on the whole",
    },
    "constraint_weight": {"type": "number", "description": "of all constraints against the text"},
    "layers": {
        "type": "array",
        "items": {"type": "object"},
        "description": "concepts and negations over spans of a sequence",
    },
    "format": {"enum": [suffix[1:] for suffix in MEDIA_TYPES], "default": "glb"},
    "names": {"enum": ["smpl", "mixamo"], "default": "smpl", "description": "joint names in glb and bvh"},
    "root": {"type": "boolean", "default": False, "description": "a joint that carries travel and heading"},
    "fps": {"type": "number", "minimum": 1, "maximum": 240, "description": "frames per second of the file"},
    "in_place": {"type": "boolean", "default": False, "description": "without travel over the floor"},
    "loop": {"type": "boolean", "default": False, "description": "the end leads into the beginning"},
    "character": {"type": "string", "description": "file of the server's folder of characters to put the clip on"},
}
_ERRORS: Final = {
    "400": "the request is not valid; the error says what is",
    "401": "the token is missing or wrong",
    "403": "the request comes from a page of another site",
    "413": "the request is too large",
    "503": "the queue is full; try again after `Retry-After` seconds",
}


def openapi() -> dict[str, Any]:
    """Build the OpenAPI description of all calls."""
    schema = {"type": "object", "additionalProperties": False, "properties": _PROPERTIES}
    failure = {"application/json": {"schema": {"type": "object", "properties": {"error": {"type": "string"}}}}}
    failures = {status: {"description": text, "content": failure} for status, text in _ERRORS.items()}
    content: dict[str, Any] = {media.split(";")[0]: {} for media in MEDIA_TYPES.values()}
    content["text/event-stream"] = {}
    make = {
        "summary": "Make a clip",
        "description": (
            "Answers with the file; headers Kinegraph-Seed, -Seconds, -Fps, -Bundle and -Unknown describe it. With "
            "`Accept: text/event-stream` it answers with events: `queued` {id, ahead}, `step` {level, step, steps, "
            "done, total}, and at the end `clip` {seed, seconds, fps, format, data (base64), notes} or `error` {error, "
            "status}. A client that leaves cancels its clip."
        ),
        "requestBody": {"required": True, "content": {"application/json": {"schema": schema}}},
        "responses": {"200": {"description": "the clip", "content": content}, **failures},
    }
    cancel = {
        "summary": "Cancel a clip that is streamed",
        "parameters": [{"name": "id", "in": "path", "required": True, "schema": {"type": "string"}}],
        "responses": {"204": {"description": "it stops at its next step"}, "404": {"description": "no such clip"}},
    }

    def get(summary: str, media: str = "application/json") -> dict[str, Any]:
        return {"get": {"summary": summary, "responses": {"200": {"description": "", "content": {media: {}}}}}}

    return {
        "openapi": "3.1.0",
        "info": {"title": "kinegraph", "version": __version__, "summary": "Text to human motion on a plain CPU"},
        "paths": {
            "/v1/clips": {"post": make},
            "/v1/clips/{id}": {"delete": cancel},
            "/v1/words": get("What the bundle was shown: actions and styles with an example"),
            "/v1/health": get("Whether the server is there; needs no token"),
            "/v1/metrics": get("Counts, and p50 and p95 of the stages, in Prometheus' text format", "text/plain"),
            "/v1/openapi.json": get("This description"),
        },
        "components": {"securitySchemes": {"token": {"type": "http", "scheme": "bearer"}}},
    }


def _page() -> str:
    """Format the description as a page without scripts."""
    document = openapi()
    parts = ["<!doctype html><meta charset=utf-8><title>kinegraph API</title><style>body{font:16px/1.5 sans-serif;"]
    parts.append("max-width:50em;margin:2em auto;padding:0 1em}td{padding:.1em 1em .1em 0;vertical-align:top}</style>")
    parts.append(f"<h1>kinegraph {html.escape(__version__)}</h1><p>Machine-readable: <code>/v1/openapi.json</code></p>")
    for path, methods in document["paths"].items():
        for method, call in methods.items():
            parts.append(
                f"<h2><code>{method.upper()} {html.escape(path)}</code></h2><p>{html.escape(call['summary'])}. "
            )
            parts.append(html.escape(call.get("description", "")) + "</p>")
            if "requestBody" in call:
                rows = (
                    f"<tr><td><code>{name}</code><td>{html.escape(str(kind.get('type', kind.get('enum'))))}"
                    f"<td>{html.escape(kind.get('description', ''))}"
                    for name, kind in _PROPERTIES.items()
                )
                parts.append(f"<table>{''.join(rows)}</table>")
            if "503" in call["responses"]:
                errors = (f"<tr><td>{status}<td>{html.escape(text)}" for status, text in _ERRORS.items())
                parts.append(f"<table>{''.join(errors)}</table>")
    return "".join(parts)


API_PAGE: Final = _page()
