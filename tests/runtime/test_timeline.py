"""Timelines with constraints on the whole: parts get their share, in their own frame, and begin in the last pose."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from kinegraph import MotionPipeline
from kinegraph.constraints import Constraint, EndPose, JointTarget, Keyframe, Loop, Path, StartPose, Waypoint
from kinegraph.errors import InvalidInputError, TimedOut
from kinegraph.motion.body_frame import BodyFrame
from kinegraph.motion.skeleton import JOINT_INDEX
from kinegraph.part_memory import PartMemory
from kinegraph.timeline import generate_timeline, localised
from support.motions import walk

WHERE = BodyFrame(np.array([1.0, 0.0, 2.0]), np.pi / 2)
"""A part that begins at (1, 2) and faces +X."""
TEXTS = ["a person walks", "a person waves", "a person walks"]


def test_each_part_gets_what_falls_into_it_in_its_own_time_and_place() -> None:
    start, end = StartPose(walk(4)), EndPose(walk(4))
    key = Keyframe(2.5, walk(10)[5])
    constraints = [start, end, Waypoint(1.0, (0, 1)), Waypoint(3.0, (2.0, 2.0), heading=90), key]

    def share(begin: float, stop: float) -> list[Any]:
        return list(localised(constraints, (begin, stop), 6.0, 0.2 if begin else 0.0, WHERE))

    assert [type(one) for one in share(0.0, 2.0)] == [StartPose, Waypoint]
    waypoint, keyframe = share(2.0, 4.0)
    assert waypoint.seconds == pytest.approx(1.2) and waypoint.heading == pytest.approx(0)
    np.testing.assert_allclose(waypoint.position, (0, 1), atol=1e-9)
    assert keyframe.seconds == pytest.approx(0.7)
    np.testing.assert_allclose(keyframe.joints, WHERE.to_body(key.joints), atol=1e-5)
    assert [type(one) for one in share(4.0, 6.0)] == [EndPose]
    at_end = localised([Waypoint(6.0, (0, 1)), Waypoint(2.0, (0, 1))], (4.0, 6.0), 6.0, 0.2, WHERE)
    assert [one.seconds for one in at_end] == pytest.approx([2.2])  # type: ignore[union-attr]


def test_a_path_is_cut_into_the_pieces_of_the_parts() -> None:
    path = Path([[0, 0], [0, 3], [3, 3]], heading=[0, 0, 90])
    turned = BodyFrame(np.array([0.0, 0.0, 3.0]), np.pi / 2)
    (first,) = localised([path], (0.0, 3.0), 6.0, 0.0, BodyFrame(np.zeros(3), 0.0))
    (second,) = localised([path], (3.0, 6.0), 6.0, 0.2, turned)
    assert isinstance(first, Path) and isinstance(second, Path) and first.times is not None
    np.testing.assert_allclose(first.points[[0, -1]], [[0, 0], [0, 3]], atol=1e-9)
    np.testing.assert_allclose(second.points[[0, -1]], [[0, 0], [0, 3]], atol=1e-9)  # ahead, as the part sees it
    assert second.times is not None and second.times[0] == pytest.approx(0.2) and second.times[-1] == pytest.approx(3.2)
    assert isinstance(second.heading, np.ndarray) and second.heading[-1] == pytest.approx(0)
    assert localised([Path([[0, 0], [1, 1]], times=[0, 2])], (3.0, 6.0), 6.0, 0.2, WHERE) == ()


def test_a_joint_that_is_held_over_a_join_is_held_in_both_parts() -> None:
    held = JointTarget("left hand", (2.0, 1.5, 2.0), (1.0, 5.0))
    (before,) = localised([held], (0.0, 2.0), 6.0, 0.0, WHERE)
    (after,) = localised([held], (2.0, 6.0), 6.0, 0.2, WHERE)
    assert isinstance(before, JointTarget) and isinstance(after, JointTarget)
    assert before.interval == pytest.approx((1.0, 2.0)) and after.interval == pytest.approx((0.2, 3.2))
    np.testing.assert_allclose(after.position, (0, 1.5, 1), atol=1e-9)  # type: ignore[arg-type]
    (high,) = localised([JointTarget("head", (None, 1.2, None), 1.0)], (0.0, 2.0), 6.0, 0.0, WHERE)
    assert isinstance(high, JointTarget) and high.position == (None, 1.2, None)


def test_an_axis_alone_is_held_in_the_part_that_has_the_axes_of_the_whole(constrained: MotionPipeline) -> None:
    first = BodyFrame(np.zeros(3), 0.0)
    for position in ((0.3, None, None), (None, 1.5, 0.4), (0.3, 1.5, None)):
        (held,) = localised([JointTarget("right hand", position, 1.0)], (0.0, 2.0), 6.0, 0.0, first)
        assert isinstance(held, JointTarget) and held.position == position
    late = [JointTarget("right hand", (0.3, 1.5, None), 1.5), JointTarget("left hand", (0.3, 1.5, 0.4), 1.5)]
    clip = generate_timeline(constrained, TEXTS[:2], seconds=1, constraints=late, seed=3, steps=1)
    assert [note for note in clip.notes if "one axis" in note] == [
        "right_wrist behind the first sentence: one axis of the floor alone is not held; give both, or none"
    ]


def test_a_path_ends_with_the_last_frame(constrained: MotionPipeline) -> None:
    path = Path([[0, 0], [0, 4]])
    (second,) = localised([path], (2.0, 4.0), 4.0, 0.0, BodyFrame(np.zeros(3), 0.0), 0.05)
    assert isinstance(second, Path) and second.times is not None
    assert second.times[-1] == pytest.approx(1.95) and second.points[-1].tolist() == [0, 4]
    pace = np.interp(0.5, second.times, second.points[:, 1]) - second.points[0, 1]
    assert pace == pytest.approx(0.5 * 4 / 3.95)  # as `placements.misses_of` measures it


def test_long_sentences_behind_another_are_shortened_and_told(constrained: MotionPipeline) -> None:
    longest = constrained.manifest.seconds_limits[1]
    clip = generate_timeline(constrained, TEXTS[:2], seconds=[1, longest], seed=3, steps=1)
    assert clip.frames == 20 + constrained.manifest.frames.max - 4
    assert any(note.startswith("sentence 2 has") for note in clip.notes)


@pytest.fixture
def constrained(toy: MotionPipeline) -> MotionPipeline:
    assert toy.sampler.sessions.decoder_gradients
    return toy


def test_parts_follow_one_another_without_a_jump_and_keep_their_lengths(constrained: MotionPipeline) -> None:
    wanted = [Path([[0, 0], [0, 2], [1, 3]]), JointTarget("right hand", (None, 1.3, None), 3.0)]
    clip = generate_timeline(constrained, TEXTS, seconds=[2, 1.5, 1.5], constraints=wanted, seed=3, steps=3)
    assert clip.frames == 100 and clip.seed == 3 and len(clip.misses) == 2
    assert max(miss.metres for miss in clip.misses) < 0.1
    assert abs(clip.joints[60, JOINT_INDEX["right_wrist"], 1] - 1.3) < 0.1
    steps = np.linalg.norm(np.diff(clip.joints, axis=0), axis=-1).max(axis=1)
    seams = steps[[39, 40, 69, 70]]
    assert seams.max() < 2 * np.quantile(steps, 0.95)


def test_only_what_changed_is_made_again(constrained: MotionPipeline) -> None:
    calls: list[float] = []
    memory, generate = PartMemory(), constrained.generate

    class Counting:
        manifest = constrained.manifest

        def generate(self, *arguments: Any, **options: Any) -> Any:
            calls.append(options["seconds"])
            return generate(*arguments, **options)

    counting: Any = Counting()

    def make(texts: list[str], *wanted: Any) -> Any:
        calls.clear()
        return generate_timeline(counting, texts, seconds=1, constraints=wanted, seed=3, steps=2, memory=memory)

    late = Waypoint(2.8, (0.2, 1.5))
    first = make(TEXTS, late)
    assert len(calls) == 3
    again = make(TEXTS, late)
    assert not calls and np.array_equal(first.joints, again.joints)
    make(TEXTS, Waypoint(2.8, (0.3, 1.5)))
    assert len(calls) == 1  # the last part alone
    make([TEXTS[0], "a person bows", TEXTS[2]], late)
    assert len(calls) == 2  # from the changed sentence on
    fresh = generate_timeline(constrained, TEXTS, seconds=1, constraints=[late], seed=3, steps=2)
    assert np.array_equal(fresh.joints, first.joints)


def test_a_weight_of_zero_is_the_timeline_without_constraints(constrained: MotionPipeline) -> None:
    free = generate_timeline(constrained, TEXTS, seconds=1, seed=3, steps=2)
    wanted: list[Constraint] = [Waypoint(1.5, (0, 1)), JointTarget("head", (None, 1.2, None), (0.5, 2.5))]
    still = generate_timeline(constrained, TEXTS, seconds=1, seed=3, steps=2, constraints=wanted, constraint_weight=0)
    np.testing.assert_array_equal(still.joints, free.joints)
    assert len(still.misses) == 2
    # the weight of one counts as the weight of all does
    weighed = [dataclasses.replace(each, weight=0.5) for each in wanted]
    half = generate_timeline(constrained, TEXTS, seconds=1, seed=3, steps=2, constraints=wanted, constraint_weight=0.5)
    same = generate_timeline(constrained, TEXTS, seconds=1, seed=3, steps=2, constraints=weighed)
    np.testing.assert_array_equal(half.joints, same.joints)


def test_a_timeline_stops_in_time_and_is_strict(constrained: MotionPipeline) -> None:
    with pytest.raises(TimedOut):
        generate_timeline(constrained, TEXTS, seconds=1, steps=2, timeout=1e-9)
    with pytest.raises(InvalidInputError, match="strict needs a bundle that knows what it was shown"):
        generate_timeline(constrained, TEXTS, seconds=1, steps=2, strict=True)


def test_a_path_that_begins_after_the_last_frame_of_a_part_is_that_of_the_next(constrained: MotionPipeline) -> None:
    path = Path([[0, 0.5], [0, 1.5]], times=[0.97, 2.0])  # the last frame of the first part is at 0.95 s
    clip = generate_timeline(constrained, TEXTS, seconds=1, seed=3, steps=2, constraints=[path])
    assert np.isfinite(clip.misses[0].metres)
    with pytest.raises(InvalidInputError, match="no frame of the clip falls into its times"):
        constrained.generate(TEXTS[0], seconds=1, constraints=[Path([[0, 0], [0, 0.1]], times=[0.01, 0.04])])


def test_what_does_not_fit_a_timeline_is_refused(toy: MotionPipeline) -> None:
    with pytest.raises(InvalidInputError, match="a loop is for one sentence"):
        generate_timeline(toy, TEXTS, seconds=1, constraints=[Loop()])
    with pytest.raises(InvalidInputError, match="needs the seconds"):
        generate_timeline(toy, TEXTS, seconds=None)  # type: ignore[arg-type]
    with pytest.raises(InvalidInputError):
        generate_timeline(toy, [], seconds=1)
    with pytest.raises(InvalidInputError, match="behind the end"):
        generate_timeline(toy, TEXTS, seconds=1, constraints=[Waypoint(9.0, (0, 1))])
