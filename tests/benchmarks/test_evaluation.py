"""The parts of `quality.evaluate`: claims of captions, recognition, near twins, cached takes, tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from kinegraph.motion.skeleton import bone_lengths
from kinegraph_benchmarks.common.caption_claims import Claim, count_steps, hand_height, parse_claims
from kinegraph_benchmarks.common.label_classifier import LabelClassifier
from kinegraph_benchmarks.common.sample_cache import BundleModel, cache_folder, captions_for_take, load_or_generate
from kinegraph_benchmarks.common.scores import (
    Judges,
    Reference,
    average_repeats,
    has_near_twin,
    label_hits,
    mean_rates,
    rates_by_label,
)
from kinegraph_benchmarks.quality.evaluate import markdown_table, score_captured
from kinegraph_training.data.clips import MotionClip, read_split
from support.motions import posed, t_pose, turn, walk
from support.shared import shared_path


def clip(content: str, joints: np.ndarray, style: str = "normal", *captions: str) -> MotionClip:
    return MotionClip(content, joints.astype(np.float32), captions or ("a person moves.",), (content,), style)


@pytest.mark.parametrize(
    ("caption", "expected"),
    [
        ("a person takes six steps forward", [Claim("steps", "6")]),
        ("someone turns left by about 90 degrees", [Claim("degrees", "90")]),
        ("raises both hands to shoulder height", [Claim("height", "shoulder height")]),
        (
            "lifts an arm above their head after two slow steps",
            [Claim("steps", "2"), Claim("height", "above the head")],
        ),
        ("a person walks a few steps, headed home", []),
    ],
)
def test_claims_are_read_from_captions(caption: str, expected: list[Claim]) -> None:
    assert parse_claims(caption) == expected


def test_steps_are_counted_as_the_labels_count_them() -> None:
    clips = [clip for clip in read_split(shared_path("data", "bandai"), "dev_test") if clip.steps]
    assert np.mean([count_steps(clip.joints) == clip.steps for clip in clips]) > 0.85 and len(clips) == 33


def test_steps_are_counted() -> None:
    # The legs of the figure change places every pi / 0.35 = 9 frames.
    assert count_steps(walk(60)) == int(59 * 0.35 / np.pi) == 6
    assert count_steps(walk(60, turning=0.02, heading=1.0)) == 6
    assert count_steps(t_pose(20)) == 0
    assert Claim("steps", "7").holds(walk(64)) and not Claim("steps", "4").holds(walk(64))


def test_degrees_may_miss_by_thirty() -> None:
    pivot = np.stack([posed(np.zeros(3), {0: turn("y", angle)}) for angle in np.linspace(0, np.pi / 2, 30)])
    assert Claim("degrees", "90").holds(pivot) and Claim("degrees", "110").holds(pivot)
    assert not Claim("degrees", "180").holds(pivot)


def test_the_hand_that_is_moved_tells_its_height() -> None:
    up = {16: turn("z", 1.2), 17: turn("z", 1.4)}
    one = np.repeat(posed(np.zeros(3), up)[None], 3, axis=0)
    assert hand_height(one) > 0.2
    assert Claim("height", "above the head").holds(one) and not Claim("height", "shoulder height").holds(one)
    level = np.repeat(posed(np.zeros(3), {17: turn("z", 1.4)})[None], 3, axis=0)
    assert Claim("height", "shoulder height").holds(level) and not Claim("height", "above the head").holds(level)


def test_recognition_tells_what_it_was_shown() -> None:
    def some(number: int) -> list[MotionClip]:
        fast, still = walk(40 + number, speed=0.1 + number * 1e-3), t_pose(30 + number)
        return [clip("run", fast, "active"), clip("stand", still + number * 1e-3, "calm")]

    classifier = LabelClassifier([one for number in range(8) for one in some(number)])
    unseen = [one.joints for one in some(20)]
    assert classifier(unseen, "content") == ["run", "stand"]
    assert classifier(unseen, "style") == ["active", "calm"]


def test_each_pair_has_its_own_rates() -> None:
    captured = [clip("walk", walk(60, speed=0.05), "old"), clip("walk", walk(60, speed=0.05), "old"),
                clip("run", walk(60, speed=0.15), "old"), clip("sit", t_pose(60), "calm")]  # fmt: skip
    judge = LabelClassifier(captured)
    # one of two walks stands still instead
    made = [captured[0].joints, captured[3].joints, captured[2].joints, captured[3].joints]
    hits = label_hits(made, captured, judge)
    found = rates_by_label(hits, Reference(captured, np.zeros((4, 1), np.float32)))
    assert mean_rates(hits) == {"behaviour": 2 / 3, "content": 0.75, "style": 0.75}
    assert list(found) == ["run/old", "sit/calm", "walk/old"]
    assert found["walk/old"] == {"content": 0.5, "style": 0.5, "behaviour": 0.5}
    assert found["sit/calm"] == {"content": 1.0, "style": 1.0}
    assert found["run/old"]["content"] == 1.0


def test_a_twin_is_a_near_clip_of_the_same_label() -> None:
    train = [clip("walk", walk(50)), clip("run", walk(50, speed=0.1))]
    near, far, other = walk(50) + 0.005, walk(50) + 0.5, walk(50)
    assert has_near_twin([clip("walk", near), clip("walk", far), clip("bow", other)], train) == [True, False, False]


class FakeModel:
    """Counts what it is asked for."""

    name, stamp, fps, seconds_limits = "fake", "s1", 20.0, (0.8, 9.8)

    def __init__(self) -> None:
        self.calls: list[tuple[str, float, int]] = []

    def generate(self, caption: str, *, seconds: float, seed: int, **options: object) -> SimpleNamespace:
        self.calls.append((caption, seconds, seed))
        return SimpleNamespace(joints=walk(round(seconds * 20), speed=0.01 * len(caption)))


def test_takes_are_kept_and_belong_to_their_model(tmp_path: Path) -> None:
    clips = [clip("walk", walk(40), "normal", "walks", "is walking"), clip("dance", walk(300), "normal", "dances", "d")]
    model = FakeModel()
    folder = cache_folder(model, tmp_path, "dev", clips, {})
    motions, captions = load_or_generate(model, clips, 1, folder)
    assert captions == ["is walking", "dances"]
    assert model.calls == [("is walking", 2.0, 1000), ("dances", 9.8, 1001)]
    again, _ = load_or_generate(model, clips, 1, folder)
    assert len(model.calls) == 2, "nothing is generated twice"
    for one, two in zip(motions, again, strict=True):
        np.testing.assert_array_equal(one, two)
    other = FakeModel()
    other.stamp = "s2"
    assert (
        cache_folder(other, tmp_path, "dev", clips, {})
        != folder
        != cache_folder(model, tmp_path, "dev", clips, {"g": 4})
    )


def test_a_take_holds_captions_of_every_kind_and_all_takes_hold_all() -> None:
    clips = [clip("walk", walk(20), "normal", *(f"{row}{kind}" for kind in "abc")) for row in range(5)]
    takes = [captions_for_take(clips, take) for take in range(3)]
    assert takes[0] == ["0a", "1b", "2c", "3a", "4b"]
    asked = sorted(caption for take in takes for caption in take)
    assert asked == sorted(caption for one in clips for caption in one.captions)
    assert captions_for_take(clips, 3) == takes[0], "takes of one caption are told apart for multimodality"


def test_a_bundle_with_another_spacing_makes_other_clips_and_has_a_cache_of_its_own(toy_bundle: Path) -> None:
    pytest.importorskip("spacy")
    shipped, trailing = BundleModel(toy_bundle), BundleModel(toy_bundle, spacing="trailing")
    same = BundleModel(toy_bundle, spacing="leading", base="empty")
    assert shipped.stamp == same.stamp != trailing.stamp
    clips = [model.generate("a person walks", seconds=1.0, seed=0).joints for model in (shipped, same, trailing)]
    np.testing.assert_array_equal(clips[0], clips[1])
    assert np.abs(clips[0] - clips[2]).max() > 1e-4


class Blind:
    """Judges that see nothing, the same nothing for everything."""

    def embed_motions(self, clips: Sequence[np.ndarray]) -> np.ndarray:
        return np.random.default_rng(0).standard_normal((len(clips), 4)).astype(np.float32)

    embed_captions = embed_motions

    def __call__(self, motions: Sequence[np.ndarray], name: str) -> list[str]:
        return ["walk"] * len(motions)


def test_one_repeat_is_enough_to_measure_claims() -> None:
    captions = ("a person walks", "a person takes seven steps", "turns by 90 degrees", "raises a hand to head height")
    clips = [clip("walk", walk(64, speed=0.03 + row * 1e-3), "normal", *captions) for row in range(8)]
    blind: Any = Blind()
    judges = Judges(blind, blind, bone_lengths(clips[0].joints).mean(0))
    found = score_captured(Reference(clips, blind.embed_motions([one.joints for one in clips])), judges, 1)
    assert found["claims_steps"]["mean"] == 1.0
    assert {"claims_degrees", "claims_height"} <= found.keys()


def test_a_summary_holds_what_only_some_repeats_have() -> None:
    found = average_repeats([{"a": 1.0}, {"a": 3.0, "b": 5.0}])
    assert found["a"]["mean"] == 2.0 and found["b"]["mean"] == 5.0
    assert found["a"]["plus_minus"] == pytest.approx(1.96 * np.sqrt(2) / np.sqrt(2))


def test_the_table_says_both_sides() -> None:
    value = {"mean": 0.5, "plus_minus": 0.01}
    made = {"clips": 9, "distinct_pairs": 3, "group": 3, "clips_without_near_twin": 4, "mean": {"fid": value},
            "without_near_twins": None, "multimodality": 0.2, "by_pair": {"walk/old": {"content": value}},
            "by_pair_captured": {"walk/old": {"content": 0.75}}}  # fmt: skip
    parts = {"captured": {"fid": {"mean": 0.0, "plus_minus": 0.0}}, "generated": made}
    held = {"clips": 4, "both_hold": 0.9}
    two = {"clips": 7, "captured": {"fid": {"mean": 0.25}}, "generated": {"fid": value},
           "captured_apart": {"held_out": held, "joined_in_training": {"clips": 0, "both_hold": None}},
           "generated_apart": {"held_out": {**held, "both_hold": 0.45}}}  # fmt: skip
    result = {"model": "m", "evaluator": "1", "repeats": 2, "splits": {"dev_test": parts}}
    text = markdown_table(result | {"two_actions": {"in_order": two}})
    assert "| fid | 0.250 | 0.500 ± 0.010 | 2.00 |" in text
    assert "| both_hold, 4 pairs held out | 0.900 | 0.450 | 0.50 |" in text
    assert "| fid | 0.000 | 0.500 ± 0.010 | - | - |" in text
    assert "| walk/old | 0.50 (0.75) |" in text
    many = {f"{number}/old": {"content": value} for number in range(20)}
    assert "/old" not in markdown_table({**result, "two_actions": {}, "splits": {"dev_test": parts | {
        "generated": made | {"by_pair": many}}}})  # fmt: skip
