"""GIF and MP4, decoded again: every frame is there, in time, and shows what the clip shows."""

from __future__ import annotations

import io
import itertools
from fractions import Fraction
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from kinegraph.clip import Clip
from kinegraph.errors import MissingExtraError, OutputError
from kinegraph.formats import check_clip_target, encode, video
from kinegraph.formats.video import SIZE, draw_pose
from support.cli_runs import fails
from support.motions import walk

Image = pytest.importorskip("PIL.Image")


@pytest.fixture
def av() -> ModuleType:
    """PyAV, which encodes and decodes video."""
    module = pytest.importorskip("av")
    if "libx264" not in module.codecs_available:
        pytest.skip("this PyAV was built without libx264")
    return module


def clip(joints: np.ndarray, fps: float = 20.0) -> Clip:
    return Clip(joints=joints.astype(np.float32), fps=fps, seed=1, text="a person walks", bundle="none")


def pictures(data: bytes) -> tuple[list[np.ndarray], list[int]]:
    """Decode a GIF to grey pictures and how long each is shown, ms."""
    file = Image.open(io.BytesIO(data))
    frames, durations = [], []
    for number in range(file.n_frames):
        file.seek(number)
        frames.append(np.asarray(file.convert("L")).astype(int))
        durations.append(file.info["duration"])
    return frames, durations


@pytest.mark.parametrize(("fps", "frames"), [(20.0, 24), (24.0, 24), (30.0, 24), (60.0, 12), (50.0, 24)])
def test_gif_frames_move_and_last_as_long_as_the_clip(fps: float, frames: int) -> None:
    shown, durations = pictures(encode(clip(walk(24), fps), ".gif"))
    assert len(shown) == frames
    assert abs(sum(durations) - 1000 * 24 / fps) <= 10
    assert all(np.abs(before - after).max() > 100 for before, after in itertools.pairwise(shown))


def test_the_body_stands_on_the_floor_in_the_middle() -> None:
    (first, *_), _ = pictures(encode(clip(walk(3)), ".gif"))
    rows, columns = np.nonzero(first < 130)
    assert 300 <= rows.max() <= 330 and 30 < rows.min() < 120
    assert abs(columns.mean() - first.shape[1] / 2) < 20


def test_equal_clips_give_equal_gifs_and_odd_ones_are_drawn() -> None:
    assert encode(clip(walk(8)), ".gif") == encode(clip(walk(8)), ".gif") != encode(clip(walk(8, speed=0.0)), ".gif")
    assert encode(clip(walk(1) + 1000.0), ".gif")[:3] == b"GIF"


def test_without_pillow_gif_names_the_extra(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("kinegraph.formats.find_spec", lambda _: None)
    with pytest.raises(MissingExtraError, match=r"kinegraph\[plot\]"):
        check_clip_target(tmp_path / "walk.gif")


@pytest.mark.parametrize(("fps", "rate"), [(20, 20), (24, 24), (29.97, Fraction(2997, 100)), (30, 30), (60, 60)])
def test_all_frames_of_a_video_come_at_their_time(av: ModuleType, fps: float, rate: Fraction) -> None:
    with av.open(io.BytesIO(encode(clip(walk(24), fps), ".mp4"))) as file:
        (stream,) = file.streams
        assert (stream.codec_context.name, stream.pix_fmt, stream.average_rate) == ("h264", "yuv420p", rate)
        assert (stream.width, stream.height) == (SIZE[0] * video.MP4_SCALE, SIZE[1] * video.MP4_SCALE)
        frames = list(file.decode(video=0))
    np.testing.assert_allclose([frame.time for frame in frames], np.arange(24) / fps, atol=1e-3)
    grey = [frame.to_ndarray(format="gray").astype(int) for frame in frames]
    assert all(np.abs(before - after).max() > 100 for before, after in itertools.pairwise(grey))


def test_a_frame_is_the_picture_of_its_pose(av: ModuleType) -> None:
    joints = walk(12)
    with av.open(io.BytesIO(encode(clip(joints), ".mp4"))) as file:
        frames = [frame.to_ndarray(format="gray").astype(float) for frame in file.decode(video=0)]
    for number in (0, 5, 11):
        drawn = np.asarray(draw_pose(joints[number], video.MP4_SCALE).convert("L")).astype(float)
        assert np.abs(frames[number] - drawn).mean() < 4
        others = [np.abs(frames[other] - drawn).mean() for other in (0, 5, 11) if other != number]
        assert np.abs(frames[number] - drawn).mean() < min(others)


@pytest.mark.usefixtures("av")
def test_equal_clips_give_equal_videos() -> None:
    first = encode(clip(walk(8)), ".mp4")
    assert first == encode(clip(walk(8)), ".mp4") != encode(clip(walk(8, speed=0.0)), ".mp4")


@pytest.mark.usefixtures("av")
@pytest.mark.parametrize("joints", [walk(1), walk(2) + 1000.0])
def test_odd_clips_are_drawn(joints: np.ndarray) -> None:
    assert encode(clip(joints), ".mp4")[4:8] == b"ftyp"


@pytest.mark.usefixtures("av")
@pytest.mark.parametrize("missing", ["av", "PIL"])
def test_without_its_packages_video_names_the_extra_before_anything_is_written(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str], missing: str
) -> None:
    monkeypatch.setattr("kinegraph.formats.find_spec", lambda name: None if name == missing else object())
    with pytest.raises(MissingExtraError, match=rf'need {missing}: pip install "kinegraph\[plot\]"'):
        clip(walk(3)).save(tmp_path / "walk.mp4")
    assert "kinegraph[plot]" in fails(capsys, "generate", "a person walks", "-o", str(tmp_path / "walk.mp4"))
    assert list(tmp_path.iterdir()) == []


def test_a_pyav_without_the_encoder_is_a_typed_error(
    av: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(av, "codecs_available", {"mpeg4"})
    with pytest.raises(MissingExtraError, match="lacks libx264"):
        clip(walk(3)).save(tmp_path / "walk.mp4")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("av")
def test_an_existing_video_stays_unless_forced(tmp_path: Path) -> None:
    (tmp_path / "walk.mp4").write_bytes(b"precious")
    with pytest.raises(OutputError, match="exists"):
        clip(walk(3)).save(tmp_path / "walk.mp4")
    assert (tmp_path / "walk.mp4").read_bytes() == b"precious"
    clip(walk(3)).save(tmp_path / "walk.mp4", force=True)
    assert [path.name for path in tmp_path.iterdir()] == ["walk.mp4"]
