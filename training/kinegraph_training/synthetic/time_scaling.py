"""Synthetic time scaling: captured motion at other speeds."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.motion.skeleton import start_at_origin
from kinegraph_training.config import DataConfig
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.synthetic.caption_grammar import LOCOMOTION, concept_caption
from kinegraph_training.synthetic.excerpts import draw_clip

MAX_SCALE: Final = 1.35
"""Largest factor by which a clip is slowed down or sped up."""
MIN_SCALE: Final = 1.15
"""Smallest factor that a caption calls slow or fast."""
SLOWLY: Final = ("slowly", "at a slow pace", "very slowly", "in no hurry")
FAST: Final = ("quickly", "fast", "at a fast pace", "very fast")
NEW_CAPTIONS: Final = 2
"""Captions written for each clip, besides those kept from its source."""

DRAWS: Final = 12
"""Captions that are drawn to find `NEW_CAPTIONS` without a speed of their own."""

_SPEED = re.compile(
    r"\b(slow(ly)?|quick(ly)?|fast|rapid(ly)?|brisk(ly)?|pace|speed(s|ing)?|hurr(y|ies|ying|ied|iedly)"
    r"|sprint(s|ing)?|dash(es|ing)?|rush(es|ing)?|rac(e|es|ing)|bolt(s|ing)?|tear(s|ing)?|charg(e|es|ing)"
    r"|stroll(s|ing)?|ambl(e|es|ing)|shuffl(e|es|ing)|energ\w+)\b",
    re.IGNORECASE,
)
"""Words that say how fast somebody is: another speed beside them would not be true."""


def make_time_scaled(clips: Sequence[MotionClip], count: int, seed: int, max_frames: int) -> list[MotionClip]:
    """Make `count` slower or faster walks, runs and turns whose captions say so, for the denoisers.

    In the captured data only elderly and exhausted people are slow and only active ones fast. A model trained on these
    alone turns an elderly person, a held-out pair, by 65 degrees instead of 90. Turns, steps and distances that a
    caption names stay true at another speed.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    usable = [clip for clip in clips if clip.action in LOCOMOTION and len(clip.joints) * MAX_SCALE <= max_frames]
    scaled: list[MotionClip] = []
    while len(scaled) < count and usable:
        clip = draw_clip(usable, rng)
        slow = bool(rng.random() < 0.5)
        scale = float(rng.uniform(MIN_SCALE, MAX_SCALE))
        frames = round(len(clip.joints) * scale if slow else len(clip.joints) / scale)
        phrases = SLOWLY if slow else FAST
        sentences = [caption for caption in clip.captions if not _SPEED.search(caption)]
        drawn = (concept_caption(clip.action, clip.style, rng) for _ in range(DRAWS))
        sentences += [caption for caption in drawn if not _SPEED.search(caption)][:NEW_CAPTIONS]
        if not sentences:  # all that is said of a dash is said of its speed
            usable = [other for other in usable if other is not clip]
            continue
        captions = tuple(_add_phrase(sentence, phrases[int(rng.integers(len(phrases)))], rng) for sentence in sentences)
        joints = start_at_origin(resample_catmull_rom(clip.joints, frames))
        scaled.append(
            replace(clip, id=f"pace_{len(scaled):05d}", joints=joints, captions=captions, made_by="time_scaled")
        )
    return scaled


def _add_phrase(caption: str, phrase: str, rng: np.random.Generator) -> str:
    """Put a phrase before or after a caption: "slowly, a person walks." or "a person walks slowly."."""
    sentence = caption.rstrip(". ")
    if "." in sentence or rng.random() < 0.5:
        return f"{phrase}, {caption}"
    return f"{sentence} {phrase}."


def time_scaled_copies(clips: Sequence[MotionClip], config: DataConfig, seed: int) -> list[MotionClip]:
    """Copy every clip at a random speed, up to `MAX_SCALE` slower or faster, for the autoencoders.

    An autoencoder that has seen a motion at one speed reconstructs it badly at another. The copies are not for
    denoisers, as their captions may name a speed or a frequency that is no longer true.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    speeds = MAX_SCALE ** rng.uniform(-1.0, 1.0, len(clips))
    copies = []
    for clip, speed in zip(clips, speeds, strict=True):
        frames = max(config.min_frames, round(len(clip.joints) / speed))
        copies.append(replace(clip, id=f"{clip.id}~paced", joints=resample_catmull_rom(clip.joints, frames)))
    return copies


def resample_catmull_rom(joints: FloatArray, frames: int) -> FloatArray:
    """Resample (t, 22, 3) to (frames, 22, 3) by Catmull-Rom splines; first and last frame stay.

    Linear interpolation would jerk at every original frame.
    """
    position = np.linspace(0, len(joints) - 1, frames)
    low = np.minimum(position.astype(int), len(joints) - 2)
    t = (position - low)[:, None, None].astype(np.float32)
    # Control points beyond both ends continue the motion in a straight line.
    rows = np.concatenate([2 * joints[:1] - joints[1:2], joints, 2 * joints[-1:] - joints[-2:-1]])
    # p(t) = p1 + t/2 ((p2 - p0) + t ((2 p0 - 5 p1 + 4 p2 - p3) + t (3 (p1 - p2) + p3 - p0)))
    p0, p1, p2, p3 = (rows[low + i] for i in range(4))
    linear, square = p2 - p0, 2 * p0 - 5 * p1 + 4 * p2 - p3
    cubic = 3 * (p1 - p2) + p3 - p0
    resampled: FloatArray = p1 + 0.5 * t * (linear + t * (square + t * cubic))
    return resampled
