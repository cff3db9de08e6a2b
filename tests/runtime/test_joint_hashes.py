"""The command that compares clips bit by bit before and after a change (`tests/support/joint_hashes.py`)."""

from __future__ import annotations

from kinegraph import MotionPipeline
from support.joint_hashes import joint_hashes


def test_the_same_bundle_gives_the_same_hashes_and_every_way_its_own(toy: MotionPipeline) -> None:
    first = joint_hashes(toy)
    assert first == joint_hashes(toy)
    assert len(set(first.values())) == len(first) == 12
