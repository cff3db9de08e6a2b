"""What every benchmark ends with: all of it as JSON, the table as Markdown beside it, the table on the screen."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def write_report(out: Path, result: dict[str, Any], table: str) -> None:
    """Write `out` and `out` with the suffix .md, and print."""
    write_json(out, result)
    out.with_suffix(".md").write_text(table, encoding="utf-8")
    print(table)


def write_json(out: Path, result: dict[str, Any]) -> None:
    """The JSON alone: what a long run has so far."""
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
