"""Contact sheets."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
import pytest

from kinegraph.clip import Clip
from kinegraph.errors import MissingExtraError
from kinegraph.formats import check_clip_target, encode
from support.motions import walk


def clip(joints: np.ndarray, text: str = "a person walks") -> Clip:
    return Clip(joints=joints.astype(np.float32), fps=20.0, seed=1, text=text, bundle="none")


def pixels(data: bytes) -> np.ndarray:
    """Decode a picture to grey, by another program than drew it."""
    image = pytest.importorskip("PIL.Image")
    return np.asarray(image.open(io.BytesIO(data)).convert("L")).astype(int)


@pytest.fixture(autouse=True)
def matplotlib() -> None:
    pytest.importorskip("matplotlib")


def test_a_sheet_is_a_picture_that_depends_on_the_clip_alone() -> None:
    first, again, other = (encode(clip(walk(40, speed=speed)), ".png") for speed in (0.05, 0.05, 0.02))
    assert first == again != other
    width, height = struct.unpack(">II", first[16:24])
    assert first[:8] == b"\x89PNG\r\n\x1a\n" and width > 3 * height > 600


def test_poses_differ_where_the_body_moves() -> None:
    still = np.repeat(walk(2)[:1], 30, axis=0)
    sheets = [pixels(encode(clip(motion), ".png"))[60:250] for motion in (still, walk(30))]
    ink = [[int((pose < 200).sum()) for pose in np.array_split(sheet, 10, axis=1)[1:7]] for sheet in sheets]
    # the same pose gives the same ink over and over; a walk does not
    assert np.ptp(ink[0]) < np.ptp(ink[1])


@pytest.mark.parametrize("text", ["", "costs $5 and $6", "走る人", "word " * 200, "two\nlines"])
def test_any_text_can_be_a_title(text: str) -> None:
    assert encode(clip(walk(20), text), ".png")[:4] == b"\x89PNG"


def test_one_frame_far_away_is_drawn() -> None:
    assert encode(clip(walk(1) + 1000.0), ".png")[:4] == b"\x89PNG"


def test_without_matplotlib_the_way_out_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("kinegraph.formats.find_spec", lambda package: None)
    with pytest.raises(MissingExtraError, match=r"kinegraph\[plot\]"):
        clip(walk(20)).save(tmp_path / "clip.png")
    with pytest.raises(MissingExtraError):  # before anything is computed
        check_clip_target(tmp_path / "clip.png")
    check_clip_target(tmp_path / "clip.bvh")
    assert list(tmp_path.iterdir()) == []
