"""Made gestures and bent walks: they show what their labels say, and leave the rest of the body alone."""

from __future__ import annotations

import numpy as np
import pytest

from support.motions import posed, walk

pytest.importorskip("torch")

from kinegraph.motion.skeleton import JOINT_INDEX, JOINT_NAMES, bone_lengths, facing_angle
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.synthetic.gestures import MADE, gesture_weight, make_gesture, make_gestures
from kinegraph_training.synthetic.paths import bend, circle_turn, is_straight, make_bent, u_turn
from kinegraph_training.synthetic.sitting import SITTING

HEAD, LEFT, RIGHT = JOINT_INDEX["head"], JOINT_INDEX["left_wrist"], JOINT_INDEX["right_wrist"]


def standing(frames: int = 80) -> np.ndarray:
    return np.stack([posed(np.array([0, 0.95, 0]), {}) for _ in range(frames)]).astype(np.float32)


def reversals(values: np.ndarray, least: float = 0.04) -> int:
    """Count the turning points of a curve that lie at least so far apart."""
    turns, extreme, direction = 0, values[0], 0
    for value in values:
        if direction * (value - extreme) >= 0 and direction:
            extreme = value
        elif abs(value - extreme) >= least:
            turns, direction, extreme = turns + (direction != 0), int(np.sign(value - extreme)), value
    return turns


@pytest.mark.parametrize("label", sorted(MADE))
def test_bones_keep_their_lengths_and_the_legs_their_place(label: str) -> None:
    body = walk(80).astype(np.float32)
    for seed in range(4):
        out = make_gesture(body, label, np.random.default_rng(seed))
        np.testing.assert_allclose(bone_lengths(out), bone_lengths(body), atol=2e-3)
        legs = [
            JOINT_INDEX[f"{side}_{name}"] for side in ("left", "right") for name in ("hip", "knee", "ankle", "foot")
        ]
        still = (
            [0, *legs]
            if label not in ("bow", *SITTING)
            else [joint for joint in legs if JOINT_NAMES[joint].endswith(("ankle", "foot"))]
        )
        np.testing.assert_array_equal(out[:, still], body[:, still])
        assert np.isfinite(out).all()


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_raised_hand_is_above_the_head_and_the_other_one_stays(side: str) -> None:
    raised, other = (LEFT, RIGHT) if side == "left" else (RIGHT, LEFT)
    for seed in range(6):
        body = standing()
        out = make_gesture(body, f"raise-up-{side}-hand", np.random.default_rng(seed))
        assert (out[:, raised, 1] - out[:, HEAD, 1]).max() > 0.1
        np.testing.assert_array_equal(out[:, other], body[:, other])


def test_a_wave_goes_to_and_fro_and_a_raise_does_not() -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        wave = make_gesture(standing(100), "wave-left-hand", rng)
        raised = make_gesture(standing(100), "raise-up-left-hand", np.random.default_rng(seed))
        up = wave[:, LEFT, 1] > wave[:, JOINT_INDEX["left_elbow"], 1] + 0.1
        assert reversals(wave[up, LEFT, 0]) >= 2
        held = raised[:, LEFT, 1] > raised[:, HEAD, 1]
        assert reversals(raised[held, LEFT, 0]) <= 1


def test_clapping_hands_meet_and_part() -> None:
    out = make_gesture(standing(100), "clap", np.random.default_rng(2))
    gap = np.linalg.norm(out[:, LEFT] - out[:, RIGHT], axis=-1)
    middle = gap[25:60]
    assert middle.min() < 0.25 and reversals(middle) >= 3


def test_a_bow_brings_the_head_down_and_forward_over_feet_that_stay() -> None:
    for seed in range(6):
        out = make_gesture(standing(100), "bow", np.random.default_rng(seed))
        lowest = int(out[:, HEAD, 1].argmin())
        head, pelvis = out[lowest, HEAD] - out[0, HEAD], out[lowest, 0] - out[0, 0]
        assert head[1] < -0.08 and head[2] > 0.15
        assert -0.1 < pelvis[1] < 0.01 and pelvis[2] < 0.02
        assert np.abs(out[:, :, 0] - standing(100)[:, :, 0]).max() < 0.01
        # the knees bend forwards, as far as they must
        knee = JOINT_INDEX["left_knee"]
        assert np.ptp(out[:, knee, 2]) < 0.12
        assert np.abs(np.diff(out, axis=0)).max() < 0.15


def test_a_gesture_enters_and_leaves_smoothly() -> None:
    for seed in range(20):
        weight = gesture_weight(80, np.random.default_rng(seed))
        assert weight.min() >= 0 and weight.max() > 0.99 and np.abs(np.diff(weight)).max() < 0.3


def test_a_circle_closes_and_a_u_turn_comes_back() -> None:
    straight = walk(150).astype(np.float32)
    assert is_straight(straight)
    rng = np.random.default_rng(0)
    for side, sign in (("left", 1), ("right", -1)):
        turn = circle_turn(150, side, rng)
        out = bend(straight, turn)
        turned = np.degrees(facing_angle(out)[-1] - facing_angle(out)[0])
        assert sign * turned > 230 and not is_straight(out)
        back = bend(straight, u_turn(150, side, rng))
        assert abs(sign * np.degrees(facing_angle(back)[-1] - facing_angle(back)[0]) - 180) < 8
        # The gait stays: steps are as long as before.
        steps = [np.linalg.norm(np.diff(x[:, 0][:, [0, 2]], axis=0), axis=1).sum() for x in (straight, out)]
        assert abs(steps[0] - steps[1]) < 0.05 * steps[0]


def test_bent_walks_have_the_labels_of_their_paths() -> None:
    walks = [MotionClip("w", walk(150).astype(np.float32), ("a person walks",), ("walk",), "")]
    stand = [MotionClip("s", standing(), ("a person stands",), ("stand-still",), "")]
    made = make_bent(walks, stand, 30, 4)
    labels = {clip.action for clip in made}
    assert labels == {"walk-circle-left", "walk-circle-right", "walk-u-turn-left", "walk-u-turn-right", "walk-and-stop"}
    for clip in made:
        turned = np.degrees(facing_angle(clip.joints)[-1] - facing_angle(clip.joints)[0])
        if clip.action.endswith("left"):
            assert turned > 150
        elif clip.action == "walk-and-stop":
            assert np.linalg.norm(np.ptp(clip.joints[-8:, 0][:, [0, 2]], axis=0)) < 0.12


def test_gestures_are_made_of_people_who_stand_and_are_called_so() -> None:
    stand = [MotionClip("s", standing(), ("a person stands",), ("stand-still",), "")]
    made = make_gestures(stand, 40, 1)
    assert len(made) == 40 and {clip.action for clip in made} <= set(MADE)
    assert all(clip.made_by == "gestures" and clip.captions for clip in made)
    assert make_gestures([], 5, 1) == []


def test_nobody_turns_in_a_manner_whose_turns_were_never_recorded() -> None:
    walks = [MotionClip("w", walk(150).astype(np.float32), ("a person walks",), ("walk",), "elderly")]
    stand = [MotionClip("s", standing(), ("a person stands",), ("stand-still",), "")]
    assert {clip.action for clip in make_bent(walks, stand, 20, 4)} == {"walk-and-stop"}
    turned = MotionClip("t", walk(60, turning=0.02).astype(np.float32), (), ("walk-turn-left",), "elderly")
    assert "walk-circle-left" in {clip.action for clip in make_bent([*walks, turned], stand, 20, 4)}


def test_whoever_turns_back_goes_some_way_back() -> None:
    walks = [MotionClip("w", walk(55).astype(np.float32), ("a person walks",), ("walk",), "")]
    for clip in make_bent(walks, [], 20, 4):
        heading = np.unwrap(facing_angle(clip.joints))
        turned = np.flatnonzero(np.abs(heading - heading[0]) > np.radians(175))
        way = np.diff(clip.joints[turned[0] :, 0][:, [0, 2]], axis=0)
        assert np.linalg.norm(way, axis=1).sum() > 0.9
