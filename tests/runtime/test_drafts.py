"""Drafts of the playground: the clip of the same words, bent to constraints that are dragged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinegraph.clip import Clip
from kinegraph.constraints import JointTarget, Waypoint
from kinegraph.motion.skeleton import JOINT_INDEX, PELVIS, bone_lengths
from kinegraph.playground.drafts import MAX_DRAFTS, MAX_FRAMES, Drafts, bent
from kinegraph.playground.schemas import ClipRequest
from support.motions import walk

REQUEST = ClipRequest("a person walks", seconds=3.0, seed=7)


def clip_of(frames: int = 60) -> Clip:
    return Clip(walk(frames), 20.0, 7, "a person walks", "toy 1")


def test_a_draft_is_where_it_is_wanted_however_far_that_is() -> None:
    clip = clip_of()
    place = clip.joints[40, PELVIS, [0, 2]] + (1.5, 0.4)
    hand = JointTarget("right hand", (None, 1.5, None), 1.0)
    request = replace(REQUEST, constraints=(Waypoint(2.0, tuple(map(float, place))), hand))
    draft = bent(clip, request)
    np.testing.assert_allclose(draft.joints[40, PELVIS, [0, 2]], place, atol=0.02)
    assert draft.joints[20, JOINT_INDEX["right_wrist"], 1] == pytest.approx(1.5, abs=0.05)
    assert max(miss.metres for miss in draft.misses) < 0.05
    np.testing.assert_allclose(bone_lengths(draft.joints), bone_lengths(clip.joints), atol=2e-3)
    assert draft.frames == clip.frames and draft.seed == 7


def test_drafts_bend_the_clip_of_the_same_words_options_and_seed() -> None:
    drafts, clip = Drafts(), clip_of()
    here = (Waypoint(2.0, (0.0, 1.0)),)
    drafts.keep(replace(REQUEST, constraints=(Waypoint(1.0, (0.5, 1.0)),)), clip)
    assert drafts.draft(replace(REQUEST, constraints=here, draft=True, loop=True)) is not None
    for other in (
        replace(REQUEST, seed=8), replace(REQUEST, text="a person runs"), replace(REQUEST, seconds=2.0),
        replace(REQUEST, steps=3), replace(REQUEST, foot_fix=False), replace(REQUEST, guidance=1.0),
    ):  # fmt: skip
        assert drafts.draft(replace(other, constraints=here)) is None
    drafts.keep(replace(REQUEST, seed=None), clip)  # drawn by the server: nobody can ask for it
    assert drafts.draft(replace(REQUEST, seed=None, constraints=here)) is None


def test_few_and_short_clips_are_kept() -> None:
    drafts = Drafts()
    for seed in range(MAX_DRAFTS + 1):
        drafts.keep(replace(REQUEST, seed=seed), clip_of())
    assert drafts.draft(replace(REQUEST, seed=0)) is None and drafts.draft(replace(REQUEST, seed=1)) is not None
    drafts.keep(replace(REQUEST, seed=99), clip_of(MAX_FRAMES + 1))
    assert drafts.draft(replace(REQUEST, seed=99)) is None
