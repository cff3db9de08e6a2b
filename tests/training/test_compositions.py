"""Synthetic compositions: which clip gives what, and which pairs are never composed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from support.motions import posed, turn, walk
from support.shared import shared_path

pytest.importorskip("torch")

from kinegraph.errors import InvalidInputError
from kinegraph.motion.skeleton import bone_lengths, facing_angle, mirrored
from kinegraph_training.data.clips import MotionClip, mirrored_caption, mirrored_clip, mirrored_label, read_split
from kinegraph_training.synthetic.caption_grammar import CAPTIONS, PHRASES
from kinegraph_training.synthetic.compositions import (
    BLEND,
    LEFT_ARM,
    MAX_SLIDE,
    RIGHT_ARM,
    HeldOut,
    can_splice,
    goes_round,
    make_sequences,
    make_splices,
    slide_of_join,
    splice,
    stitch_clips,
)
from kinegraph_training.synthetic.gestures import MADE

LEGS = [1, 2, 4, 5, 7, 8, 10, 11]


def clip(content: str, joints: np.ndarray, style: str = "normal") -> MotionClip:
    return MotionClip(content, joints.astype(np.float32), ("a person moves.",), (content,), style)


def raising(frames: int = 40, side: int = 16, angle: float = 1.3) -> np.ndarray:
    sign = 1 if side == 16 else -1
    rows = [posed(np.array([0, 0.95, 0]), {side: turn("z", sign * angle * min(1.0, f / 20))}) for f in range(frames)]
    return np.stack(rows).astype(np.float32)


def pool() -> list[MotionClip]:
    return [
        clip("walk", walk(60)),
        clip("run", walk(50, speed=0.12)),
        clip("walk-turn-left", walk(60, turning=0.02)),
        clip("walk-turn-right", walk(60, turning=-0.02)),
        clip("raise-up-left-hand", raising()),
        clip("raise-up-right-hand", raising(side=17)),
    ]


NOTHING = HeldOut(frozenset(), frozenset())


def test_legs_and_root_are_the_carriers_and_the_arm_is_the_gestures() -> None:
    carrier, gesture = clip("walk", walk(40)), clip("raise-up-left-hand", raising(40))
    rng = np.random.default_rng(0)
    out = splice(carrier.joints, gesture, rng)
    np.testing.assert_allclose(out[:, [0, *LEGS]], carrier.joints[:, [0, *LEGS]], atol=1e-4)
    np.testing.assert_allclose(out[:, list(RIGHT_ARM)], carrier.joints[:, list(RIGHT_ARM)], atol=1e-4)
    # The left wrist stands above the left shoulder at the end, as in the gesture and not as in the walk.
    assert out[30, LEFT_ARM[3], 1] > out[30, LEFT_ARM[1], 1] + 0.2
    assert carrier.joints[30, LEFT_ARM[3], 1] < carrier.joints[30, LEFT_ARM[1], 1]


def test_an_arm_turns_with_the_chest() -> None:
    # The same splice on a carrier that starts turned by 90 degrees is the same, turned by 90 degrees.
    gesture = clip("raise-up-left-hand", raising(40))
    ahead, aside = (
        splice(walk(40, heading=heading).astype(np.float32), gesture, np.random.default_rng(4))
        for heading in (0.0, np.pi / 2)
    )
    np.testing.assert_allclose(aside, ahead @ turn("y", np.pi / 2).T.astype(np.float32), atol=2e-3)


def test_bones_keep_their_lengths() -> None:
    carrier = clip("walk", walk(60))
    lengths = bone_lengths(carrier.joints).mean(axis=0)
    for seed in range(5):
        spliced = splice(carrier.joints, clip("raise-up-left-hand", raising(25)), np.random.default_rng(seed))
        np.testing.assert_allclose(bone_lengths(spliced), np.tile(lengths, (60, 1)), atol=1e-4)
    sequence = stitch_clips(walk(40), raising(30))
    np.testing.assert_allclose(bone_lengths(sequence), np.tile(lengths, (len(sequence), 1)), atol=1e-3)


def test_a_sequence_goes_on_where_and_how_the_first_one_ends() -> None:
    first, second = walk(50, turning=0.02), walk(50)
    out = stitch_clips(first, second)
    assert len(out) == 100 - BLEND
    np.testing.assert_allclose(out[: 50 - BLEND], first[: 50 - BLEND], atol=2e-3)
    # No jump anywhere: the pelvis walks at 5 cm a frame throughout.
    steps = np.linalg.norm(np.diff(out[:, 0][:, [0, 2]], axis=0), axis=1)
    assert steps.max() < 0.07
    assert abs(facing_angle(out)[-1] - facing_angle(first)[-1]) < 0.3


def test_a_held_out_pair_is_not_made_by_another_name() -> None:
    both, wave = frozenset(("walk", "raise-up-both-hands")), frozenset(("walk", "bye"))
    held_out = HeldOut(frozenset((both, wave)), frozenset())
    hands = ["raise-up-left-hand", "raise-up-right-hand"]
    assert not can_splice("walk", hands, held_out) and can_splice("run", hands, held_out)
    assert can_splice("walk", hands[:1], held_out) and can_splice("walk", [hands[0], "wave-right-hand"], held_out)
    assert not can_splice("walk", ["byebye"], held_out) and can_splice("run", ["byebye"], held_out)
    # In a manner in which nobody was recorded raising both hands, they are not both raised.
    tired = [replace(one, style="exhausted") for one in pool()]
    made = make_splices(tired, 30, NOTHING, 3, actions=3)
    raised = [{"raise-up-left-hand", "raise-up-right-hand"} <= set(one.actions) for one in made]
    assert not any(raised)
    normal = make_splices(pool(), 30, NOTHING, 3, actions=3)
    assert any({"raise-up-left-hand", "raise-up-right-hand"} <= set(one.actions) for one in normal)


def test_whoever_moves_an_arm_is_not_said_to_be_motionless() -> None:
    still = [clip("stand-still", walk(60, speed=0.0)), *pool()[4:]]
    made = [one for one in make_splices(still, 40, NOTHING, 2) if one.actions[0] == "stand-still"]
    assert made
    texts = [text for one in made for text in (*one.captions, *one.partial_captions)]
    assert not any(word in text for text in texts for word in ("still", "motionless", "not moving", "without moving"))


def test_a_part_of_a_circle_is_a_circle_only_if_it_goes_round() -> None:
    whole = walk(120, turning=2 * np.pi / 120).astype(np.float32)
    assert goes_round("walk-circle-left", whole) and not goes_round("walk-circle-left", whole[:60])
    assert goes_round("walk", whole[:60])


def test_a_join_that_drags_a_foot_is_told_from_one_that_does_not() -> None:
    standing = np.repeat(walk(1), 60, axis=0).astype(np.float32)
    # Two feet that stand, and a body that is carried half a metre over the frames of the join.
    dragged = standing.copy()
    ramp = np.clip((np.arange(60) - 30 + BLEND) / BLEND, 0.0, 1.0)
    dragged[:, :, 2] += 0.5 * ramp[:, None]
    assert slide_of_join(dragged, 30) == pytest.approx(0.5, abs=0.02) and slide_of_join(standing, 30) < 0.02
    # What slides all the time does not slide more in the join.
    gliding = walk(60).astype(np.float32)
    assert slide_of_join(gliding, 30) < MAX_SLIDE


def test_sequences_that_cannot_be_made_are_not_drawn_for_ever() -> None:
    lying = clip("run", np.flip(walk(50), axis=1))  # no pose of it is near one of the walk
    assert make_sequences([clip("walk", walk(60)), lying], 3, NOTHING, 1, 196) == []


def test_held_out_pairs_are_never_made_nor_their_mirror_images(tmp_path: Path) -> None:
    listed = {
        "together": [["walk", "raise-up-left-hand"]],
        "in_order": [["run", "walk-turn-left"], ["raise-up-left-hand", "walk"]],
    }
    path = tmp_path / "held_out.json"
    path.write_text(json.dumps(listed), encoding="utf-8")
    held_out = HeldOut.read(path)
    splices = {composition.action for composition in make_splices(pool(), 80, held_out, 1)}
    sequences = {composition.action for composition in make_sequences(pool(), 150, held_out, 1, 196)}
    assert not splices & {"walk+raise-up-left-hand", "walk+raise-up-right-hand"}
    assert "run+raise-up-left-hand" in splices
    forbidden = {"run>walk-turn-left", "run>walk-turn-right", "raise-up-left-hand>walk", "raise-up-right-hand>walk"}
    assert not sequences & forbidden
    # The other order of a pair that is held out in one order is allowed.
    assert "walk>raise-up-left-hand" in sequences
    # Without the list they are all made: the test can fail.
    assert {"walk+raise-up-left-hand"} <= {composition.action for composition in make_splices(pool(), 80, NOTHING, 1)}
    assert forbidden & {composition.action for composition in make_sequences(pool(), 150, NOTHING, 1, 196)}


def test_in_a_manner_only_gestures_are_made_that_were_recorded_in_it() -> None:
    tired = [replace(each, style="exhausted") for each in pool() if each.action != "raise-up-right-hand"]
    made = make_splices(pool() + tired, 60, NOTHING, 5)
    of_tired = {label for each in made if each.style == "exhausted" for label in each.actions} & set(MADE)
    of_others = {label for each in made if each.style == "normal" for label in each.actions} & set(MADE)
    assert of_tired <= {"raise-up-left-hand", "raise-up-right-hand"} and len(of_others) > 4
    with pytest.raises(InvalidInputError, match="two actions to be composed"):
        make_splices([clip("walk", walk(60)), clip("wave-left-hand", raising(), "happy")], 2, NOTHING, 5)


def test_captions_name_both_actions_in_their_order() -> None:
    for composition in make_sequences(pool(), 40, NOTHING, 2, 196):
        first, second = composition.actions
        if {first, second} == {"run", "raise-up-left-hand"}:
            for caption in composition.captions:
                hand = max(caption.find(word) for word in ("hand", "arm"))
                positions = [caption.find(word) for word in (*PHRASES["run"].finite, *PHRASES["run"].participle)]
                run = max(positions)
                assert run >= 0 and hand >= 0, caption
                assert (run < hand) == (first == "run"), caption


def test_three_actions_have_captions_of_all_of_each_and_of_pairs() -> None:
    for composition in make_splices(pool(), 10, NOTHING, 3, actions=3):
        carrier, left, right = composition.actions
        assert {left, right} == {"raise-up-left-hand", "raise-up-right-hand"} or left in MADE or right in MADE
        assert len(composition.captions) == CAPTIONS and len(composition.partial_captions) == 6
        moved = np.abs(np.diff(composition.joints[:, [LEFT_ARM[3], RIGHT_ARM[3]]] - composition.joints[:, :1], axis=0))
        assert (moved.sum(axis=(0, 2)) > 0.2).all(), carrier  # both wrists move


def test_the_seed_decides() -> None:
    first, again, other = (make_splices(pool(), 12, NOTHING, seed) for seed in (5, 5, 6))
    for a, b in zip(first, again, strict=True):
        assert a.captions == b.captions and a.joints.tobytes() == b.joints.tobytes()
    assert [composition.captions for composition in first] != [composition.captions for composition in other]


def test_the_real_list_is_obeyed_on_real_clips() -> None:
    path = shared_path("data", "held_out_pairs.json")
    held_out = HeldOut.read(path)
    clips = read_split(shared_path("data", "bandai"), "train")
    listed = json.loads(path.read_text(encoding="utf-8"))
    together = {frozenset(pair) for pair in listed["together"]}
    together |= {frozenset(map(mirrored_label, pair)) for pair in listed["together"]}
    ordered = {tuple(pair) for pair in listed["in_order"]}
    ordered |= {tuple(map(mirrored_label, pair)) for pair in listed["in_order"]}
    splices = make_splices(clips, 200, held_out, 7)
    sequences = make_sequences(clips, 200, held_out, 7, 196)
    assert len(splices) == len(sequences) == 200
    assert not {frozenset(composition.actions) for composition in splices} & together
    assert not {composition.actions for composition in sequences} & ordered


def test_mirroring_exchanges_sides_in_motion_label_and_caption() -> None:
    caption = "someone turns left, then leftward again; the right hand, not the leftovers."
    swapped = "someone turns right, then rightward again; the left hand, not the leftovers."
    assert mirrored_caption(caption) == swapped
    assert mirrored_caption(swapped) == caption
    assert mirrored_label("wave-left-hand") == "wave-right-hand"
    assert mirrored_label("wave-both-hands") == "wave-both-hands"
    original = MotionClip("x", raising(), ("a person raises the left hand.",), ("raise-up-left-hand",), "")
    image = mirrored_clip(original)
    assert image.captions == ("a person raises the right hand.",)
    assert image.joints[-1, RIGHT_ARM[3], 1] > image.joints[-1, LEFT_ARM[3], 1] + 0.2
    np.testing.assert_array_equal(mirrored(image.joints), original.joints)


@pytest.mark.parametrize("carrier", ["walk", "run"])
def test_a_short_gesture_fades_in_and_out(carrier: str) -> None:
    long, short = clip(carrier, walk(100)), clip("raise-up-left-hand", raising(20, angle=0.5))
    out = splice(long.joints, short, np.random.default_rng(11))
    jump = np.linalg.norm(np.diff(out[:, LEFT_ARM[3]] - long.joints[:, LEFT_ARM[3]], axis=0), axis=1).max()
    assert 0 < jump < 0.15
