"""Walks and runs of every length.

Recorded walks last 6 to 12 seconds and recorded turns 4 to 6: a model that is asked for four seconds of walking forward
turns (11 of 30 clips of bundle 0.5.0 did), since it has seen nothing else of that length. A walk is a walk at any
length: parts of recorded ones, and ones that go on, joined where the step is alike.
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
from kinegraph_training.synthetic.caption_grammar import concept_caption

STEADY: Final = ("walk", "run")
"""Contents that are the same at every moment."""
SHORTEST: Final = 30
"""Frames (1.5 s): one and a half strides of a walk."""
NEW_CAPTIONS: Final = 2

_COUNTED = re.compile(
    r"\b(\d+|one|two|three|four|five|six|seven|eight|nine|ten|eleven|twelve|\w+teen|twenty|dozen|once|twice"
    r"|met(?:er|re)s?|feet|steps?|paces?|seconds?|times?)\b",
    re.IGNORECASE,
)


def drawn_clip(clips: Sequence[MotionClip], rng: np.random.Generator) -> MotionClip:
    """Actions and manners with many clips more often, but not as much more often as they have clips."""
    kinds: dict[tuple[str, str], list[MotionClip]] = {}
    for clip in clips:
        kinds.setdefault((clip.content, clip.style), []).append(clip)
    names = sorted(kinds)
    weights = np.array([len(kinds[name]) for name in names], dtype=float) ** 0.5
    own = kinds[names[int(rng.choice(len(names), p=weights / weights.sum()))]]
    return own[int(rng.integers(len(own)))]


def in_manners_that_turn(clips: Sequence[MotionClip]) -> list[MotionClip]:
    """Clips of manners with a turn among them.

    What is made of the others only adds straight walks of somebody who was never recorded turning, and says by contrast
    that he cannot: with such walks of old people, whose turns are held out, .41 of their turns to the right were done.
    """
    manners = {clip.style for clip in clips if "turn" in clip.content}
    return [clip for clip in clips if clip.style in manners]


def make_excerpts(clips: Sequence[MotionClip], count: int, seed: int, max_frames: int) -> list[MotionClip]:
    """`count` walks and runs of lengths drawn evenly on a logarithmic scale, up to `max_frames`.

    Captions are those of the clip that say nothing of numbers or distances, and new ones of the same action and manner.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    usable = [clip for clip in clips if clip.content in STEADY and len(clip.joints) >= SHORTEST]
    made: list[MotionClip] = []
    while len(made) < count and usable:
        clip = drawn_clip(usable, rng)
        alike = [each for each in usable if (each.content, each.style) == (clip.content, clip.style)]
        other = alike[int(rng.integers(len(alike)))]
        frames = round(float(np.exp(rng.uniform(np.log(SHORTEST), np.log(max_frames)))))
        joints = clip.joints if len(clip.joints) >= frames else stitch([clip.joints, other.joints], FPS)
        frames = min(frames, len(joints))
        start = int(rng.integers(len(joints) - frames + 1))
        captions = tuple(caption for caption in clip.captions if not _COUNTED.search(caption))
        captions += tuple(concept_caption(clip.content, clip.style, rng) for _ in range(NEW_CAPTIONS))
        made.append(
            replace(
                clip,
                id=f"excerpt_{len(made):05d}",
                joints=canonicalise(joints[start : start + frames]),
                captions=captions,
                steps=None,
                any_length=True,
            )
        )
    return made
