"""Bent walks: recorded straight walks and runs led around a circle, through a U-turn, or to a stop.

A turn is added to the heading of every frame (`kinegraph.motion.turning`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from kinegraph.arrays import DoubleArray, FloatArray
from kinegraph.motion.skeleton import JOINT_INDEX, facing_angle, start_at_origin
from kinegraph.motion.turning import bend
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.metrics import FPS
from kinegraph_training.synthetic.caption_grammar import CAPTIONS, PHRASES, concept_caption
from kinegraph_training.synthetic.compositions import MAX_SLIDE, NORMAL, draws, slide_of_join, stitch_clips
from kinegraph_training.synthetic.excerpts import select_turning_styles
from kinegraph_training.synthetic.gestures import draw_body

GAITS: Final = {"walk": "walk", "run": "run", "jog": "run", "walk-back": "walk-back"}
"""Action -> the gait that the labels of its bent paths begin with."""
SHAPES: Final = ("circle", "u-turn", "and-stop")
CIRCLE_FRAMES: Final = 90
"""A shorter walk cannot go round."""
LEFT_ANKLE: Final = JOINT_INDEX["left_ankle"]
RIGHT_ANKLE: Final = JOINT_INDEX["right_ankle"]
MAX_STRAIGHT_TURN: Final = 25.0
"""Degrees: a walk that turns less is straight."""
CIRCLE_DEGREES: Final = (250.0, 420.0)
MAX_DEGREES_PER_SECOND: Final = 80.0
MIN_WAY_BACK: Final = 1.0
"""Metres that somebody goes after a U-turn."""
STOPS: Final = 6
U_TURN_SECONDS: Final = (1.2, 2.4)


def is_straight(joints: FloatArray) -> bool:
    """Tell whether a walk keeps its heading and travels."""
    heading = np.unwrap(facing_angle(joints))
    return bool(
        abs(np.degrees(heading[-1] - heading[0])) < MAX_STRAIGHT_TURN
        and np.linalg.norm(joints[-1, 0, [0, 2]] - joints[0, 0, [0, 2]]) > 1.0
    )


def circle_turn(frames: int, side: str, rng: np.random.Generator) -> DoubleArray:
    """Draw the even turn of a circle: (frames,) radians per frame."""
    seconds = frames / FPS
    total = min(rng.uniform(*CIRCLE_DEGREES), MAX_DEGREES_PER_SECOND * seconds)
    return np.full(frames, _sign(side) * np.radians(total) / frames)


def u_turn(frames: int, side: str, rng: np.random.Generator) -> DoubleArray:
    """Draw a turn of 180 degrees somewhere in the middle of a clip: (frames,) radians per frame."""
    length = round(rng.uniform(*U_TURN_SECONDS) * FPS)
    start = int(rng.integers(frames // 4, max(frames // 4 + 1, frames - length - frames // 5)))
    shape = np.zeros(frames)
    shape[start : start + length] = np.hanning(length + 2)[1:-1][: frames - start]
    return _sign(side) * np.pi * shape / shape.sum()


def _sign(side: str) -> float:
    return 1.0 if side == "left" else -1.0


def make_bent(clips: Sequence[MotionClip], standing: Sequence[MotionClip], count: int, seed: int) -> list[MotionClip]:
    """Make `count` walks and runs in circles, through U-turns and to a stop, of straight recorded ones.

    Args:
        clips: of all actions.
        standing: recordings of people who stand, for the stops.
        count: clips to make.
        seed: of all draws.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    straight = [clip for clip in clips if clip.action in GAITS and len(clip.joints) >= 50 and is_straight(clip.joints)]
    turning = {"", NORMAL, *(clip.style for clip in select_turning_styles(clips))}
    bent: list[MotionClip] = []
    for _ in draws(bent, count if straight else 0):
        clip = straight[int(rng.integers(len(straight)))]
        shape, side = SHAPES[int(rng.integers(len(SHAPES)))], ("left", "right")[int(rng.integers(2))]
        label = f"{GAITS[clip.action]}-{shape}"
        label = label if shape == "and-stop" else f"{label}-{side}"
        if label not in PHRASES or (shape == "circle" and len(clip.joints) < CIRCLE_FRAMES):
            continue
        joints: FloatArray | None
        if shape == "and-stop":
            joints = stop(clip.joints, standing, rng) if standing else None
        elif clip.style not in turning:  # turns may be held out in it
            continue
        else:
            turn = (circle_turn if shape == "circle" else u_turn)(len(clip.joints), side, rng)
            joints = bend(clip.joints, turn)
            if shape == "u-turn" and path_length(joints[np.flatnonzero(turn)[-1] :]) < MIN_WAY_BACK:
                continue
        if joints is None:
            continue
        bent.append(
            MotionClip(
                id=f"bent_{len(bent):05d}",
                joints=joints,
                captions=tuple(concept_caption(label, clip.style, rng) for _ in range(CAPTIONS)),
                actions=(label,),
                style=clip.style,
                any_length=True,
                made_by="bent",
            )
        )
    return bent


def path_length(joints: FloatArray) -> float:
    """Compute the length of the pelvis's path on the ground, in metres."""
    return float(np.linalg.norm(np.diff(joints[:, 0, [0, 2]], axis=0), axis=-1).sum())


def stop(walk: FloatArray, standing: Sequence[MotionClip], rng: np.random.Generator) -> FloatArray | None:
    """Let a walk of 1.5 to 4 s end standing for 1 to 2.5 s, stitched where the feet pass each other.

    Of `STOPS` draws the first is taken in which no foot slides; None if one does in all of them.
    """
    for _ in range(STOPS):
        frames = min(len(walk), round(rng.uniform(1.5, 4.0) * FPS))
        feet = np.linalg.norm(walk[:, LEFT_ANKLE] - walk[:, RIGHT_ANKLE], axis=-1)
        end = frames - 12 + int(np.argmin(feet[frames - 12 : frames])) + 1
        body = draw_body([clip.joints for clip in standing], round(rng.uniform(1.0, 2.5) * FPS), rng)
        joints = stitch_clips(walk[:end], start_at_origin(body))
        if slide_of_join(joints, end) <= MAX_SLIDE:
            return joints
    return None
