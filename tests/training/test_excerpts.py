"""Walks and runs of every length."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from support.motions import walk
from support.shared import shared_path

pytest.importorskip("torch")

from kinegraph.motion.blending import peak_accelerations
from kinegraph.motion.skeleton import bone_lengths, facing_angle
from kinegraph_training.config import DataConfig
from kinegraph_training.data.clips import MotionClip, read_split
from kinegraph_training.dataset import training_clips
from kinegraph_training.synthetic.excerpts import SHORTEST, make_excerpts, select_turning_styles

CAPTIONS = ("a person walks forward.", "a person walks nine steps.", "someone covers about ten meters.")


def clip(content: str, frames: int, style: str = "normal") -> MotionClip:
    return MotionClip(f"{content}_{frames}", walk(frames), CAPTIONS, (content,), style, steps=9)


def test_they_have_every_length_and_say_nothing_of_numbers() -> None:
    excerpts = make_excerpts([clip("walk", 160), clip("run", 50, "active")], 60, 3, 190)
    lengths = np.array([len(excerpt.joints) for excerpt in excerpts])
    assert lengths.min() >= SHORTEST and lengths.max() <= 190
    assert all(((lengths >= low) & (lengths < low + 30)).any() for low in (30, 60, 90, 120))
    assert {excerpt.action for excerpt in excerpts} == {"walk", "run"} and len(
        {excerpt.id for excerpt in excerpts}
    ) == 60
    for excerpt in excerpts:
        assert excerpt.any_length and excerpt.steps is None and len(excerpt.captions) == 3
        assert excerpt.captions[0] == CAPTIONS[0]
        assert not any(word in caption for caption in excerpt.captions for word in ("nine", "meters"))
        np.testing.assert_allclose(excerpt.joints[0, 0, [0, 2]], 0.0, atol=1e-5)
        assert abs(facing_angle(excerpt.joints)[0]) < 1e-3


def test_what_goes_on_for_longer_does_not_jump() -> None:
    short = [clip("run", 60)]
    longer = [excerpt for excerpt in make_excerpts(short, 30, 1, 110) if len(excerpt.joints) > 60]
    assert longer
    for excerpt in longer:
        assert peak_accelerations(excerpt.joints, 20).max() < 1.7 * peak_accelerations(short[0].joints, 20).max()
        assert np.ptp(bone_lengths(excerpt.joints), axis=0).max() < 5e-3


def test_turns_and_gestures_are_left_whole() -> None:
    assert make_excerpts([clip("walk-turn-left", 90), clip("wave-left-hand", 90), clip("walk", 20)], 5, 1, 190) == []


def test_manners_that_were_never_recorded_turning_are_told_apart() -> None:
    young = [clip("walk", 90, "youthful"), clip("walk-turn-left", 90, "youthful")]
    assert select_turning_styles([clip("walk", 90, "elderly"), *young, clip("wave-left-hand", 90)]) == young


def test_a_preset_asks_for_them(tmp_path: Path) -> None:
    data, held = shared_path("data", "bandai"), shared_path("data", "held_out_pairs.json")
    without, more = (
        training_clips(data, DataConfig(splices=0, sequences=0, excerpts=count, paces=count // 2), held)
        for count in (0, 20)
    )
    assert len(without) == len(more) - 60
    walks = [walk_clip for walk_clip in read_split(data, "train") if walk_clip.action == "walk"]
    straight = [walk_clip for walk_clip in more if walk_clip.id.startswith("excerpt") and walk_clip.action == "walk"]
    assert not any("elderly" in walk_clip.style for walk_clip in more if walk_clip.id.startswith(("excerpt", "pace")))
    assert straight and max(np.ptp(facing_angle(walk_clip.joints)) for walk_clip in straight) <= 0.2 + max(
        np.ptp(facing_angle(walk_clip.joints)) for walk_clip in walks
    )


def test_excerpts_of_circles_go_round() -> None:
    round_and_round = MotionClip(
        "c", walk(190, turning=4 * np.pi / 190), ("a person walks in circles.",), ("walk-circle-left",), "normal"
    )
    for excerpt in make_excerpts([round_and_round], 20, 1, 190):
        heading = np.unwrap(facing_angle(excerpt.joints))
        assert np.degrees(heading[-1] - heading[0]) >= 270.0
    half = MotionClip("h", walk(90, turning=np.pi / 90), (), ("walk-circle-left",), "normal")
    assert make_excerpts([half], 2, 1, 90) == []
