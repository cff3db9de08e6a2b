"""Made gestures: arms posed by inverse kinematics on captured bodies, where no free recording holds the gesture.

A gesture is a path of the wrists in the frame of the chest, entered from the pose that the body has, held or repeated,
and left again. Waving and clapping are oscillations of that path; nodding is one of the head. The body below is a
recording of somebody who stands or walks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from kinegraph.arrays import DoubleArray, FloatArray
from kinegraph.motion.skeleton import JOINT_INDEX, start_at_origin
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.data.common_skeleton import trunk_frames
from kinegraph_training.metrics import FPS
from kinegraph_training.synthetic.caption_grammar import CAPTIONS, concept_caption

ENTER_SECONDS: Final = (0.4, 0.8)
"""Range of the time that a hand takes to its place, and back."""
HOLD_SECONDS: Final = (0.8, 3.5)
REACH: Final = 0.985
"""Largest distance of shoulder and wrist as a share of the straight arm."""
CLIP_SECONDS: Final = (2.0, 6.0)
MIN_SECONDS: Final = 1.8
STAYS: Final = 0.3
"""Share of gestures that last to the end of the clip."""


@dataclass(frozen=True)
class ArmGesture:
    """Path of one wrist of a gesture, for the left arm; the right one mirrors it.

    Places are metres from the shoulder in the frame of the chest: outwards, up, forward.
    """

    place: tuple[float, float, float]
    pole: tuple[float, float, float]
    """Direction that the elbow points to."""
    swing: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Amplitude of the oscillation."""
    hertz: tuple[float, float] = (1.0, 1.0)
    """Range of its frequency."""


_RAISED = ArmGesture((0.06, 0.50, 0.04), (1.0, 0.1, -0.4))
_WAVING = ArmGesture((0.22, 0.30, 0.16), (0.7, -1.0, -0.2), (0.17, -0.02, 0.0), (1.1, 2.0))
_WAVING_HIGH = ArmGesture((0.12, 0.47, 0.06), (1.0, 0.0, -0.3), (0.20, -0.04, 0.0), (0.9, 1.7))
_CLAPPING = ArmGesture((-0.10, -0.12, 0.34), (0.6, -1.0, -0.2), (0.09, 0.0, 0.0), (1.6, 3.0))
_THUMB = ArmGesture((0.02, -0.14, 0.36), (0.5, -1.0, -0.3))
_TO_THE_SIDE = ArmGesture((0.50, 0.02, 0.05), (0.0, -1.0, -0.2))

ARM_GESTURES: Final[dict[str, tuple[ArmGesture, ...]]] = {
    "raise": (_RAISED,),
    "wave": (_WAVING, _WAVING_HIGH),
    "clap": (_CLAPPING,),
    "thumbs-up": (_THUMB,),
    "spread": (_TO_THE_SIDE,),
}

MADE: Final[dict[str, tuple[str, tuple[str, ...]]]] = {
    **{f"raise-up-{side}-hand": ("raise", (side,)) for side in ("left", "right")},
    "raise-up-both-hands": ("raise", ("left", "right")),
    **{f"wave-{side}-hand": ("wave", (side,)) for side in ("left", "right")},
    "wave-both-hands": ("wave", ("left", "right")),
    "clap": ("clap", ("left", "right")),
    **{f"thumbs-up-{side}": ("thumbs-up", (side,)) for side in ("left", "right")},
    "spread-arms": ("spread", ("left", "right")),
    "nod": ("nod", ()),
}
"""Label -> its gesture and the arms that make it."""


def make_gesture(body: FloatArray, label: str, rng: np.random.Generator) -> FloatArray:
    """Let a captured body make a gesture.

    Args:
        body: (frames, 22, 3) metres, at least 1.5 s.
        label: one of `MADE`.
        rng: draws place, speed and times.

    Returns:
        (frames, 22, 3) with the body's bone lengths.
    """
    name, arms = MADE[label]
    weight = gesture_weight(len(body), rng)
    if name == "nod":
        return nod(body, weight, rng)
    gesture = ARM_GESTURES[name][int(rng.integers(len(ARM_GESTURES[name])))]
    shift, phase, hertz = rng.normal(0.0, 0.025, 3), rng.uniform(0, 2 * np.pi), rng.uniform(*gesture.hertz)
    amplitude = rng.uniform(0.7, 1.2)
    seconds = np.arange(len(body)) / FPS
    # Arms of a pair swing alike as seen from each of them: together for a clap, apart for a wave.
    swing = np.sin(2 * np.pi * hertz * seconds + phase)[:, None] * np.array(gesture.swing) * amplitude
    out = body.copy()
    for side in arms:
        out = pose_arm(out, side, np.array(gesture.place) + shift + swing, np.array(gesture.pole), weight)
    return out


def gesture_weight(frames: int, rng: np.random.Generator) -> DoubleArray:
    """Draw how much of a gesture is there at each frame (frames,): it comes, stays and usually goes."""
    enter, leave = (max(4, round(rng.uniform(*ENTER_SECONDS) * FPS)) for _ in range(2))
    longest = max(1, frames - enter)
    hold = min(longest, round(rng.uniform(*HOLD_SECONDS) * FPS))
    if rng.random() < STAYS:
        hold = longest
    start = int(rng.integers(0, max(1, frames - enter - hold - leave)))
    index = np.arange(frames)
    rise, fall = (index - start) / enter, (start + enter + hold + leave - index) / leave
    return smoothstep(np.minimum(np.clip(rise, 0, 1), np.clip(fall, 0, 1)))


def smoothstep(t: DoubleArray) -> DoubleArray:
    """Ease in and out: 3 t^2 - 2 t^3."""
    return t * t * (3.0 - 2.0 * t)


def pose_arm(body: FloatArray, side: str, place: DoubleArray, pole: DoubleArray, weight: DoubleArray) -> FloatArray:
    """Move one wrist along a path by two-bone inverse kinematics.

    Args:
        body: (frames, 22, 3).
        side: "left" or "right".
        place: (frames, 3) of the wrist from the shoulder, in the chest's frame of the left arm: outwards, up, forward.
        pole: (3,) direction of the elbow in the same frame.
        weight: (frames,) 0 leaves the arm as it is, 1 puts the wrist in its place.
    """
    shoulder, elbow, wrist = (JOINT_INDEX[f"{side}_{name}"] for name in ("shoulder", "elbow", "wrist"))
    _, chest = trunk_frames(body)
    outwards = np.array([1.0 if side == "left" else -1.0, 1.0, 1.0])
    origin = body[:, shoulder].astype(np.float64)
    upper, fore = (np.linalg.norm(body[:, a] - body[:, b], axis=-1) for a, b in ((elbow, shoulder), (wrist, elbow)))
    share = weight[:, None]
    # The wrist goes around the shoulder, not through the body: direction and distance are blended apart.
    own, target = body[:, wrist] - origin, np.einsum("tij,tj->ti", chest, place * outwards)
    distance = (1 - weight) * np.linalg.norm(own, axis=-1) + weight * np.linalg.norm(target, axis=-1)
    distance = np.clip(distance, np.abs(upper - fore) + 0.03, REACH * (upper + fore))
    direction = _unit(_slerp(_unit(own), _unit(target), weight))
    bend = (1 - share) * _unit(body[:, elbow] - origin) + share * _unit(chest @ (pole * outwards))
    bend = _unit(bend - (bend * direction).sum(-1, keepdims=True) * direction)
    # Law of cosines: how far along the line to the wrist the elbow stands, and how far beside it
    along = (upper**2 - fore**2 + distance**2) / (2 * distance)
    beside = np.sqrt(np.clip(upper**2 - along**2, 0.0, None))
    out = body.copy()
    moved = (weight > 0)[:, None]
    out[:, elbow] = np.where(moved, origin + along[:, None] * direction + beside[:, None] * bend, body[:, elbow])
    out[:, wrist] = np.where(moved, origin + distance[:, None] * direction, body[:, wrist])
    return out


def nod(body: FloatArray, weight: DoubleArray, rng: np.random.Generator) -> FloatArray:
    """Let the head nod: it turns about the axis through the ears, 15 to 25 degrees down and back, again and again."""
    neck, head = JOINT_INDEX["neck"], JOINT_INDEX["head"]
    _, chest = trunk_frames(body)
    seconds = np.arange(len(body)) / FPS
    angle = np.radians(rng.uniform(15, 25)) * weight * (1 - np.cos(2 * np.pi * rng.uniform(1.2, 2.2) * seconds)) / 2
    local = np.einsum("tji,tj->ti", chest, (body[:, head] - body[:, neck]).astype(np.float64))
    cos, sin = np.cos(angle), np.sin(angle)
    turned = np.stack([local[:, 0], cos * local[:, 1] - sin * local[:, 2], sin * local[:, 1] + cos * local[:, 2]], -1)
    out = body.copy()
    out[:, head] = body[:, neck] + np.einsum("tij,tj->ti", chest, turned)
    return out


def _unit(vectors: DoubleArray) -> DoubleArray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True).clip(min=1e-9)


def _slerp(start: DoubleArray, end: DoubleArray, weight: DoubleArray) -> DoubleArray:
    """Turn unit vectors (t, 3) into others along the great circle; opposite ones go by the straight line."""
    cosine = np.clip((start * end).sum(-1), -1.0, 1.0)
    angle = np.arccos(cosine)
    near = (angle < 1e-3) | (angle > np.pi - 1e-2)
    sine = np.where(near, 1.0, np.sin(angle))
    first = np.where(near, 1.0 - weight, np.sin((1 - weight) * angle) / sine)
    second = np.where(near, weight, np.sin(weight * angle) / sine)
    return first[:, None] * start + second[:, None] * end


def make_gestures(clips: Sequence[MotionClip], count: int, seed: int) -> list[MotionClip]:
    """Make `count` gestures of 2 to 6 s on bodies that stand.

    Args:
        clips: recordings of people who stand, to be drawn from.
        count: clips to make.
        seed: of all draws.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    labels, made = sorted(MADE), []
    while len(made) < count and clips:
        clip = clips[int(rng.integers(len(clips)))]
        frames = round(rng.uniform(*CLIP_SECONDS) * FPS)
        body = start_at_origin(draw_body([clip.joints], frames, rng))
        if len(body) < MIN_SECONDS * FPS:
            continue
        label = labels[int(rng.integers(len(labels)))]
        captions = tuple(concept_caption(label, "", rng) for _ in range(CAPTIONS))
        made.append(
            MotionClip(
                id=f"made_{len(made):05d}",
                joints=make_gesture(body, label, rng),
                captions=captions,
                actions=(label,),
                style=clip.style,
                any_length=True,
                made_by="gestures",
            )
        )
    return made


def draw_body(bodies: Sequence[FloatArray], frames: int, rng: np.random.Generator) -> FloatArray:
    """Draw a window of some length of a captured body; a shorter recording is used whole."""
    body = bodies[int(rng.integers(len(bodies)))]
    if len(body) <= frames:
        return body
    start = int(rng.integers(len(body) - frames + 1))
    return body[start : start + frames]
