"""Video, decoded again: every frame is there, in time, and shows what the clip shows."""

from __future__ import annotations

import io
import itertools
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from kinegraph.clip import Clip
from kinegraph.errors import MissingExtraError, OutputError
from kinegraph.formats import encode, video
from kinegraph.formats.video import SIZE, draw_pose
from support.cli_runs import fails
from support.motions import walk

av = pytest.importorskip("av")
pytest.importorskip("PIL")


def clip(joints: np.ndarray, fps: float = 20.0) -> Clip:
    return Clip(joints=joints.astype(np.float32), fps=fps, seed=1, text="a person walks", bundle="none")


@pytest.mark.parametrize(("fps", "rate"), [(20, 20), (24, 24), (29.97, Fraction(2997, 100)), (30, 30), (60, 60)])
def test_all_frames_come_at_their_time(fps: float, rate: Fraction) -> None:
    with av.open(io.BytesIO(encode(clip(walk(24), fps), ".mp4"))) as file:
        (stream,) = file.streams
        assert (stream.codec_context.name, stream.pix_fmt, stream.average_rate) == ("h264", "yuv420p", rate)
        assert (stream.width, stream.height) == (SIZE[0] * video.MP4_SCALE, SIZE[1] * video.MP4_SCALE)
        frames = list(file.decode(video=0))
    np.testing.assert_allclose([frame.time for frame in frames], np.arange(24) / fps, atol=1e-3)
    grey = [frame.to_ndarray(format="gray").astype(int) for frame in frames]
    assert all(np.abs(one - other).max() > 100 for one, other in itertools.pairwise(grey))


def test_a_frame_is_the_picture_of_its_pose() -> None:
    joints = walk(12)
    with av.open(io.BytesIO(encode(clip(joints), ".mp4"))) as file:
        frames = [frame.to_ndarray(format="gray").astype(float) for frame in file.decode(video=0)]
    for number in (0, 5, 11):
        drawn = np.asarray(draw_pose(joints[number], video.MP4_SCALE).convert("L")).astype(float)
        assert np.abs(frames[number] - drawn).mean() < 4
        others = [np.abs(frames[other] - drawn).mean() for other in (0, 5, 11) if other != number]
        assert np.abs(frames[number] - drawn).mean() < min(others)


def test_equal_clips_give_equal_bytes() -> None:
    first = encode(clip(walk(8)), ".mp4")
    assert first == encode(clip(walk(8)), ".mp4") != encode(clip(walk(8, speed=0.0)), ".mp4")


@pytest.mark.parametrize("joints", [walk(1), walk(2) + 1000.0])
def test_odd_clips_are_drawn(joints: np.ndarray) -> None:
    assert encode(clip(joints), ".mp4")[4:8] == b"ftyp"


@pytest.mark.parametrize("missing", ["av", "PIL"])
def test_without_its_packages_the_way_out_is_named_before_anything_is_made(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str], missing: str
) -> None:
    monkeypatch.setattr("kinegraph.formats.find_spec", lambda name: None if name == missing else object())
    with pytest.raises(MissingExtraError, match=rf'need {missing}: pip install "kinegraph\[plot\]"'):
        clip(walk(3)).save(tmp_path / "walk.mp4")
    assert "kinegraph[plot]" in fails(capsys, "generate", "a person walks", "-o", str(tmp_path / "walk.mp4"))
    assert list(tmp_path.iterdir()) == []


def test_a_pyav_without_the_encoder_is_a_typed_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(av, "codecs_available", {"mpeg4"})
    with pytest.raises(MissingExtraError, match="lacks libx264"):
        clip(walk(3)).save(tmp_path / "walk.mp4")
    assert list(tmp_path.iterdir()) == []


def test_an_existing_video_stays_unless_forced(tmp_path: Path) -> None:
    (tmp_path / "walk.mp4").write_bytes(b"precious")
    with pytest.raises(OutputError, match="exists"):
        clip(walk(3)).save(tmp_path / "walk.mp4")
    assert (tmp_path / "walk.mp4").read_bytes() == b"precious"
    clip(walk(3)).save(tmp_path / "walk.mp4", force=True)
    assert [path.name for path in tmp_path.iterdir()] == ["walk.mp4"]
