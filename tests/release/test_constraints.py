"""Constraints with the default bundle: what its weights reach by energies alone and after the correction."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph import MotionPipeline
from kinegraph.constraints import JointTarget, Path, StartPose, Waypoint
from kinegraph.motion.skeleton import JOINT_INDEX

pytest.importorskip("spacy")
pytestmark = pytest.mark.release

WALK, WAVE = "a person walks forward", "a person waves the right hand"
TURN = np.linspace(0.0, np.pi / 2, 12)
ARC = np.stack([1.5 * (1.0 - np.cos(TURN)), 2.5 * np.sin(TURN)], axis=-1)


def test_a_walk_follows_an_arc_and_turns_with_it(pipe: MotionPipeline) -> None:
    clips = [
        pipe.generate(WALK, seconds=4, seed=seed, constraints=[Path(ARC)], constraint_fix=False) for seed in (1, 2)
    ]
    assert np.mean([clip.misses[0].metres for clip in clips]) < 0.03
    clip = pipe.generate(WALK, seconds=4, seed=1, constraints=[Path(ARC, heading="along")])
    assert clip.misses[0].metres < 0.005 and clip.misses[0].degrees is not None and clip.misses[0].degrees < 15


def test_a_hand_a_place_and_a_start_are_met_together(pipe: MotionPipeline) -> None:
    before = pipe.generate("a person bows", seconds=3, seed=4)
    wanted = [StartPose(before), Waypoint(4.0, (0.5, 2.5)), JointTarget("left hand", (None, 1.5, None), 2.0)]
    alone = pipe.generate(WALK, seconds=4, seed=1, constraints=wanted, constraint_fix=False)
    assert max(miss.metres for miss in alone.misses) < 0.045
    clip = pipe.generate(WALK, seconds=4, seed=1, constraints=wanted)
    assert max(miss.metres for miss in clip.misses) < 0.005


def test_a_walk_that_keeps_its_legs_waves(pipe: MotionPipeline) -> None:
    walk = pipe.generate(WALK, seconds=4, seed=5)
    edited = pipe.edit(walk, WAVE, keep="legs", seed=1)
    assert edited.misses[-1].metres < 0.01
    wrist = JOINT_INDEX["right_wrist"]
    assert edited.joints[:, wrist, 1].max() > 1.4 > walk.joints[:, wrist, 1].max()
