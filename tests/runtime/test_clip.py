"""Clip: what it accepts, what it refuses, and the suffixes it can be saved under."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinegraph.clip import Clip
from kinegraph.errors import InvalidInputError
from kinegraph.formats import WRITERS
from support.motions import walk

GOOD = {"joints": walk(5), "fps": 20.0, "seed": 7, "text": "a person walks", "bundle": "edge 1"}


def clip(**changes: object) -> Clip:
    return Clip(**{**GOOD, **changes})  # type: ignore[arg-type]


def test_properties() -> None:
    five = clip()
    assert (five.frames, five.duration, five.fps, five.seed) == (5, 0.25, 20.0, 7)
    assert five.joints.dtype == np.float32


def test_joints_are_a_read_only_copy() -> None:
    source = walk(5).astype(np.float64)
    copied = clip(joints=source)
    with pytest.raises(ValueError, match="read-only"):
        copied.joints[0] = 0
    source[:] = 9
    np.testing.assert_array_equal(copied.joints, walk(5))
    assert source.flags.writeable
    with pytest.raises(AttributeError):
        copied.fps = 30.0  # type: ignore[misc]


def broken(value: float) -> np.ndarray:
    joints = walk(5)
    joints[3, 4, 1] = value
    return joints


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"joints": broken(np.nan)}, "joint 4 of frame 3"),
        ({"joints": broken(np.inf)}, "finite"),
        ({"joints": np.full((2, 22, 3), 1e300)}, "finite"),
        ({"joints": np.zeros((0, 22, 3))}, r"\(0, 22, 3\)"),
        ({"joints": np.zeros((5, 21, 3))}, r"\(5, 21, 3\)"),
        ({"joints": np.zeros((22, 3))}, r"\(22, 3\)"),
        ({"joints": np.zeros((5, 22, 3), dtype=complex)}, "complex"),
        ({"joints": "walk"}, "must be an array"),
        ({"joints": None}, "must be an array"),
        ({"joints": [[1.0], [1.0, 2.0]]}, "array"),
        ({"fps": 0}, "fps"),
        ({"fps": -20.0}, "fps"),
        ({"fps": float("nan")}, "fps"),
        ({"fps": float("inf")}, "fps"),
        ({"fps": True}, "fps"),
        ({"fps": "20"}, "fps"),
        ({"fps": 1e300}, "fps"),
        ({"fps": 0.5}, "fps"),
        ({"text": "half a pair \ud800"}, "surrogate"),
        ({"seed": -1}, "seed"),
        ({"seed": 2**63}, "seed"),
        ({"seed": 1.5}, "seed"),
        ({"seed": True}, "seed"),
        ({"text": None}, "text"),
        ({"bundle": 3}, "bundle"),
    ],
)
def test_refuses(changes: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        clip(**changes)


@pytest.mark.parametrize("suffix", sorted(WRITERS))
def test_saves_by_suffix_and_leaves_nothing_else(tmp_path: Path, suffix: str) -> None:
    for package in {".gif": ("PIL",), ".mp4": ("PIL", "av"), ".png": ("matplotlib",)}.get(suffix, ()):
        pytest.importorskip(package)
    clip().save(tmp_path / f"walk{suffix}")
    clip().save(str(tmp_path / f"again{suffix.upper()}"))
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([f"again{suffix.upper()}", f"walk{suffix}"])
    first, second = (path.read_bytes() for path in tmp_path.iterdir())
    assert first == second
    assert len(first) > 1000
