"""Clips of two machines side by side."""

from __future__ import annotations

from kinegraph import MotionPipeline
from kinegraph_benchmarks.speed.cross_platform import TEXT_OUTPUTS, clips_and_encoded_text, compare_clips


def test_text_that_another_machine_encoded_is_taken_from_it(pipe: MotionPipeline) -> None:
    theirs = clips_and_encoded_text(pipe)
    same = compare_clips(pipe, theirs)
    assert all(far["max"] == 0 for clips in same.values() for far in clips.values())
    other = {name: value * 1.1 if name.startswith(TEXT_OUTPUTS) else value for name, value in theirs.items()}
    apart = compare_clips(pipe, other)
    assert all(far["max"] == 0 for far in apart["own text"].values())
    assert all(far["mean"] > 0.01 for far in apart["the other machine's text"].values())
