"""Synthetic excerpts: steady actions and gestures of every length, and short actions with standing around them.

Captured walks last 6 to 12 seconds and captured turns 4 to 6, so a model that is asked for four seconds of walking
forward turns (11 of 30 clips of bundle 0.5.0 did): it has seen nothing else of that length. A walk is a walk at any
length, so parts of captured walks, and captured walks stitched together where their strides match, are walks too. A
wave is a wave while the hand goes to and fro. A kick of one second is a kick with somebody standing before and after.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.motion.blending import stitch
from kinegraph.motion.skeleton import JOINT_INDEX, start_at_origin
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.data.windows import holds_at_any_moment
from kinegraph_training.metrics import FPS
from kinegraph_training.synthetic.caption_grammar import LOCOMOTION, PHRASES, concept_caption, is_turn
from kinegraph_training.synthetic.compositions import (
    BLEND,
    MAX_POSE_GAP,
    MAX_SLIDE,
    draws,
    goes_round,
    pose_gap,
    slide_of_join,
    stitch_clips,
)
from kinegraph_training.synthetic.gestures import draw_body

WRISTS: Final = (JOINT_INDEX["left_wrist"], JOINT_INDEX["right_wrist"])

SHORTEST: Final = 30
"""Frames (1.5 s): one and a half strides of a walk."""
NEW_CAPTIONS: Final = 2
"""Captions written for each excerpt, besides those kept from its clip."""

GESTURE_SECONDS: Final = (2.0, 5.0)
"""Range of the length of an excerpt of a gesture."""
SHORT_SECONDS: Final = 3.2
"""Actions of the whole body that last less are shown with standing around them too."""
STANDING_SECONDS: Final = (0.4, 1.6)
_CANDIDATES: Final = 6
"""Places of a gesture's excerpt that are tried; the one in which the hands move most is taken."""

_NUMBER_OR_DISTANCE = re.compile(
    r"\b(\d+|one|two|three|four|five|six|seven|eight|nine|ten|eleven|twelve|\w+teen|twenty|dozen|once|twice"
    r"|met(?:er|re)s?|feet|steps?|paces?|seconds?|times?)\b",
    re.IGNORECASE,
)


def draw_clip(clips: Sequence[MotionClip], rng: np.random.Generator) -> MotionClip:
    """Draw a clip; actions and styles come by the square root of their number of clips."""
    groups: dict[tuple[str, str], list[MotionClip]] = {}
    for clip in clips:
        groups.setdefault((clip.action, clip.style), []).append(clip)
    names = sorted(groups)
    weights = np.array([len(groups[name]) for name in names], dtype=float) ** 0.5
    group = groups[names[int(rng.choice(len(names), p=weights / weights.sum()))]]
    return group[int(rng.integers(len(group)))]


def select_turning_styles(clips: Sequence[MotionClip]) -> list[MotionClip]:
    """Select the clips of styles that have at least one captured turn.

    Extra straight walks of other styles taught the model not to turn in them: with such walks of elderly people, whose
    turns are held out, their right turns succeeded in 41 %.
    """
    styles = {clip.style for clip in clips if any(is_turn(action) for action in clip.actions)}
    return [clip for clip in clips if clip.style in styles]


def make_excerpts(clips: Sequence[MotionClip], count: int, seed: int, max_frames: int) -> list[MotionClip]:
    """Make `count` clips of steady actions whose length is log-uniform between `SHORTEST` and `max_frames`.

    Captions are those of the clip that name no number or distance, and new ones for the same action and style.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    usable = [clip for clip in clips if _is_steady(clip) and len(clip.joints) >= SHORTEST]
    excerpts: list[MotionClip] = []
    for _ in draws(excerpts, count if usable else 0):
        clip = draw_clip(usable, rng)
        frames = round(float(np.exp(rng.uniform(np.log(SHORTEST), np.log(max_frames)))))
        joints = clip.joints
        if len(joints) < frames and clip.action in LOCOMOTION:
            group = [other for other in usable if (other.action, other.style) == (clip.action, clip.style)]
            joints = stitch([joints, group[int(rng.integers(len(group)))].joints], FPS)
        frames = min(frames, len(joints))
        start = int(rng.integers(len(joints) - frames + 1))
        part = joints[start : start + frames]
        if goes_round(clip.action, part):
            excerpts.append(_as_excerpt(clip, part, len(excerpts), rng))
    return excerpts


def make_gesture_excerpts(clips: Sequence[MotionClip], count: int, seed: int) -> list[MotionClip]:
    """Make `count` excerpts of 2 to 5 s of repeated gestures, where the hands move most."""
    rng = np.random.Generator(np.random.PCG64(seed))
    shortest, longest = (round(seconds * FPS) for seconds in GESTURE_SECONDS)
    usable = [
        clip
        for clip in clips
        if clip.action in PHRASES and PHRASES[clip.action].parts in ("arm", "arms") and PHRASES[clip.action].steady
        if len(clip.joints) > shortest
    ]
    excerpts: list[MotionClip] = []
    while len(excerpts) < count and usable:
        clip = draw_clip(usable, rng)
        frames = int(rng.integers(shortest, min(longest, len(clip.joints)) + 1))
        starts = rng.integers(len(clip.joints) - frames + 1, size=_CANDIDATES)
        start = max(starts, key=lambda first: hand_path(clip.joints[first : first + frames]))
        excerpts.append(_as_excerpt(clip, clip.joints[start : start + frames], len(excerpts), rng, kind="gesture"))
    return excerpts


def make_padded(
    clips: Sequence[MotionClip], standing: Sequence[MotionClip], count: int, seed: int, max_frames: int
) -> list[MotionClip]:
    """Make `count` short actions of the whole body with standing before them, after them, or both."""
    rng = np.random.Generator(np.random.PCG64(seed))
    longest = round(SHORT_SECONDS * FPS)
    usable = [clip for clip in clips if clip.action in PHRASES and not _is_steady(clip) and len(clip.joints) < longest]
    bodies = [clip.joints for clip in standing if len(clip.joints) >= SHORTEST]
    padded: list[MotionClip] = []
    for _ in draws(padded, count if usable and bodies else 0):
        clip = draw_clip(usable, rng)
        joints, sides = clip.joints, rng.choice(3)
        for before in (True, False):
            if sides == (1 if before else 0):
                continue
            stand = draw_body(bodies, round(rng.uniform(*STANDING_SECONDS) * FPS) + BLEND, rng)
            pair = (stand, joints) if before else (joints, stand)
            if pose_gap(pair[0][-1], pair[1][0]) < MAX_POSE_GAP:
                joined = stitch_clips(start_at_origin(pair[0]), start_at_origin(pair[1]))
                if slide_of_join(joined, len(pair[0])) <= MAX_SLIDE:
                    joints = joined
        if joints is not clip.joints and len(joints) <= max_frames:
            padded.append(_as_excerpt(clip, joints, len(padded), rng, kind="padded"))
    return padded


def hand_path(joints: FloatArray) -> float:
    """Compute the length of the path of both wrists relative to the pelvis, in metres."""
    relative = joints[:, list(WRISTS)] - joints[:, :1]
    return float(np.linalg.norm(np.diff(relative, axis=0), axis=-1).sum())


def _is_steady(clip: MotionClip) -> bool:
    return clip.action in PHRASES and PHRASES[clip.action].steady and PHRASES[clip.action].parts in ("legs", "body")


def _as_excerpt(
    clip: MotionClip, joints: FloatArray, number: int, rng: np.random.Generator, kind: str = "excerpt"
) -> MotionClip:
    """Make a clip of other joints with captions that stay true of it."""
    captions = tuple(
        caption for caption in clip.captions if not _NUMBER_OR_DISTANCE.search(caption) and holds_at_any_moment(caption)
    )
    captions += tuple(concept_caption(clip.action, clip.style, rng) for _ in range(NEW_CAPTIONS))
    return replace(
        clip,
        id=f"{kind}_{number:05d}",
        joints=start_at_origin(joints),
        captions=captions,
        steps=None,
        any_length=True,
        made_by=kind,
    )
