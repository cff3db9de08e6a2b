"""The page of the playground: what its script is told of the bundle, and the clip that it opens with."""

from __future__ import annotations

from typing import Any, Final

from kinegraph.bundle.contract import AGD_DENOISERS, DECODER_GRADIENTS
from kinegraph.concepts import DEFAULT_LAMBDAS
from kinegraph.errors import KinegraphError, MissingExtraError
from kinegraph.formats import NAMED, check_installed
from kinegraph.formats.html import clip_record, render_page
from kinegraph.graph import ARGUMENT_ROLES
from kinegraph.motion.skeleton import JOINT_NAMES
from kinegraph.pipeline import MotionPipeline

FILES: Final = {
    ".glb": "model/gltf-binary",
    ".bvh": "text/plain; charset=us-ascii",
    ".npz": "application/zip",
    ".json": "application/json",
    ".vrma": "model/gltf-binary",
    ".html": "text/html; charset=utf-8",
    ".mp4": "video/mp4",
    ".gif": "image/gif",
    ".png": "image/png",
}
"""Suffix -> media type of the files in which a clip can be fetched."""
CHARACTER_BYTES: Final = 32 * 1024 * 1024
"""Size of a character that the page may send."""
CONNECT: Final = "'self' blob:"
"""Where the page may send requests, for its content security policy; textures of characters are blobs of the page."""
EXAMPLE: Final = "a person walks forward and waves the right hand"
EXAMPLE_SEED: Final = 7


def render_pages(pipeline: MotionPipeline) -> dict[bool, bytes]:
    """Render the page, once to make what its link says at once (False), and once to wait until asked to (True)."""
    facts = page_facts(pipeline) | {"opening": opening_clip(pipeline)}
    return {waits: render_page("kinegraph", {"play": facts | {"waits": waits}}, CONNECT) for waits in (False, True)}


def opening_clip(pipeline: MotionPipeline) -> dict[str, Any] | None:
    """Make the clip that the page opens with; None if the bundle cannot, and then the first request says why."""
    try:
        return clip_record(pipeline.generate(EXAMPLE, seed=EXAMPLE_SEED))
    except KinegraphError:
        return None


def page_facts(pipeline: MotionPipeline) -> dict[str, Any]:
    """Collect the facts about the bundle that the page's script reads."""
    manifest, vocabulary = pipeline.manifest, pipeline.vocabulary
    return {
        "bundle": f"{manifest.name} {manifest.version}",
        "seconds": manifest.seconds_limits,
        "fps": manifest.fps,
        "steps": dict(manifest.defaults.steps),
        "guidance": dict(manifest.defaults.guidance),
        "lambdas": DEFAULT_LAMBDAS,
        "agd": manifest.contracts.keys() >= set(AGD_DENOISERS.values()),
        "constrained": manifest.contracts.keys() >= set(DECODER_GRADIENTS.values()),
        "joints": list(JOINT_NAMES),
        "roles": list(ARGUMENT_ROLES),
        "files": [suffix for suffix in FILES if _is_installed(suffix)],
        "named": sorted(NAMED),
        "character_bytes": CHARACTER_BYTES,
        "example": EXAMPLE,
        "phrases": [
            {name: getattr(phrase, name) for name in ("kind", "clips", "recognised", "example", "wordings")}
            for phrase in (vocabulary.facts.phrases if vocabulary else ())
        ],
    }


def _is_installed(suffix: str) -> bool:
    try:
        check_installed(suffix)
    except MissingExtraError:
        return False
    return True
