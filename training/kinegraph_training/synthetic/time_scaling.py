"""Motion at other speeds than it was recorded at."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.motion.skeleton import canonicalise
from kinegraph_training.config import DataConfig
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.synthetic.caption_grammar import LOCOMOTION, concept_caption
from kinegraph_training.synthetic.excerpts import drawn_clip

PACE: Final = 1.35
"""Most that a speed is changed, either way."""
LEAST: Final = 1.15
"""Least that a caption calls slow or fast."""
SLOWLY: Final = ("slowly", "at a slow pace", "very slowly", "in no hurry")
FAST: Final = ("quickly", "fast", "at a fast pace", "very fast")
NEW_CAPTIONS: Final = 2

_SPEED = re.compile(
    r"\b(slow(ly)?|quick(ly)?|fast|rapid(ly)?|brisk(ly)?|pace|speed|hurr(y|ied|iedly))\b", re.IGNORECASE
)


def make_paces(clips: Sequence[MotionClip], count: int, seed: int, max_frames: int) -> list[MotionClip]:
    """`count` walks, runs and turns that are slower or faster than they were recorded, with captions that say so.

    In the data only the old and tired are slow and only the lively fast: a model that has to turn an old person by 90
    degrees, a pair that it has not seen, turns by 65. Turns, steps and distances of a caption stay true.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    usable = [clip for clip in clips if clip.content in LOCOMOTION and len(clip.joints) * PACE <= max_frames]
    made: list[MotionClip] = []
    while len(made) < count and usable:
        clip = drawn_clip(usable, rng)
        slow = bool(rng.random() < 0.5)
        pace = float(rng.uniform(LEAST, PACE))
        frames = round(len(clip.joints) * pace if slow else len(clip.joints) / pace)
        words = SLOWLY if slow else FAST
        said = [caption for caption in clip.captions if not _SPEED.search(caption)]
        said += [concept_caption(clip.content, clip.style, rng) for _ in range(NEW_CAPTIONS)]
        captions = tuple(_with_manner(caption, words[int(rng.integers(len(words)))], rng) for caption in said)
        joints = canonicalise(smoothly_resampled(clip.joints, frames))
        made.append(replace(clip, id=f"pace_{len(made):05d}", joints=joints, captions=captions))
    return made


def _with_manner(caption: str, words: str, rng: np.random.Generator) -> str:
    """ "a person walks." -> "slowly, a person walks." or "a person walks slowly."."""
    one_sentence = caption.rstrip(". ")
    if "." in one_sentence or rng.random() < 0.5:
        return f"{words}, {caption}"
    return f"{one_sentence} {words}."


def paced_clips(clips: Sequence[MotionClip], config: DataConfig, seed: int) -> list[MotionClip]:
    """Every clip once more, up to `PACE` times as fast or as slow: an autoencoder that has seen a motion at one speed
    only keeps it badly at another. Not for denoisers: captions say how fast and how often."""
    rng = np.random.Generator(np.random.PCG64(seed))
    paces = PACE ** rng.uniform(-1.0, 1.0, len(clips))
    frames = [max(config.min_frames, round(len(clip.joints) / pace)) for clip, pace in zip(clips, paces, strict=True)]
    return [
        replace(clip, id=f"{clip.id}~paced", joints=smoothly_resampled(clip.joints, count))
        for clip, count in zip(clips, frames, strict=True)
    ]


def smoothly_resampled(joints: FloatArray, frames: int) -> FloatArray:
    """Catmull-Rom in time, end to end: (t, 22, 3) -> (frames, 22, 3). Linear would jerk at every old frame."""
    place = np.linspace(0, len(joints) - 1, frames)
    low = np.minimum(place.astype(int), len(joints) - 2)
    t = (place - low)[:, None, None].astype(np.float32)
    # The ends go on in a straight line.
    rows = np.concatenate([2 * joints[:1] - joints[1:2], joints, 2 * joints[-1:] - joints[-2:-1]])
    before, start, end, after = (rows[low + i] for i in range(4))
    linear, square = end - before, 2 * before - 5 * start + 4 * end - after
    cubic = 3 * (start - end) + after - before
    resampled: FloatArray = start + 0.5 * t * (linear + t * (square + t * cubic))
    return resampled
