"""Clips of two machines side by side."""

from __future__ import annotations

import pytest

from kinegraph import MotionPipeline
from kinegraph.bundle.reader import DEFAULT_BUNDLE
from kinegraph_benchmarks.speed.cross_platform import PARTS, compared, saved

pytestmark = pytest.mark.skipif(not (DEFAULT_BUNDLE / "manifest.json").is_file(), reason="no default bundle")


def test_text_that_another_machine_encoded_is_taken_from_it() -> None:
    theirs = saved(MotionPipeline.load(threads=1))
    same = compared(MotionPipeline.load(threads=1), theirs)
    assert all(far["max"] == 0 for clips in same.values() for far in clips.values())
    other = {name: value * 1.1 if name.startswith(PARTS) else value for name, value in theirs.items()}
    apart = compared(MotionPipeline.load(threads=1), other)
    assert all(far["max"] == 0 for far in apart["own text"].values())
    assert all(far["mean"] > 0.01 for far in apart["the other machine's text"].values())
