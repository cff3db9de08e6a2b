"""Synthetic excerpts: walks and runs of every length.

Captured walks last 6 to 12 seconds and captured turns 4 to 6, so a model that is asked for four seconds of walking
forward turns (11 of 30 clips of bundle 0.5.0 did): it has seen nothing else of that length. A walk is a walk at any
length, so parts of captured walks, and captured walks stitched together where their strides match, are walks too.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from kinegraph.motion.blending import stitch
from kinegraph.motion.skeleton import canonicalise
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.metrics import FPS
from kinegraph_training.synthetic.caption_grammar import concept_caption, is_turn

STEADY: Final = ("walk", "run")
"""Actions that look the same at every moment."""
SHORTEST: Final = 30
"""Frames (1.5 s): one and a half strides of a walk."""
NEW_CAPTIONS: Final = 2
"""Captions written for each excerpt, besides those kept from its clip."""

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
    """Make `count` walks and runs whose length is log-uniform between `SHORTEST` and `max_frames`.

    Captions are those of the clip that name no number or distance, and new ones for the same action and style.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    usable = [clip for clip in clips if clip.action in STEADY and len(clip.joints) >= SHORTEST]
    excerpts: list[MotionClip] = []
    while len(excerpts) < count and usable:
        clip = draw_clip(usable, rng)
        group = [candidate for candidate in usable if (candidate.action, candidate.style) == (clip.action, clip.style)]
        other = group[int(rng.integers(len(group)))]
        frames = round(float(np.exp(rng.uniform(np.log(SHORTEST), np.log(max_frames)))))
        joints = clip.joints if len(clip.joints) >= frames else stitch([clip.joints, other.joints], FPS)
        frames = min(frames, len(joints))
        start = int(rng.integers(len(joints) - frames + 1))
        captions = tuple(caption for caption in clip.captions if not _NUMBER_OR_DISTANCE.search(caption))
        captions += tuple(concept_caption(clip.action, clip.style, rng) for _ in range(NEW_CAPTIONS))
        excerpts.append(
            replace(
                clip,
                id=f"excerpt_{len(excerpts):05d}",
                joints=canonicalise(joints[start : start + frames]),
                captions=captions,
                steps=None,
                any_length=True,
            )
        )
    return excerpts
