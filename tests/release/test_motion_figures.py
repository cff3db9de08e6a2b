"""The promised figures of motion, measured on recorded clips and on clips of the default bundle.

They are printed after the tests.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from kinegraph import MotionPipeline
from kinegraph.motion.blending import best_blend, peak_accelerations
from kinegraph.motion.kinematics import forward_kinematics, rotations_from_positions
from kinegraph.motion.skeleton import bone_lengths
from support.motions import largest_twist, recorded

MEAN_MM, MAX_MM = 5.0, 15.0
"""Between joints and the skeleton that is solved from them."""
NO_FLIP = 90.0
"""Degrees by which a limb may turn about its own length from frame to frame; one that flips makes 180.

Recorded clips make up to 38 degrees, those of studio 0.8.0 up to 88 (edge 0.6.0: below 45).
"""
JOIN = 3.0
"""Acceleration at a join, in 95th percentiles of the clips that are joined.

Studio 0.8.0 makes 1.1 on average and 2.4 at most (edge 0.6.0: below 2).
"""
FPS = 20.0

pytestmark = pytest.mark.release

SENTENCES = (
    "a person walks forward", "a person runs", "a person walks and turns to the left", "a person bows",
    "a person turns right and walks in a feminine way", "a person waves the right hand", "a person raises both hands",
    "an old person walks", "a person dashes", "a person walks backward", "a tired person walks",
    "a person walks forward while waving the left hand", "a person shows the way", "a person waves goodbye",
    "a person walks sideways", "a masculine person raises the left hand", "a youthful person runs and turns left",
    "an angry person walks", "a person walks, then bows", "a person runs in a childish way",
)  # fmt: skip
PAIRS = (
    ("a person walks forward", "a person turns left"), ("a person turns left", "a person bows"),
    ("a person runs", "a person walks"), ("a person bows", "a person walks forward"),
    ("a person walks backward", "a person runs"), ("a person raises both hands", "a person walks and turns right"),
    ("an old person walks", "a youthful person runs"), ("a person walks forward", "a person waves the right hand"),
    ("a person bows", "a person waves the right hand"), ("a person raises both hands", "a person bows"),
    ("a person waves the left hand", "a person waves the right hand"),
    ("a person waves the right hand", "a person raises both hands"),
)  # fmt: skip


def check_rotations(clips: list[np.ndarray], name: str, figure: Callable[[str], None]) -> None:
    """Solve the rotations of every clip and hold the joints they give against the clip's own."""
    errors = []
    for joints in clips:
        motion = rotations_from_positions(joints, FPS)
        solved = forward_kinematics(motion.rest_offsets, motion.root, motion.rotations)
        errors.append(np.linalg.norm(solved - joints, axis=-1).ravel() * 1000)
    twist = max(map(largest_twist, clips))
    off = np.concatenate(errors)
    figure(
        f"rotations of {len(clips)} {name} clips: joints off by {off.mean():.2f} mm mean (limit {MEAN_MM:g}), "
        f"{off.max():.1f} mm max (limit {MAX_MM:g}); largest twist {twist:.0f} degrees per frame (limit {NO_FLIP:g})"
    )
    assert off.mean() < MEAN_MM and off.max() < MAX_MM and twist < NO_FLIP


def test_rotations_of_200_recorded_clips(figure: Callable[[str], None]) -> None:
    clips = recorded(count=200, split="train")[:200]
    assert len(clips) == 200
    check_rotations(clips, "recorded", figure)


@pytest.mark.slow
def test_rotations_of_200_generated_clips(pipe: MotionPipeline, figure: Callable[[str], None]) -> None:
    clips = [clip.joints for index, text in enumerate(SENTENCES) for clip in pipe.takes(text, 10, seed=100 * index)]
    assert len(clips) == 200
    check_rotations(clips, "generated", figure)


@pytest.mark.slow
def test_joins_of_generated_sequences(pipe: MotionPipeline, figure: Callable[[str], None]) -> None:
    ratios, twists, bones = [], [], []
    for texts in PAIRS:
        for seed in (1, 2, 3):
            joined = pipe.sequence(texts, seconds=3, seed=seed).joints
            first, second = (pipe.generate(text, seconds=3, seed=seed + k).joints for k, text in enumerate(texts))
            blend = best_blend(first, second, FPS)
            # the blend, and the fifth of a second on either side in which feet come to be locked
            begin, end = max(0, blend.start - 6), blend.start + blend.frames + 4
            usual = np.quantile(np.concatenate([peak_accelerations(first, FPS), peak_accelerations(second, FPS)]), 0.95)
            ratios.append(peak_accelerations(joined, FPS)[begin:end].max() / usual)
            twists.append(largest_twist(joined))
            bones.append(np.ptp(bone_lengths(joined), axis=0).max() * 1000)
    figure(
        f"{len(ratios)} joins of generated sequences: acceleration {max(ratios):.2f} times the 95th percentile of "
        f"their clips at most, {np.mean(ratios):.2f} on average (limit {JOIN:g}); largest twist {max(twists):.0f} "
        f"degrees per frame (limit {NO_FLIP:g}); bones change by {max(bones):.3f} mm"
    )
    assert max(ratios) <= JOIN and max(twists) < NO_FLIP and max(bones) < 1.0


def test_a_sequence_of_three_is_nowhere_jerkier_than_its_parts(
    pipe: MotionPipeline, figure: Callable[[str], None]
) -> None:
    texts, seconds = ["a person walks forward", "a person turns left", "a person bows"], [3, 2, 3]
    worst = []
    for seed in range(1, 6):
        joined = pipe.sequence(texts, seconds=seconds, seed=seed).joints
        parts = [
            peak_accelerations(pipe.generate(text, seconds=length, seed=seed + k).joints, FPS)
            for k, (text, length) in enumerate(zip(texts, seconds, strict=True))
        ]
        limit = max(JOIN * np.quantile(np.concatenate(parts), 0.95), *(part.max() for part in parts))
        worst.append(peak_accelerations(joined, FPS).max() / limit)
    figure(f"5 sequences of three: acceleration anywhere {max(worst):.2f} of what their parts allow (limit 1)")
    assert max(worst) <= 1.0
