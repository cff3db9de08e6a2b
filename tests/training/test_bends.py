"""Walks and runs bent into turns."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from motions import SHARED, walk

pytest.importorskip("torch")

from kinegraph.motion.skeleton import bone_lengths, facing_angle
from kinegraph_training.bends import DEGREES, RATES, bent, make_bends
from kinegraph_training.config import DataConfig
from kinegraph_training.data import MotionClip, read_split
from kinegraph_training.dataset import training_clips
from kinegraph_training.measures import FPS, foot_skate

MANNERS = ("normal", "giant", "elderly")


def clips() -> list[MotionClip]:
    return [
        MotionClip(f"{content}_{style}", walk(160), ("a person walks.",), content, style)
        for content in ("walk", "run")
        for style in MANNERS
    ]


def turned(joints: np.ndarray) -> float:
    """Degrees from the first to the last frame, to the left where positive."""
    heading = np.unwrap(facing_angle(joints))
    return float(np.degrees(heading[-1] - heading[0]))


def test_a_straight_way_becomes_an_arc() -> None:
    frames, step, angle = 101, 0.05, np.radians(np.linspace(0.0, 90.0, 101))
    joints = np.zeros((frames, 22, 3), dtype=np.float32)
    joints[:, :, 2] = step * np.arange(frames)[:, None]
    joints[:, 5] += np.float32([0.0, 0.0, 0.3])
    found = bent(joints, angle)
    # a quarter of a circle of this length, to the left of a body that faces +Z: towards +X
    radius = step * (frames - 1) / (np.pi / 2)
    np.testing.assert_allclose(found[-1, 0], [radius, 0.0, radius], atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(np.diff(found[:, 0], axis=0), axis=-1), step, atol=1e-5)
    # what is before the pelvis is before it still
    np.testing.assert_allclose(found[-1, 5] - found[-1, 0], [0.3, 0.0, 0.0], atol=1e-5)
    np.testing.assert_array_equal(found[0], joints[0])


def test_they_turn_to_their_side_by_what_their_captions_say() -> None:
    found = make_bends(clips(), 40, 3, 190)
    assert {clip.content for clip in found} == {
        f"{content}-turn-{side}" for content in ("walk", "run") for side in ("left", "right")
    }
    assert len({clip.id for clip in found}) == 40 and all(clip.any_length for clip in found)
    for clip in found:
        side = clip.content.split("-")[-1]
        degrees = turned(clip.joints) if side == "left" else -turned(clip.joints)
        said = [int(number) for caption in clip.captions for number in re.findall(r"(\d+) degrees", caption)]
        # a walk turns its pelvis by some degrees in every step
        assert len(said) == 1 and abs(degrees - said[0]) < 25.0
        assert degrees < DEGREES[1] + 20.0 and degrees / (len(clip.joints) / FPS) < RATES[1] + 20.0
        assert len(clip.captions) == 4 and all(side in caption for caption in clip.captions)
        assert all(("run" in caption or "jog" in caption) == (clip.content[:3] == "run") for caption in clip.captions
                   if "turns to the" not in caption)  # fmt: skip


def test_bones_are_kept_and_feet_do_not_slide_more() -> None:
    straight = clips()[:1]
    for clip in make_bends(straight, 10, 1, 150):
        assert np.ptp(bone_lengths(clip.joints), axis=0).max() < 5e-3
        assert foot_skate(clip.joints) < 1.15 * foot_skate(straight[0].joints) + 0.02


def test_manners_that_are_held_out_stay_straight() -> None:
    found = make_bends(clips(), 30, 5, 190, straight_manners=("elderly",))
    assert len(found) == 30 and {clip.style for clip in found} == {"normal", "giant"}


def test_the_default_preset_never_makes_a_pair_that_is_tested_as_unseen() -> None:
    from kinegraph_training.config import read_preset

    data, held = SHARED / "data" / "bandai", SHARED / "data" / "held_out_pairs.json"
    if not data.is_dir():
        pytest.skip("recorded motion (../shared/data) is not at hand")
    config = read_preset("edge").data
    few = DataConfig(
        splices=30, sequences=30, excerpts=30, paces=30, bends=90, straight_manners=config.straight_manners
    )
    unseen = {(clip.content, clip.style) for clip in read_split(data, "dev_compositional")}
    made = training_clips(data, few, held)
    assert sum(Path(clip.id).name.startswith("bend_") for clip in made) == 180
    assert not {(clip.content, clip.style) for clip in made} & unseen
    turning = {style for content, style in unseen if "turn" in content}
    assert turning == set(config.straight_manners)
