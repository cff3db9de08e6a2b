"""`.html`: clips as one page that needs nothing else: no network, no server, only a browser with WebGL.

The page is built from `viewer/` at the root of the repository; here its parts are put together with the clips, each as
the gzipped GLB that `formats.glb` writes. Its content security policy lets it run its own script and load nothing.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import html
import json
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from kinegraph.formats import glb

if TYPE_CHECKING:
    from kinegraph.clip import Clip

PARTS: Final = Path(__file__).parents[1] / "viewer"
"""Folder of `clips_page.html`, `viewer.css` and `viewer.js`, which `npm run build` in `viewer/` makes."""


def encode(clip: Clip) -> bytes:
    """The page of one clip."""
    return clips_page([clip])


def clips_page(clips: Sequence[Clip]) -> bytes:
    """A page of one or more clips, side by side."""
    return render_page(", ".join(clip.text for clip in clips), {"clips": [clip_record(clip) for clip in clips]})


def clip_record(clip: Clip) -> dict[str, Any]:
    """A clip as the page's script takes it."""
    # Level 6 and no time of day: equal clips give equal bytes.
    body = gzip.compress(glb.encode(clip), compresslevel=6, mtime=0)
    return {
        "text": clip.text,
        "seed": str(clip.seed),  # beyond 2**53 JavaScript would round it
        "fps": clip.fps,
        "frames": clip.frames,
        "bundle": clip.bundle,
        "graph": None if clip.graph is None else clip.graph.to_dict(),
        "glb": base64.b64encode(body).decode("ascii"),
    }


def render_page(title: str, data: object, connect: str = "'none'") -> bytes:
    """The page with what its script reads; `connect` is where that may send requests to."""
    parts = {
        "title": html.escape(title[:200]),
        "policy": content_security_policy(connect),
        "style": _part("viewer.css"),
        # "<" would let a caption close the element it stands in.
        "data": json.dumps(data, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c"),
        "script": _part("viewer.js"),
    }
    return re.sub(r"{{(\w+)}}", lambda found: parts[found[1]], _part("page.html")).encode()


def content_security_policy(connect: str) -> str:
    """The content security policy of a page: its own script and style, and nothing from elsewhere."""
    script, style = (
        base64.b64encode(hashlib.sha256(_part(name).encode()).digest()).decode("ascii")
        for name in ("viewer.js", "viewer.css")
    )
    return (
        f"default-src 'none'; script-src 'sha256-{script}'; style-src 'sha256-{style}'; img-src data:; "
        f"connect-src {connect}; base-uri 'none'; form-action 'none'"
    )


@cache
def _part(name: str) -> str:
    return (PARTS / name).read_text(encoding="utf-8")
