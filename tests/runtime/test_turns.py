"""How far sentences turn the body, and motions that are turned as far."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from kinegraph import Concept, MotionPipeline, decoding
from kinegraph.bundle.reader import text_files_folder
from kinegraph.constraints import Waypoint
from kinegraph.decoding import tell_turn, turn_as_said
from kinegraph.edits import with_weight
from kinegraph.motion.skeleton import bone_lengths, facing_angle
from kinegraph.motion.turning import bend, has_heading, hold_back_turn, net_turn, scale_turn, smooth_with_ends, turn_by
from kinegraph.options import GenerateOptions, resolve_options
from kinegraph.request import turn_of
from kinegraph.text.quantities import find_degrees
from kinegraph.text.turns import FULL, HALF, QUARTER, SLIGHT, UNSAID, Turn, read_turn
from support.motions import turn, walk
from support.toy import with_parser

pytest.importorskip("spacy")

from kinegraph.text.parser import GraphParser, read_parser


@pytest.fixture(scope="module")
def parser() -> GraphParser:
    return read_parser(text_files_folder())


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> MotionPipeline:
    return MotionPipeline.load(with_parser(tmp_path_factory.mktemp("toy") / "bundle"), threads=1)


@pytest.mark.parametrize(
    ("text", "degrees"),
    [
        ("by 90 degrees", [90]),
        ("a 45-degree turn", [45]),
        ("a forty-five degree turn", [45]),
        ("180° to the left", [180]),
        ("one hundred and eighty degrees", [180]),
        ("three hundred sixty degrees", [360]),
        ("a hundred degrees", [100]),
        ("about 22.5 deg", [22.5]),
        ("5 degrees, then ten degrees", [5, 10]),
        ("-90 degrees", []),
        ("to some degree", []),
        ("2 seconds", []),
    ],
)
def test_angles_are_read(text: str, degrees: list[float]) -> None:
    assert find_degrees(text) == degrees


@pytest.mark.parametrize(
    ("caption", "degrees", "side", "is_said"),
    [
        ("a person turns left by 90 degrees", 90, 1, True),
        ("turn right by forty-five degrees", 45, -1, True),
        ("he rotates 45 degrees clockwise", 45, -1, True),
        ("turn right 180", 180, -1, True),
        ("a person does a quick 180", 180, 0, True),
        ("a person turns 90º to the left", 90, 1, True),
        ("a person walks several steps and turns right 90 degrees", 90, -1, True),
        ("a person turns 90 degrees to the left while clapping three times", 90, 1, True),
        ("a person turns a bit to the left", SLIGHT, 1, False),
        ("a person spins 360 degrees to the right", 360, -1, True),
        ("a person makes a 90-degree turn to the right", 90, -1, True),
        ("she makes a quarter turn to the left", QUARTER, 1, True),
        ("a person does a half turn", HALF, 0, True),
        ("a man makes a U-turn", HALF, 0, True),
        ("a person does an about-face", HALF, 0, True),
        ("he turns around on the spot", HALF, 0, True),
        ("a person walks forward, turns around and walks back", HALF, 0, True),
        ("a person turns all the way around", FULL, 0, True),
        ("a person turns a full circle", FULL, 0, True),
        ("a person walks and turns left", UNSAID, 1, False),
        ("a person takes a left turn while walking", UNSAID, 1, False),
        ("she turns to the right and waves", UNSAID, -1, False),
        ("a person is turning counterclockwise", UNSAID, 1, False),
        ("he pivots on his left foot to the right", UNSAID, -1, False),
        ("a person turns slightly to the left", SLIGHT, 1, False),
        ("a person runs and turns around the corner", UNSAID, 0, False),
        ("the man turns to face left", UNSAID, 1, False),
        ("a person keeps the hands down and turns left", UNSAID, 1, False),
        ("a person walks in a circle to the left", FULL, 1, False),
        ("someone runs around in a wide circle", FULL, 0, False),
        ("a person walks in half a circle", HALF, 0, True),
        ("she walks a full circle", FULL, 0, True),
        ("he turns right to look back", UNSAID, -1, False),
        ("her walk bends to the left", UNSAID, 1, False),
        ("she spins to face the other way, going nowhere", HALF, 0, True),
        ("one full rotation on the spot", FULL, 0, True),
        ("a person turns left with his hands behind his back", UNSAID, 1, False),
        ("a person turns left with the back straight", UNSAID, 1, False),
        ("a person turns left with arms fully extended", UNSAID, 1, False),
        ("a person turns around right away", HALF, 0, True),
        ("a person turns right away to the left", UNSAID, 1, False),
        ("a person turns back", HALF, 0, True),
        ("a person turns completely around", FULL, 0, True),
        ("a person turns 180 to the left", HALF, 1, True),
        ("a person does a 360", FULL, 0, True),
        ("a person turns the whole body around", HALF, 0, True),
        ("a person turns left for 90 seconds", UNSAID, 1, False),
    ],
)
def test_turns_are_read(parser: GraphParser, caption: str, degrees: float, side: int, is_said: bool) -> None:
    assert read_turn(parser.parse(caption)) == Turn(degrees, side, is_said)


@pytest.mark.parametrize(
    "caption",
    [
        "a person walks forward",
        "a person turns on the light",
        "a person turns his head to the left",
        "a person rotates the head by 30 degrees",
        "a person turns a wheel",
        "a person turns over",
        "a person spins around",
        "a person bends to the left",
        "someone spins around three times",
        "a person turns around twice",
        "he walks about and turns around more than once",
        "a person keeps turning left",
        "a person always turns left",
        "again and again he turns left",
        "a person turns left and right",
        "a person walks in circles to the left",
        "a person turns 1080 degrees to the left",
        "a person turns left 90 degrees and another 90 degrees",
        "a person turns 1.5 rotations",
        "a person does two full turns",
        "a person turns -90 degrees",
        "a person turns 90 degrees to the left and then to the right",
        "a person turns 90 degrees right then 45 left",
        "a person turns left 90 degrees and then back",
        "a person swings the right arm in a full circle",
        "a person turns the wheel a quarter turn to the right",
        "a person turns the upper body to the left",
        "a person walks in a circle, turning left",
        "a person walks, then turns right, then turns left",
        "a person walks without turning left",
        "he waits for his turn",
    ],
)
def test_what_fixes_no_size_is_not_read(parser: GraphParser, caption: str) -> None:
    assert read_turn(parser.parse(caption)) is None


def test_a_number_of_weight_0_does_not_count(parser: GraphParser) -> None:
    graph = parser.parse("a person turns left by 90 degrees")
    assert read_turn(with_weight(graph, "by 90 degrees", 0.0)) == Turn(UNSAID, 1, False)


def test_edges_weigh_how_far_a_turn_goes_where_that_is_not_said(parser: GraphParser) -> None:
    graph = parser.parse("a person walks and turns to the left")
    assert read_turn(with_weight(graph, "to the left", 0.5)) == Turn(UNSAID / 2, 1, False)
    assert read_turn(with_weight(graph, "turns", 2.0)) == Turn(2 * UNSAID, 1, False)
    assert read_turn(with_weight(graph, "to the left", 0.0)) == Turn(UNSAID, 0, False)
    said = parser.parse("a person turns to the left by 90 degrees")
    assert read_turn(with_weight(said, "to the left", 0.5)) == Turn(90.0, 1, True)


def turning(degrees: float, frames: int = 80) -> np.ndarray:
    """Make a walk that turns evenly, and sways by 6 degrees at each step."""
    sway = np.radians(6.0) * np.sin(np.arange(frames) * 2 * np.pi / 20)
    heading = np.radians(degrees) * np.arange(frames) / (frames - 1) + sway - np.linspace(0.0, sway[-1], frames)
    straight = walk(frames).astype(np.float32)
    return bend(straight, np.append(np.diff(heading - facing_angle(straight) + facing_angle(straight)[0]), 0.0))


@pytest.mark.parametrize("made", [300.0, 120.0, -200.0])
def test_a_motion_turns_exactly_as_far_as_is_said(made: float) -> None:
    side = 1 if made > 0 else -1
    joints = turning(made)
    turned = turn_by(joints, 20, 90, side)
    assert net_turn(turned) == pytest.approx(90 * side, abs=0.1)
    assert np.abs(bone_lengths(turned) - bone_lengths(joints)).max() < 1e-4
    path, straighter = (np.linalg.norm(np.diff(each[:, 0], axis=0), axis=1) for each in (joints, turned))
    assert np.allclose(path, straighter, atol=1e-3)  # steps are as long as before


def test_a_motion_that_hardly_turns_or_turns_the_other_way_is_left() -> None:
    for joints, side in ((turning(30), 1), (turning(-120), 1), (turning(44), 0)):
        assert turn_by(joints, 20, 90, side) is joints


def test_a_body_that_rolls_over_is_left() -> None:
    rolling = np.stack(
        [each @ turn("z", angle).T for each, angle in zip(turning(300), np.linspace(0, 2, 80), strict=True)]
    )
    rolling = rolling.astype(np.float32)
    assert has_heading(turning(300)) and not has_heading(rolling)
    assert turn_by(rolling, 20, 90, 0) is rolling is hold_back_turn(rolling, 20, 85, 0)


def test_the_sway_at_each_step_is_no_turn() -> None:
    joints = turning(300)
    for factor in (0.2, 1.5):
        turned = scale_turn(joints, 20, factor)
        sway = [
            heading - np.poly1d(np.polyfit(np.arange(40), heading, 3))(np.arange(40))
            for heading in (facing_angle(each)[20:60].astype(float) for each in (joints, turned))
        ]
        assert np.std(sway[1]) == pytest.approx(np.std(sway[0]), rel=0.1)


def test_turns_are_held_back_without_a_jump() -> None:
    turned = [net_turn(hold_back_turn(turning(made), 20, 85, 1)) for made in (-100, 40, 84, 86, 170, 340, 1700)]
    assert np.allclose(turned[:4], [-100, 40, 84, 85.3], atol=0.5)
    assert np.allclose(turned[4:], [101.5, 114.4, 119.0], atol=0.5)


def test_the_frames_that_are_shown_turn_as_far() -> None:
    joints = turning(300)
    turned = turn_by(joints, 20, 90, 1, (20, 60))
    assert net_turn(turned[20:60]) == pytest.approx(90, abs=0.1)


def test_a_body_that_turns_on_its_place_stays_there() -> None:
    small_circle = bend(walk(80, speed=0.01).astype(np.float32), np.full(80, np.radians(720) / 79))
    turned = scale_turn(small_circle, 20, 0.125)
    assert net_turn(turned) == pytest.approx(90, abs=3)
    assert turned[:, 0] == pytest.approx(small_circle[:, 0], abs=1e-3)
    walking = scale_turn(turning(300), 20, 0.3)
    assert np.abs(walking[:, 0] - turning(300)[:, 0]).max() > 0.5


def test_smoothing_keeps_both_ends() -> None:
    values = np.random.default_rng(0).normal(size=60).cumsum()
    smoothed = smooth_with_ends(values, 10)
    assert smoothed.shape == values.shape and smoothed[[0, -1]] == pytest.approx(values[[0, -1]])
    assert np.abs(np.diff(smoothed, 2)).max() < 0.2 * np.abs(np.diff(values, 2)).max()
    line = np.linspace(3.0, 9.0, 60)
    assert smooth_with_ends(line, 10) == pytest.approx(line)


def test_a_turn_that_is_not_made_is_told(toy: MotionPipeline) -> None:
    plain = resolve_options(toy.manifest, seed=0)

    def turned(made: float, asked: Turn) -> tuple[float, tuple[str, ...]]:
        options = replace(plain, turn=asked)
        joints = turn_as_said(turning(made), 20, options)
        return net_turn(joints), tell_turn(joints, options)

    degrees, notes = turned(20, Turn(180, 0, True))
    assert degrees == pytest.approx(20, abs=0.5)
    assert notes == ("180 degrees are asked for, and the turn is 20 to the left; try another seed",)
    assert turned(-150, Turn(180, 1, True))[1][0].endswith("the turn is 150 to the right; try another seed")
    assert turned(150, Turn(180, 1, True))[1] == () == turned(20, Turn(UNSAID, 1, False))[1]
    assert turned(20, Turn(21, 1, True))[1] == ()


# Clips

FIVE = "a person turns by 5 degrees"
HOW: dict[str, Any] = {"seconds": 2, "seed": 0}


def test_clips_turn_as_far_however_they_are_made(toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Turn | None] = []
    held = decoding.turn_as_said

    def recording(joints: np.ndarray, fps: float, options: GenerateOptions) -> np.ndarray:
        asked.append(options.turn)
        return held(joints, fps, options)

    monkeypatch.setattr(decoding, "turn_as_said", recording)
    clips = [
        toy.generate(FIVE, **HOW),
        *toy.takes(FIVE, 2, **HOW),
        *toy.batch([FIVE, "a person walks"], shared_run=True, seconds=[2, 2], seed=0)[:1],
        toy.compose([FIVE], **HOW),
        toy.compose([FIVE, "a person walks"], **HOW),
    ]
    assert asked == [Turn(5, 0, True)] * 4 + [None] + [Turn(5, 0, True)] * 2  # the second of the batch has no turn
    for clip in clips:
        told = [note for note in clip.notes if "degrees are asked for" in note]
        assert told or abs(net_turn(clip.joints)) == pytest.approx(5, abs=0.1)
    assert abs(net_turn(clips[0].joints)) == pytest.approx(5, abs=0.1)


def test_a_negated_concept_turns_nothing(toy: MotionPipeline) -> None:
    with_it, without = (
        toy.compose([Concept("a person walks"), Concept(text, -0.5)], **HOW)
        for text in (FIVE, "a person turns by 7 degrees")
    )
    assert not with_it.notes and not without.notes


def test_weights_of_concepts_weigh_turns(parser: GraphParser) -> None:
    walk_left, walks, around = (
        parser.parse(f"a person {does}") for does in ("walks and turns left", "walks", "turns around")
    )
    assert turn_of([walk_left, walks], [0.5, 1.0]) == Turn(UNSAID / 2, 1, False)
    assert turn_of([around, walks], [0.5, 1.0]) == Turn(HALF, 0, True)
    assert turn_of([around, walk_left], [1.0, 1.0]) is None is turn_of([walks])
    assert turn_of([walks, walk_left], [1.0, -0.4]) is None  # what must not happen


def test_parts_that_follow_one_another_turn_and_tell_each_for_itself(toy: MotionPipeline) -> None:
    clip = toy.generate("a person walks, then turns around, then turns left by 300 degrees", seconds=6, seed=1)
    asked = [note.split()[0] for note in clip.notes if "degrees are asked for" in note]
    assert asked == ["180", "300"]


def test_a_constrained_clip_tells_its_turn(toy: MotionPipeline) -> None:
    waypoint = Waypoint(1.9, (0.0, 0.5))
    clip = toy.generate("a person turns left by 300 degrees", constraints=[waypoint], **HOW)
    assert [note.split()[0] for note in clip.notes if "degrees are asked for" in note] == ["300"]
    free, unweighted = (
        toy.generate(FIVE, constraints=wanted, constraint_weight=0.0, **HOW).joints for wanted in (None, [waypoint])
    )
    assert np.array_equal(free, unweighted)
