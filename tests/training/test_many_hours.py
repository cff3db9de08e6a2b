"""Memory of hours of motion in shards: written and drawn from within bounds that do not grow with the motion."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

for needed in ("torch", "lightning", "tqdm"):
    pytest.importorskip(needed)

from support.many_hours import STAGES, peak_of

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]

HOURS = 300 if os.environ.get("KINEGRAPH_LONG") else 0.5
"""KINEGRAPH_LONG=1 writes 300 hours: 6 GB of disk."""


def test_hours_of_motion_take_little_memory(tmp_path: Path) -> None:
    peaks = {stage: peak_of(stage, tmp_path, HOURS) for stage in STAGES}
    for stage, peak in peaks.items():
        assert peak["peak_mb"] + peak["largest_child_mb"] < 2000, (stage, peak)
    assert (tmp_path / "data" / "index.jsonl").is_file()
