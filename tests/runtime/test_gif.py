"""Moving pictures, read back by another program."""

from __future__ import annotations

import io
import itertools
from pathlib import Path

import numpy as np
import pytest

from kinegraph.clip import Clip
from kinegraph.errors import MissingExtraError
from kinegraph.formats import check_clip_target, encode
from support.motions import walk

image = pytest.importorskip("PIL.Image")


def clip(joints: np.ndarray, fps: float = 20.0) -> Clip:
    return Clip(joints=joints.astype(np.float32), fps=fps, seed=1, text="a person walks", bundle="none")


def pictures(data: bytes) -> tuple[list[np.ndarray], list[int]]:
    """Grey pictures and how long each is shown, ms."""
    file = image.open(io.BytesIO(data))
    found, lengths = [], []
    for number in range(file.n_frames):
        file.seek(number)
        found.append(np.asarray(file.convert("L")).astype(int))
        lengths.append(file.info["duration"])
    return found, lengths


@pytest.mark.parametrize(("fps", "frames"), [(20.0, 24), (24.0, 24), (30.0, 24), (60.0, 12), (50.0, 24)])
def test_frames_move_and_last_as_long_as_the_clip(fps: float, frames: int) -> None:
    found, lengths = pictures(encode(clip(walk(24), fps), ".gif"))
    assert len(found) == frames
    assert abs(sum(lengths) - 1000 * 24 / fps) <= 10
    assert all(np.abs(one - other).max() > 100 for one, other in itertools.pairwise(found))


def test_the_body_stands_on_the_floor_in_the_middle() -> None:
    (first, *_), _ = pictures(encode(clip(walk(3)), ".gif"))
    rows, columns = np.nonzero(first < 130)
    assert 300 <= rows.max() <= 330 and 30 < rows.min() < 120
    assert abs(columns.mean() - first.shape[1] / 2) < 20


def test_equal_clips_give_equal_bytes_and_odd_ones_are_drawn() -> None:
    assert encode(clip(walk(8)), ".gif") == encode(clip(walk(8)), ".gif") != encode(clip(walk(8, speed=0.0)), ".gif")
    assert encode(clip(walk(1) + 1000.0), ".gif")[:6] == b"GIF89a" or encode(clip(walk(1)), ".gif")[:3] == b"GIF"


def test_without_pillow_the_way_out_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("kinegraph.formats.find_spec", lambda _: None)
    with pytest.raises(MissingExtraError, match=r"kinegraph\[plot\]"):
        check_clip_target(tmp_path / "walk.gif")
