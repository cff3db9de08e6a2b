"""Clips at other speeds, and a dataset under another normalisation."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from support.motions import walk

pytest.importorskip("torch")

from kinegraph.motion.skeleton import bone_lengths, facing_angle
from kinegraph_training.config import DataConfig
from kinegraph_training.data.clips import MotionClip, read_split
from kinegraph_training.data.folder import PreparedClip, write_data
from kinegraph_training.dataset import training_set
from kinegraph_training.synthetic.time_scaling import (
    FAST,
    MAX_SCALE,
    MIN_SCALE,
    SLOWLY,
    make_time_scaled,
    resample_catmull_rom,
    time_scaled_copies,
)

CONFIG = DataConfig(splices=0, sequences=0)


def wave(frames: np.ndarray) -> np.ndarray:
    """Evaluate smooth curves (t, 22, 3) at real frames (t,)."""
    phase = np.linspace(0.0, 3.0, 66).reshape(22, 3)
    return (np.sin(0.15 * frames[:, None, None] + phase) + 0.02 * frames[:, None, None]).astype(np.float32)


def test_a_smooth_motion_is_resampled_as_if_it_had_been_recorded_so() -> None:
    frames = 61
    for count in (46, 61, 80):
        positions = np.linspace(0, frames - 1, count)
        error = np.abs(resample_catmull_rom(wave(np.arange(frames)), count) - wave(positions))
        # one frame at each end only knows a straight line
        inside = (positions >= 1) & (positions <= frames - 2)
        assert error[inside].max() < 4e-4 and error.max() < 4e-3


def test_it_is_smoother_than_straight_lines_between_the_frames() -> None:
    slow = resample_catmull_rom(wave(np.arange(40)), 79)
    linear = np.stack([wave(np.arange(40))[i // 2 : i // 2 + 1 + i % 2].mean(axis=0) for i in range(79)])
    jerks = [np.abs(np.diff(rows, n=3, axis=0)).mean() for rows in (slow, linear)]
    assert jerks[0] < 0.5 * jerks[1]


def test_same_frames_same_motion() -> None:
    joints = walk(30)
    assert np.allclose(resample_catmull_rom(joints, 30), joints, atol=1e-6)


def test_every_clip_comes_once_more_within_the_paces_and_keeps_its_bones() -> None:
    clips = [MotionClip(str(i), walk(20 + i), ("a person walks",), ("walk",), "normal") for i in range(40)]
    paced = time_scaled_copies(clips, CONFIG, 1)
    ratios = [len(new.joints) / len(old.joints) for new, old in zip(paced, clips, strict=True)]
    assert 1 / MAX_SCALE - 0.03 < min(ratios) < 0.85 and 1.15 < max(ratios) < MAX_SCALE + 0.03
    assert min(len(clip.joints) for clip in paced) >= CONFIG.min_frames
    for new, old in zip(paced, clips, strict=True):
        assert np.abs(bone_lengths(new.joints) - bone_lengths(old.joints)[0]).max() < 2e-3
    again = time_scaled_copies(clips, CONFIG, 1)
    assert all(np.array_equal(a.joints, b.joints) for a, b in zip(paced, again, strict=True))


def test_captions_of_denoisers_say_how_fast_it_is_and_what_stays_true() -> None:
    captions = ("a person turns left by 90 degrees.", "someone walks fast.", "a man turns. he seems old.")
    clips = [
        MotionClip("turn", walk(80, turning=0.02), captions, ("walk-turn-left",), "normal"),
        MotionClip("wave", walk(80), ("a person waves.",), ("wave-left-hand",), "normal"),
        MotionClip("long", walk(190), ("a person walks.",), ("walk",), "normal"),
    ]
    scaled = make_time_scaled(clips, 40, 1, 196)
    assert len(scaled) == 40 and {clip.action for clip in scaled} == {"walk-turn-left"}
    for clip in scaled:
        slower = len(clip.joints) > 80
        assert MIN_SCALE - 0.02 < (len(clip.joints) / 80) ** (1 if slower else -1) < MAX_SCALE + 0.02
        words = SLOWLY if slower else FAST
        assert len(clip.captions) == 4 and all(any(word in caption for word in words) for caption in clip.captions)
        assert not any("walks fast" in caption and slower for caption in clip.captions)
        assert any("90 degrees" in caption for caption in clip.captions)
        assert abs(np.ptp(facing_angle(clip.joints)) - np.ptp(facing_angle(clips[0].joints))) < 0.02
    assert len({len(clip.joints) for clip in scaled}) > 10
    assert any(caption.startswith(words) for clip in scaled for caption in clip.captions for words in SLOWLY)


def written_walks(folder: Path) -> Path:
    """Two clips of a user's own."""
    walks = [PreparedClip(f"own_{i}", walk(40 + 9 * i), ("a person walks",), "own.bvh", "train") for i in range(2)]
    write_data(folder, walks, 20.0)
    return folder


def test_a_dataset_under_another_normalisation_holds_the_same_motion(tmp_path: Path) -> None:
    data = training_set(written_walks(tmp_path / "own"), CONFIG, None, paced=True)
    assert len(data.clips) == 8
    mean, std = np.full(137, 0.3, np.float32), np.linspace(0.5, 2.0, 137, dtype=np.float32)
    other = data.under(mean, std)
    for before, after in zip(data.features, other.features, strict=True):
        assert np.allclose(after * std + mean, before * data.std + data.mean, atol=1e-5)


def test_clips_that_the_index_calls_unclean_are_left_out(tmp_path: Path) -> None:
    folder = written_walks(tmp_path / "own")
    assert len(read_split(folder, "train")) == 2
    rows = [json.loads(line) for line in (folder / "index.jsonl").read_text().splitlines()]
    rows[0]["clean"] = False
    (folder / "index.jsonl").write_text("\n".join(json.dumps(row) for row in rows))
    assert [clip.id for clip in read_split(folder, "train")] == [rows[1]["id"]]
