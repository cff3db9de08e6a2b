"""Mirror images of clips: what changes sides in captions, labels and joints, and what must not."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from support.motions import recorded, walk
from support.shared import shared_path

pytest.importorskip("torch")

from kinegraph.motion.features import features_from_joints, joints_from_features
from kinegraph.motion.skeleton import JOINT_NAMES, PARENTS, facing_angle, mirrored
from kinegraph_training.data.clips import (
    MotionClip,
    clip_of_rows,
    mirrored_caption,
    mirrored_clip,
    mirrored_label,
    read_split,
    taught_captions,
)
from kinegraph_training.dataset import add_step_counts
from kinegraph_training.synthetic.caption_grammar import COUNTED_STEPS, PHRASES, step_count_captions

PAIRS = (
    ("a person turns left.", "a person turns right."),
    ("the left hand, then the right one", "the right hand, then the left one"),
    ("walks leftward, steps rightwards", "walks rightward, steps leftwards"),
    ("turns clockwise", "turns counterclockwise"),
    ("a left-handed throw", "a right-handed throw"),
    ("Left hand up, RIGHT hand down", "Right hand up, LEFT hand down"),
    ("(left)", "(right)"),
)
UNTOUCHED = (
    "leftover cake",
    "stands upright and bright",
    "leftist, rightful, righteous",
    "the outright cleft",
    "a person waves both hands",
    "",
)


@pytest.mark.parametrize(("caption", "image"), PAIRS)
def test_sides_are_exchanged_both_ways(caption: str, image: str) -> None:
    assert mirrored_caption(caption) == image
    assert mirrored_caption(image) == caption


@pytest.mark.parametrize("caption", UNTOUCHED)
def test_words_that_only_contain_a_side_are_untouched(caption: str) -> None:
    assert mirrored_caption(caption) == caption


@pytest.mark.parametrize("spelling", ["counter-clockwise", "counter clockwise", "anticlockwise", "anti-clockwise"])
def test_every_spelling_of_counterclockwise_is_one_word(spelling: str) -> None:
    assert mirrored_caption(f"spins {spelling} once") == "spins clockwise once"


@pytest.mark.parametrize(
    ("label", "image"),
    [
        ("wave-left-hand", "wave-right-hand"),
        ("walk-turn-right", "walk-turn-left"),
        # A user's own labels, whatever joins their words, keep their spelling: held-out pairs are compared as text.
        ("wave_left_hand", "wave_right_hand"),
        ("wave left", "wave right"),
        ("raise-up-both-hands", "raise-up-both-hands"),
        ("leftover-throw", "leftover-throw"),
        ("", ""),
    ],
)
def test_labels(label: str, image: str) -> None:
    assert mirrored_label(label) == image
    assert mirrored_label(image) == label


def test_every_label_that_can_be_composed_has_an_image_that_can() -> None:
    # Otherwise a mirrored held-out pair would name an action nobody composes, and hold nothing out.
    assert {mirrored_label(name) for name in PHRASES} == set(PHRASES)


def test_phrases_of_an_image_are_the_images_of_the_phrases() -> None:
    # A mirrored composition is worded as if it had been composed of mirrored clips.
    for name, phrases in PHRASES.items():
        other = PHRASES[mirrored_label(name)]
        assert set(map(mirrored_caption, phrases.finite)) == set(other.finite), name
        assert set(map(mirrored_caption, phrases.participle)) == set(other.participle), name


@pytest.mark.parametrize("content", COUNTED_STEPS)
def test_counted_captions_say_what_was_counted_and_mirror_like_the_rest(content: str) -> None:
    rng = np.random.Generator(np.random.PCG64(3))
    for steps, word in ((2, "two"), (7, "seven"), (12, "twelve")):
        captions = step_count_captions(content, steps, "proud", rng)
        assert len(captions) == 2 and all(re.search(rf"\b{word}\b.* steps?\b", caption) for caption in captions)
    ways = {mirrored_caption(way) for way in COUNTED_STEPS[content]}
    assert ways == set(COUNTED_STEPS[mirrored_label(content)])


def test_captions_of_a_whole_trial_are_taught_where_they_hold_for_a_window() -> None:
    trial = {"scope": "trial", "captions": ["a person jumps and then turns around.", "a person jumps about."]}
    assert taught_captions(trial, {"windows": 3}) == ("a person jumps about.",)
    assert taught_captions(trial, {"windows": 1}) == tuple(trial["captions"])
    assert taught_captions({"captions": trial["captions"]}, {"windows": 3}) == tuple(trial["captions"])
    clip = clip_of_rows("x", walk(20), trial, {"windows": 3})
    assert clip.captions == ("a person jumps about.",) and clip.any_length


@pytest.mark.parametrize(("content", "steps"), [("bow", 4), ("walk", None), ("walk", 1), ("run", 13), ("", 5)])
def test_what_cannot_be_counted_is_not_said(content: str, steps: int | None) -> None:
    assert step_count_captions(content, steps, "normal", np.random.Generator(np.random.PCG64(3))) == ()


def test_clips_keep_their_captions_beside_the_counted_ones() -> None:
    clip = MotionClip("c1", walk(20), ("a person walks.",), ("walk",), "normal", steps=4)
    (counted,) = add_step_counts([clip], seed=1)
    assert counted.captions[0] == "a person walks." and len(counted.captions) == 3
    assert counted == add_step_counts([clip], seed=1)[0] != add_step_counts([clip], seed=2)[0]


def test_joints_change_names_and_the_sign_of_x() -> None:
    joints = walk(30, turning=0.03)
    image = mirrored(joints)
    for index, name in enumerate(JOINT_NAMES):
        partner = name.replace("left", "*").replace("right", "left").replace("*", "right")
        source = joints[:, JOINT_NAMES.index(partner)]
        np.testing.assert_array_equal(image[:, index], source * np.array([-1, 1, 1], dtype=np.float32))
    np.testing.assert_array_equal(mirrored(image), joints)
    assert not np.allclose(image, joints, atol=0.05)


def test_the_skeleton_is_its_own_image() -> None:
    # Names alone would not notice a limb whose parents are not mirrored with it.
    partner = [
        JOINT_NAMES.index(name.replace("left", "*").replace("right", "left").replace("*", "right"))
        for name in JOINT_NAMES
    ]
    assert [partner[PARENTS[partner[joint]]] for joint in range(1, 22)] == list(PARENTS[1:])


def test_the_image_turns_to_the_other_side_through_features_too() -> None:
    joints = walk(40, turning=0.02)
    image = mirrored(joints)
    np.testing.assert_allclose(np.unwrap(facing_angle(image)), -np.unwrap(facing_angle(joints)), atol=1e-4)
    assert facing_angle(joints)[-1] - facing_angle(joints)[0] > 0.5
    rebuilt = joints_from_features(features_from_joints(image), heading=float(facing_angle(image)[0]))
    np.testing.assert_allclose(rebuilt, image, atol=2e-3)


def test_a_mirrored_clip_is_mirrored_in_all_its_parts() -> None:
    joints = walk(20, turning=0.02)
    captions = ("a person turns left.", "someone walks.")
    clip = MotionClip("c1", joints, captions, ("walk-turn-left",), "proud")
    image = mirrored_clip(clip)
    assert image.captions == ("a person turns right.", "someone walks.")
    assert (image.action, image.style) == ("walk-turn-right", "proud")
    assert image.id != clip.id
    np.testing.assert_array_equal(image.joints, mirrored(joints))
    # The original is not changed in place: both are trained on.
    assert clip.captions == captions and clip.joints is joints
    np.testing.assert_array_equal(joints, walk(20, turning=0.02))


@pytest.mark.parametrize("source", ["bandai", "cmu"])
def test_captions_of_the_data_change_exactly_their_sides(source: str) -> None:
    path = shared_path("data", source, "captions.jsonl")
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    captions = [caption for row in rows for caption in row["captions"]]
    changed = 0
    for caption in captions:
        image = mirrored_caption(caption)
        assert mirrored_caption(image) == caption
        words, others = (re.findall(r"[a-z]+", text.lower()) for text in (caption, image))
        for word, other in zip(words, others, strict=True):
            if word in ("left", "right", "leftward", "rightward"):
                assert {word.removesuffix("ward"), other.removesuffix("ward")} == {"left", "right"}
            else:
                assert word == other
        changed += image != caption
    assert 0 < changed < len(captions)


def test_recorded_turns_agree_with_their_captions_in_the_image_as_well() -> None:
    # The sign of turning and the word must change together; either alone would teach the wrong side.
    clips = [clip for clip in read_split(shared_path("data", "bandai"), "val") if clip.action == "walk-turn-left"]
    assert clips
    turns = []
    for clip in clips:
        image = mirrored_clip(clip)
        angle = np.unwrap(facing_angle(image.joints))
        turns.append(angle[-1] - angle[0])
        assert image.action == "walk-turn-right"
        assert all("left" not in caption.split() for caption in image.captions)
    # Left is positive; nearly all of these clips turn by a quarter or more.
    assert np.mean(np.array(turns) < 0) > 0.9


def test_recorded_clips_keep_their_bones_in_the_image() -> None:
    for joints in recorded(count=3):
        image = mirrored(joints)
        for child in range(1, 22):
            partner = JOINT_NAMES[child].replace("left", "*").replace("right", "left").replace("*", "right")
            other = JOINT_NAMES.index(partner)
            bone = np.linalg.norm(image[:, child] - image[:, PARENTS[child]], axis=-1)
            expected = np.linalg.norm(joints[:, other] - joints[:, PARENTS[other]], axis=-1)
            np.testing.assert_allclose(bone, expected, atol=1e-5)
