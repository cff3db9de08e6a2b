"""Write the result of a benchmark: everything as JSON, its table as Markdown beside it and on the screen."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def write_report(out: Path | None, result: dict[str, Any], table: str) -> None:
    """Print a table; with `out`, write the result there and the table to the same name with the suffix .md."""
    if out is not None:
        write_json(out, result)
        out.with_suffix(".md").write_text(table, encoding="utf-8")
    print(table)


def write_json(out: Path, result: dict[str, Any]) -> None:
    """Write the JSON alone, as a long run does after every step; missing folders are made."""
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
