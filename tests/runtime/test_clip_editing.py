"""Edits, in-betweens and streams: what is kept stays, ends meet, and a stream never jumps."""

from __future__ import annotations

import itertools
import tracemalloc
from typing import Any

import numpy as np
import pytest

from kinegraph import Clip, InvalidInputError, MotionPipeline
from kinegraph.clip_editing import encode
from kinegraph.constraints import EndPose, StartPose, Waypoint
from kinegraph.decoding import decode_joints
from kinegraph.keeping import PARTS
from kinegraph.motion.energies import to_own_frames
from kinegraph.motion.skeleton import JOINT_INDEX, PELVIS, bone_lengths

pytest.importorskip("spacy")

FEW: dict[str, Any] = {"steps": 4, "seed": 3}
WALK, WAVE, BOW = "a person walks forward", "a person waves the right hand", "a person bows"


@pytest.fixture(scope="module")
def walk(toy: MotionPipeline) -> Clip:
    return toy.generate(WALK, seconds=2, **FEW)


def test_a_clip_is_encoded_near_itself(toy: MotionPipeline, walk: Clip) -> None:
    latent = encode(walk.joints, toy.sampler)
    spec = toy.manifest.levels["specific"]
    assert latent.shape == (1, spec.tokens, spec.latent_width)
    sessions, bones = toy.decoder.sessions, toy.decoder.bones
    (again,) = decode_joints(sessions.decoder, toy.manifest, bones, latent, [walk.frames])
    other = toy.generate(WAVE, seconds=2, **FEW)
    # its encoder was fitted to latents that no motion has: places drift, poses are told apart
    own = to_own_frames(again.astype(np.float64))[0]
    near, far = (
        np.linalg.norm(own - to_own_frames(clip.joints.astype(np.float64))[0], axis=-1).mean() for clip in (walk, other)
    )
    assert near < 0.1 and near < far


@pytest.mark.parametrize("strength", [1.0, 0.5])
def test_legs_are_kept_and_the_rest_changes(toy: MotionPipeline, walk: Clip, strength: float) -> None:
    edited = toy.edit(walk, WAVE, keep="legs", strength=strength, **FEW)
    legs, wrist = list(PARTS["legs"]), JOINT_INDEX["right_wrist"]
    away = np.linalg.norm(edited.joints[:, wrist] - walk.joints[:, wrist], axis=-1).mean()
    moved = edited.joints[:, legs] - (walk.joints - walk.joints[0, PELVIS] * [1, 0, 1])[:, legs]
    assert np.linalg.norm(moved, axis=-1).mean() < 0.01 and edited.frames == walk.frames
    assert edited.misses[-1].what == "what is kept" and edited.misses[-1].metres < 0.01
    assert away > 0.015
    lengths = bone_lengths(edited.joints)
    assert np.abs(lengths - lengths[0]).max() < 1e-4


def test_a_span_is_kept_to_the_millimetre(toy: MotionPipeline, walk: Clip) -> None:
    edited = toy.edit(walk, BOW, keep=[(0.0, 1.0)], **FEW)
    start = walk.joints - walk.joints[0, PELVIS] * [1, 0, 1]
    assert np.linalg.norm(edited.joints[:20] - start[:20], axis=-1).mean() < 5e-3
    assert np.linalg.norm(edited.joints[-1] - start[-1], axis=-1).mean() > 0.05


def test_the_last_moment_of_a_clip_is_a_frame(toy: MotionPipeline, walk: Clip) -> None:
    edited = toy.edit(walk, BOW, keep=[(1.99, 2.0)], **FEW)
    start = walk.joints - walk.joints[0, PELVIS] * [1, 0, 1]
    assert edited.misses[-1].metres < 5e-3 and np.linalg.norm(edited.joints[-1] - start[-1], axis=-1).mean() < 0.01


def test_an_arm_comes_along(toy: MotionPipeline, walk: Clip) -> None:
    waved = toy.generate(WAVE, seconds=2, **FEW)
    edited = toy.edit(waved, WALK, keep=["right arm"], **FEW)
    arm = list(PARTS["right arm"])
    own, before = (to_own_frames(clip.joints.astype(np.float64))[0][:, arm] for clip in (edited, waved))
    assert np.linalg.norm(own - before, axis=-1).mean() < 0.02
    assert np.abs(edited.joints - waved.joints).max() > 0.05


def test_less_strength_stays_nearer(toy: MotionPipeline, walk: Clip) -> None:
    own = to_own_frames(walk.joints.astype(np.float64))[0]
    distance = [
        np.linalg.norm(to_own_frames(edited.joints.astype(np.float64))[0] - own, axis=-1).mean()
        for edited in (toy.edit(walk, WAVE, keep="left leg", strength=share, **FEW) for share in (0.25, 1.0))
    ]
    assert distance[0] < distance[1]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"keep": []}, "keep is a list"),
        ({"keep": None}, "keep is a list"),
        ({"keep": "tail"}, "the parts are legs"),
        ({"keep": [(1.0, 0.5)]}, "must rise"),
        ({"keep": [(0.0, 9.0)]}, "must rise"),
        ({"keep": [(0.0, float("nan"))]}, "must rise"),
        ({"keep": [3]}, "keep holds 3"),
        ({"keep": [(0.0, 2.0)]}, "keep names all of the clip"),
        ({"keep": [(0.0, 1.0), (1.0, 2.0)]}, "keep names all of the clip"),
        ({"keep": "legs", "constraint_fix": 3}, "constraint_fix"),
        ({"keep": "legs", "constraint_weight": -1}, "constraint_weight"),
        ({"keep": "legs", "strength": 0}, "strength must be"),
        ({"keep": "legs", "strength": "all"}, "strength must be"),
    ],
)
def test_bad_edits_are_refused(toy: MotionPipeline, walk: Clip, options: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidInputError, match=words):
        toy.edit(walk, WAVE, **FEW, **options)


def test_an_edit_takes_a_clip_and_further_constraints(toy: MotionPipeline, walk: Clip) -> None:
    with pytest.raises(InvalidInputError, match="takes a Clip"):
        toy.edit(walk.joints, WAVE, keep="legs")  # type: ignore[arg-type]
    edited = toy.edit(walk, WALK, keep="arms", constraints=[Waypoint(2.0, (0.3, 1.0))], **FEW)
    assert [miss.what for miss in edited.misses] == ["waypoint at 2 s", "what is kept"]
    assert edited.misses[0].metres < 0.01


def test_an_in_between_starts_and_ends_as_asked(toy: MotionPipeline, walk: Clip) -> None:
    bow = toy.generate(BOW, seconds=2, **FEW)
    clip = toy.inbetween(walk, bow, 2.0, WALK, **FEW)
    assert clip.frames == 40 and [miss.what for miss in clip.misses] == ["start pose", "end pose"]
    assert max(miss.metres for miss in clip.misses) < 5e-3
    np.testing.assert_allclose(clip.joints[:4], StartPose(walk).frames(20.0), atol=0.02)
    assert len(EndPose(bow).frames(20.0)) == 4
    poses = walk.joints[5], walk.joints[30]
    placed = toy.inbetween(*poses, 1.5, WALK, placed=True, **FEW)
    way = np.linalg.norm((poses[1] - poses[0])[PELVIS, [0, 2]])
    assert np.linalg.norm(placed.joints[-1, PELVIS, [0, 2]]) == pytest.approx(way, abs=0.02)
    for bad in ({"seconds": 99.0}, {"placed": 1}):
        with pytest.raises(InvalidInputError):
            toy.inbetween(walk, bow, **{"seconds": 2.0, "text": WALK, **FEW, **bad})  # type: ignore[arg-type]


def test_a_stream_has_no_jump_and_the_lengths_that_were_asked_for(toy: MotionPipeline) -> None:
    texts = itertools.cycle([WALK, WAVE, BOW])
    frames = np.array(list(itertools.islice(toy.stream(texts, seconds=1.5, **FEW), 120)))
    assert frames.shape == (120, 22, 3)
    steps = np.linalg.norm(np.diff(frames, axis=0), axis=-1).max(axis=1)
    seams = steps[[29, 59, 89]]
    assert seams.max() <= np.quantile(steps, 0.95) + 0.05 and steps.max() < 0.4
    first = toy.generate(WALK, seconds=1.5, **FEW)
    np.testing.assert_array_equal(frames[:30], first.joints)
    again = list(itertools.islice(toy.stream([WALK, WAVE], seconds=1.5, **FEW), 200))
    np.testing.assert_array_equal(np.array(again), frames[:60])


def test_a_stream_stays_flat_and_refuses_what_is_no_list(toy: MotionPipeline) -> None:
    stream = toy.stream(itertools.repeat(WALK), seconds=1.0, **FEW)
    list(itertools.islice(stream, 60))
    tracemalloc.start()
    list(itertools.islice(stream, 40))
    before = tracemalloc.get_traced_memory()[0]
    list(itertools.islice(stream, 80))
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 200_000
    for bad in (WALK, 3, None):
        with pytest.raises(InvalidInputError, match="sentences one after another"):
            toy.stream(bad)  # type: ignore[arg-type]
    with pytest.raises(InvalidInputError, match="seconds"):
        toy.stream([WALK], seconds=99.0)
