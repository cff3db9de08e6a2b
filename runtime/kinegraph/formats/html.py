"""`.html`: clips as one page that works offline, without a server, in any browser with WebGL.

The page is built from `viewer/` at the root of the repository. Here its parts are put together with the clips, each as
the gzipped GLB that `formats.glb` writes. Its content security policy allows the page's own script and nothing else.
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

VIEWER: Final = Path(__file__).parents[1] / "viewer"
"""Folder of `page.html`, `viewer.css` and `viewer.js`, which `npm run build` in `viewer/` writes."""


def encode(clip: Clip) -> bytes:
    """Encode one clip as a page."""
    return clips_page([clip])


def clips_page(clips: Sequence[Clip]) -> bytes:
    """Render a page of one or more clips, side by side."""
    title = ", ".join(clip.text for clip in clips)
    return render_page(title, {"clips": [clip_record(clip) for clip in clips]})


def clip_record(clip: Clip) -> dict[str, Any]:
    """Describe a clip as the JSON object that the page's script reads."""
    # fixed level and no time of day: equal clips give equal bytes
    compressed = gzip.compress(glb.encode(clip), compresslevel=6, mtime=0)
    return {
        "text": clip.text,
        "seed": str(clip.seed),  # JavaScript would round it above 2**53
        "fps": clip.fps,
        "frames": clip.frames,
        "loops": clip.loops,
        "bundle": clip.bundle,
        "graph": None if clip.graph is None else clip.graph.to_dict(),
        "unknown": [words.to_dict() for words in clip.unknown],
        "notes": clip.notes,
        "misses": [{"what": miss.what, "metres": miss.metres, "worst": miss.worst} for miss in clip.misses],
        "glb": base64.b64encode(compressed).decode("ascii"),
    }


def render_page(title: str, data: object, connect: str = "'none'") -> bytes:
    """Fill the template of the page.

    Args:
        title: of the page; cut after 200 characters.
        data: JSON value that the page's script reads.
        connect: where the script may send requests to, a source list of `connect-src`.

    Returns:
        The page, UTF-8.
    """
    parts = {
        "title": html.escape(title[:200]),
        "policy": content_security_policy(connect),
        "style": _viewer_file("viewer.css"),
        # an unescaped "<" in a caption could close the script element
        "data": json.dumps(data, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c"),
        "script": _viewer_file("viewer.js"),
    }
    return re.sub(r"{{(\w+)}}", lambda match: parts[match[1]], _viewer_file("page.html")).encode()


def content_security_policy(connect: str) -> str:
    """Build the page's content security policy: its own script and style, nothing from elsewhere.

    Args:
        connect: source list of `connect-src`.
    """
    script, style = (
        base64.b64encode(hashlib.sha256(_viewer_file(name).encode()).digest()).decode("ascii")
        for name in ("viewer.js", "viewer.css")
    )
    return (
        f"default-src 'none'; script-src 'sha256-{script}'; style-src 'sha256-{style}'; img-src data: blob:; "
        f"connect-src {connect}; base-uri 'none'; form-action 'none'"
    )


@cache
def _viewer_file(name: str) -> str:
    return (VIEWER / name).read_text(encoding="utf-8")
