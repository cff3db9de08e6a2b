"""Motions put together from parts of the body, and `compose(method="parts")`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph import Cancelled, Concept, InvalidInputError, MotionPipeline, cli, part_composition
from kinegraph.constraints import Waypoint
from kinegraph.edits import with_weight
from kinegraph.energy import energy_maps
from kinegraph.motion.body_parts import (
    ARMS,
    CHEST,
    LEGS,
    TRUNK,
    UPPER_BODY,
    activity,
    chest_heading,
    choose_parts,
    join_parts,
    move_arm,
    move_upper_body,
    rotate_about_y,
)
from kinegraph.motion.skeleton import JOINT_INDEX, bone_lengths
from kinegraph.options import resolve_options
from kinegraph.part_composition import choose_method, join_clips
from kinegraph.request import MANY_AT_ONCE, parts_hands
from support.motions import posed, stand, turn, walk
from support.toy import with_parser

pytest.importorskip("spacy")

WALK, WAVE = "a person walks", "a person waves"
HOW: dict[str, Any] = {"seconds": 2, "seed": 1}
LOWER = [joint for joint in range(22) if joint not in UPPER_BODY]


def raised(side: str, frames: int = 60) -> np.ndarray:
    """Stand with one arm up."""
    shoulder, angle = (17, 1.4) if side == "right" else (16, -1.4)
    other = (16, 1.4) if side == "right" else (17, -1.4)
    hanging = {other[0]: turn("z", -other[1])}
    pose = posed(np.zeros(3), {shoulder: turn("z", -angle), **hanging})
    pose[:, 1] -= pose[:, 1].min()
    return np.repeat(pose[None], frames, axis=0).astype(np.float32)


def test_each_part_is_of_the_motion_that_does_most_with_it() -> None:
    motions = [raised("left"), walk(60), raised("right")]
    assert choose_parts(motions) == {LEGS: 1, TRUNK: 1, "left arm": 0, "right arm": 2}
    assert choose_parts([walk(60), stand(60, bow=0.8)])[TRUNK] == 1
    assert set(choose_parts([walk(60), stand(60)]).values()) == {0}


def test_activity_is_what_it_says() -> None:
    assert activity(walk(60, speed=0.05), LEGS) > 0.04 > activity(stand(60), LEGS)
    assert activity(stand(60), TRUNK) == pytest.approx(0, abs=1e-3)
    up, hanging = (activity(raised("left"), arm) for arm in ("left arm", "right arm"))
    assert up > 0.8 and hanging < 0.25


@pytest.mark.parametrize("turning", [0.0, 0.03])
def test_an_arm_turns_with_the_chest_and_keeps_its_bones(turning: float) -> None:
    source, target = raised("left"), walk(60, turning=turning)
    moved = move_arm(source, target, "left arm")
    others = [joint for joint in range(22) if joint not in ARMS["left arm"]]
    assert np.array_equal(moved[:, others], target[:, others])
    for frame in (0, 30, 59):  # the arm of the source, turned by hand to where the chest of the target faces
        angle = float(chest_heading(target)[frame] - chest_heading(source)[frame])
        cos, sin = np.cos(angle), np.sin(angle)
        arm = source[frame, ARMS["left arm"]] - source[frame, CHEST]
        by_hand = np.stack([cos * arm[:, 0] + sin * arm[:, 2], arm[:, 1], cos * arm[:, 2] - sin * arm[:, 0]], axis=-1)
        assert moved[frame, ARMS["left arm"]] - moved[frame, CHEST] == pytest.approx(by_hand, abs=1e-4)


def test_what_is_above_the_hips_moves_as_one() -> None:
    bowing, walking = stand(60, bow=0.8), walk(60, turning=0.03)
    moved = move_upper_body(bowing, walking)
    assert np.array_equal(moved[:, LOWER], walking[:, LOWER])
    head = JOINT_INDEX["head"]
    assert moved[:, head, 1] - moved[:, 0, 1] == pytest.approx(bowing[:, head, 1] - bowing[:, 0, 1], abs=1e-4)


def test_joined_parts_have_the_bones_of_the_legs() -> None:
    motions = [raised("left"), walk(60), raised("right")]
    joined = join_parts(motions, choose_parts(motions))
    assert bone_lengths(joined) == pytest.approx(bone_lengths(walk(60)), abs=1e-3)
    assert np.abs(joined[:, LOWER] - walk(60)[:, LOWER]).max() < 2e-3
    wrists = [JOINT_INDEX[f"{side}_wrist"] for side in ("left", "right")]
    assert (joined[:, wrists, 1] > joined[:, [CHEST], 1]).all()


def test_rotation_about_y_is_to_the_left() -> None:
    ahead = np.array([[[0.0, 0.0, 1.0]]], dtype=np.float32)
    assert rotate_about_y(ahead, np.array([np.pi / 2]))[0, 0] == pytest.approx([1.0, 0.0, 0.0], abs=1e-6)


# Composition


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> MotionPipeline:
    return MotionPipeline.load(with_parser(tmp_path_factory.mktemp("toy") / "bundle"), threads=1)


def test_parts_are_those_of_the_clips_of_each_concept(toy: MotionPipeline) -> None:
    clip = toy.compose([WALK, WAVE], method="parts", **HOW)
    alone = [toy.generate(text, **HOW).joints for text in (WALK, WAVE)]
    assert np.array_equal(clip.joints, join_parts(alone, choose_parts(alone)))
    assert (clip.text, clip.seed, clip.frames) == (f"{WALK} while {WAVE}", 1, 40)


def test_parts_have_no_energy(toy: MotionPipeline) -> None:
    with pytest.raises(InvalidInputError, match="has no energy; take another method"):
        energy_maps(toy, [WALK, WAVE], method="parts", **HOW)


@pytest.mark.usefixtures("toy_by_default")
def test_the_command_line_composes_parts(here: Path) -> None:
    words = ["--and", WALK, "--and", WAVE, "--method", "parts", "--steps", "2", "--seconds", "1", "--seed", "3"]
    assert cli.main(["compose", *words, "-o", "x.npz"]) == 0
    with np.load(here / "x.npz") as stored:
        assert stored["joints"].shape == (20, 22, 3) and str(stored["text"]) == f"{WALK} while {WAVE}"


def choosing(monkeypatch: pytest.MonkeyPatch, *choices: tuple[int, int, int, int]) -> None:
    """Let motions be chosen for legs, trunk and arms in turn as is said."""
    left = iter(choices)
    monkeypatch.setattr(
        "kinegraph.motion.body_parts.choose_parts", lambda _: dict(zip([LEGS, TRUNK, *ARMS], next(left), strict=True))
    )


THREE = "a person walks while raising the left hand and waving the right hand"
ALONE = ("a person walks", "a person raises the left hand", "a person waves the right hand")


def test_a_sentence_of_three_at_once_is_joined_of_each_alone(
    toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone = [toy.generate(text, **HOW).joints for text in ALONE]
    choosing(monkeypatch, (0, 0, 1, 2))
    clip = toy.generate(THREE, **HOW)
    assert np.array_equal(clip.joints, join_parts(alone, {LEGS: 0, TRUNK: 0, "left arm": 1, "right arm": 2}))
    assert (clip.text, clip.graph, clip.notes) == (THREE, toy.parse(THREE), ())


def test_what_has_no_part_is_sampled_with_the_legs(toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    alone = ("a person walks and turns left", *ALONE[1:])
    motions = [toy.generate(text, **HOW).joints for text in alone]
    choosing(monkeypatch, (1, 1, 2, 3), (0, 0, 1, 2))
    clip = toy.generate("a person walks and turns left while raising the left hand and waving the right hand", **HOW)
    assert np.array_equal(clip.joints, join_parts(motions, {LEGS: 0, TRUNK: 0, "left arm": 1, "right arm": 2}))


@pytest.mark.parametrize(
    ("sentence", "does"),
    [
        (THREE, True),
        ("a person raises the left hand while waving the right hand", True),
        ("a person punches with the left fist and waves with the right hand", True),
        ("a person walks while waving the left hand and nodding", False),
        ("a person waves the left hand and the right hand", False),
        ("a person raises the left hand without waving the right hand", False),
        ("a person walks to the left and turns right", False),
        ("a person walks forward, turning left and continuing on", False),
    ],
)
def test_left_and_right_hand_are_told_apart(toy: MotionPipeline, sentence: str, does: bool) -> None:
    assert parts_hands(toy.parse(sentence)) == does


def test_what_cannot_be_joined_is_sampled_at_once_and_told(
    toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    graph = toy.parse(THREE)
    options = resolve_options(toy.manifest, **HOW)
    sentence = toy._encode_sentence(graph, options, own_length=False, is_known=True, in_order=False)
    whole = toy._make_clip(sentence, HOW["seed"])
    for choices in ([(0, 0, 0, 0)], [(1, 1, 1, 2), (0, 0, 0, 0)]):
        choosing(monkeypatch, *choices)
        clip = toy.generate(THREE, **HOW)
        assert np.array_equal(clip.joints, whole.joints) and clip.notes == (MANY_AT_ONCE,)


def test_a_batch_makes_them_as_they_are_made_alone(toy: MotionPipeline) -> None:
    texts = [WALK, THREE, f"{THREE}, then bows", WAVE]
    for shared_run in (True, False):
        clips = toy.batch(texts, seconds=4, seed=1, takes=2, shared_run=shared_run)
        assert [clip.text for clip in clips] == [text for text in texts for _ in range(2)]
        for clip in clips:
            alone = toy.generate(clip.text, seconds=4, seed=clip.seed)
            assert np.abs(clip.joints - alone.joints).max() < 2e-3


def test_a_batch_of_them_stops_when_it_is_asked_to(toy: MotionPipeline) -> None:
    with pytest.raises(Cancelled):
        toy.batch([WALK, THREE], seconds=2, seed=1, shared_run=True, on_step=lambda step: step.done < 3)


def test_constraints_and_weights_sample_three_at_once(toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    choosing(monkeypatch)  # nothing is chosen
    held = toy.generate(THREE, constraints=[Waypoint(1.0, (0.0, 0.5))], **HOW)
    weighed = toy.generate(with_weight(toy.parse(THREE), "walks", 0.5), **HOW)
    assert MANY_AT_ONCE in held.notes and MANY_AT_ONCE in weighed.notes


@pytest.mark.parametrize(
    ("concepts", "method"),
    [
        (["a person walks forward", "a person raises the left hand", "a person waves the right hand"], "parts"),
        (["a person runs", "a person claps"], "parts"),
        (["a person raises the left hand", "a person waves the right hand"], "parts"),
        (["a person walks", "a person waves both hands"], "parts"),
        (["a person raises both hands", "a person waves the right hand"], "fused"),  # one hand for two
        (["a person walks", "a person turns left"], "fused"),
        (["a person walks", "a person bows"], "fused"),
        (["a person walks with the hands up", "a person turns left"], "fused"),
        (["a person walks", "a person puts on a coat"], "fused"),
        (["a person walks", "a person does not wave"], "fused"),
        ([Concept("a person walks"), Concept("a person waves", 0.5)], "fused"),
        ([Concept("a person walks"), Concept("a person waves", -1.0)], "fused"),
        (["a person waves"], "fused"),
    ],
)
def test_hands_of_their_own_are_composed_by_parts_without_being_told(
    toy: MotionPipeline, concepts: list[Any], method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert choose_method(toy, concepts, {"text": None})[0] == method
    assert choose_method(toy, concepts, {"text": None, "agd": (0.1, 0.1)})[0] == "fused"
    # Every concept gets a part, or the arms of a network that knows nothing would decide.
    choices = {LEGS: 0, TRUNK: 0, "left arm": 1, "right arm": len(concepts) - 1}
    monkeypatch.setattr(part_composition, "choose_parts", lambda motions: choices)
    made = toy.compose(concepts, **HOW)
    np.testing.assert_array_equal(made.joints, toy.compose(concepts, method=method, **HOW).joints)
    assert made.seed == HOW["seed"]


def test_who_gets_no_part_is_composed_with_the_others_in_one_run(
    toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(part_composition, "choose_parts", lambda motions: dict.fromkeys((LEGS, TRUNK, *ARMS), 0))
    assert any("left out" in note for note in toy.compose([WALK, WAVE], method="parts", **HOW).notes)
    made = toy.compose([WALK, WAVE], **HOW)
    assert made.notes == () and made.seed == HOW["seed"]
    np.testing.assert_array_equal(made.joints, toy.compose([WALK, WAVE], method="fused", **HOW).joints)
    free = toy.compose([WALK, WAVE], seconds=2)  # of one seed all the way
    np.testing.assert_array_equal(free.joints, toy.compose([WALK, WAVE], seconds=2, seed=free.seed).joints)


def test_three_concepts_are_told_of_parts(toy: MotionPipeline) -> None:
    assert MANY_AT_ONCE not in toy.generate("a person walks and claps while nodding", **HOW).notes
    concepts = [WALK, WAVE, "a person nods"]
    assert MANY_AT_ONCE in toy.compose(concepts, method="fused", **HOW).notes
    assert MANY_AT_ONCE not in toy.compose(concepts[:2], method="fused", **HOW).notes
    assert MANY_AT_ONCE not in toy.compose(concepts, method="parts", **HOW).notes


def test_joined_clips_have_the_notes_of_all(toy: MotionPipeline) -> None:
    clips = [
        replace(toy.generate(text, **HOW), notes=notes) for text, notes in ((WALK, ("a", "b")), (WAVE, ("b", "c")))
    ]
    joined = join_clips(clips, dict.fromkeys([LEGS, TRUNK, *ARMS], 0))
    assert joined.notes == ("a", "b", "c") and joined.text == WALK
    assert np.abs(joined.joints - clips[0].joints).max() < 1e-4


def test_one_concept_is_its_own_clip(toy: MotionPipeline) -> None:
    clip = toy.compose([WALK], method="parts", **HOW)
    assert np.abs(clip.joints - toy.generate(WALK, **HOW).joints).max() < 1e-4


def test_a_concept_without_a_part_is_told(toy: MotionPipeline) -> None:
    same = toy.compose([WALK, toy.parse(WALK)], method="parts", **HOW)
    assert same.notes[-1] == f"{WALK!r}: the others do more with every part of the body, so it is left out"


def test_the_concepts_tell_the_length(toy: MotionPipeline) -> None:
    lengths = [toy.compose([WALK, WAVE], method=method, seed=1).frames for method in ("latent", "parts")]
    assert lengths[0] == lengths[1]


def test_every_step_of_every_concept_is_reported(toy: MotionPipeline) -> None:
    done: list[tuple[int, int]] = []
    toy.compose([WALK, WAVE], method="parts", on_step=lambda step: done.append((step.done, step.total)), **HOW)
    assert [step for step, _ in done] == list(range(1, done[0][1] + 1)) and {total for _, total in done} == {len(done)}
    with pytest.raises(Cancelled):
        toy.compose([WALK, WAVE], method="parts", on_step=lambda step: step.done < 3, **HOW)


@pytest.mark.parametrize(
    ("concepts", "options", "message"),
    [
        ([WALK, Concept(WAVE, 0.5)], {}, r"'a person waves' has the weight 0\.5"),
        ([WALK, Concept(WAVE, -1.0)], {}, "weighs and negates nothing"),
        ([WALK, WAVE], {"text": WALK}, "text is for other methods"),
        ([WALK, WAVE], {"lambdas": (0.3, 0.3, 0.4)}, "lambdas is for other methods"),
        ([WALK, WAVE], {"agd": (0.1, 0.1)}, "agd is for other methods"),
        ([WALK, WAVE], {"constraints": [Waypoint(1.0, (0.0, 1.0))]}, "constraints is for other methods"),
        ([], {}, "1 to 8 concepts"),
        ([WALK, WAVE], {"seconds": 100}, "seconds"),
    ],
)
def test_what_parts_cannot_do_is_refused(
    toy: MotionPipeline, concepts: list[Any], options: dict[str, Any], message: str
) -> None:
    with pytest.raises(InvalidInputError, match=message):
        toy.compose(concepts, method="parts", **{**HOW, **options})
