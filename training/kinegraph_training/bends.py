"""Walks and runs bent into turns: motion path editing (Gleicher, 2001), the way turned and the body with it.

Of the sixteen manners six have recorded turns. A model that has to turn in another one, a pair that it has not seen,
turns too little: it has to learn that turning goes with any manner, at any length, by any number of degrees.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from kinegraph.motion.feet import planted_feet
from kinegraph.motion.placement import placed
from kinegraph.motion.poses import smoothstep
from kinegraph.motion.quaternions import about_axis, rotate
from kinegraph.motion.skeleton import FloatArray
from kinegraph_training.data import MotionClip
from kinegraph_training.excerpts import make_excerpts
from kinegraph_training.measures import FPS
from kinegraph_training.phrases import turned_captions

DEGREES: Final = (40.0, 130.0)
RATES: Final = (18.0, 40.0)
"""Degrees a second on average while turning; recorded turns take 90 degrees in about four seconds."""


def make_bends(
    clips: Sequence[MotionClip], count: int, seed: int, max_frames: int, straight_manners: Sequence[str] = ()
) -> list[MotionClip]:
    """`count` walks and runs that turn to one side, of any length, with captions that say so and by how much.

    Manners in `straight_manners` are left out: turning in them is what a model is tested on.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    usable = [clip for clip in clips if clip.style not in straight_manners]
    made: list[MotionClip] = []
    for clip in make_excerpts(usable, count, seed, max_frames):
        side = "left" if rng.random() < 0.5 else "right"
        rate = rng.uniform(*RATES)
        degrees = min(float(rng.uniform(*DEGREES)), rate * len(clip.joints) / FPS)
        turning = round(degrees / rate * FPS)
        start = int(rng.integers(len(clip.joints) - turning + 1))
        part = np.clip((np.arange(len(clip.joints)) - start) / max(1, turning), 0.0, 1.0)
        angle = np.radians(degrees if side == "left" else -degrees) * smoothstep(part)
        made.append(
            replace(
                clip,
                id=f"bend_{len(made):05d}",
                joints=placed(planted_feet(bent(clip.joints, angle), FPS)),
                captions=turned_captions(clip.content, side, degrees, clip.style, rng),
                content=f"{clip.content}-turn-{side}",
            )
        )
    return made


def bent(joints: FloatArray, angle: FloatArray) -> FloatArray:
    """The body (frames, 22, 3) turned by `angle` (frames,) radians about the vertical through its pelvis, to the left
    where positive, and its way with it: every part of the way is as long as it was."""
    pelvis = joints[:, 0].astype(np.float64)
    ways = np.diff(pelvis, axis=0)
    turned = rotate(about_axis(1, (angle[1:] + angle[:-1]) / 2), ways)
    way = pelvis[:1] + np.concatenate([np.zeros((1, 3)), np.cumsum(turned, axis=0)])
    body = rotate(about_axis(1, angle)[:, None], joints - pelvis[:, None])
    return (body + way[:, None]).astype(np.float32)
