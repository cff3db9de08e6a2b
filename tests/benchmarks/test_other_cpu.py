"""Clips of two machines side by side."""

from __future__ import annotations

from kinegraph import MotionPipeline
from kinegraph_benchmarks.speed.cross_platform import PARTS, compared, saved


def test_text_that_another_machine_encoded_is_taken_from_it(pipe: MotionPipeline) -> None:
    theirs = saved(pipe)
    same = compared(pipe, theirs)
    assert all(far["max"] == 0 for clips in same.values() for far in clips.values())
    other = {name: value * 1.1 if name.startswith(PARTS) else value for name, value in theirs.items()}
    apart = compared(pipe, other)
    assert all(far["max"] == 0 for far in apart["own text"].values())
    assert all(far["mean"] > 0.01 for far in apart["the other machine's text"].values())
