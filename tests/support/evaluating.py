"""Evaluate a bundle on data without labels, by the documented command."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any
from unittest import mock

from kinegraph_benchmarks.quality import evaluate


def evaluate_once(data: Path, bundle: Path) -> dict[str, Any]:
    """Evaluate a bundle on the split `test` with one take of each clip; returns what is written of it."""
    out = data.parent / "figures.json"
    words = ["--data", data, "--bundle", bundle, "--work", data.parent / "takes", "--repeats", 1, "--out", out]
    with mock.patch.object(sys, "argv", ["evaluate", *map(str, words)]):
        assert evaluate.main() == 0
    splits: dict[str, Any] = json.loads(out.read_text())["splits"]
    assert list(splits) == ["test"]
    found: dict[str, Any] = splits["test"]
    return found
