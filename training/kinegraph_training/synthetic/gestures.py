"""Made gestures: arms posed by inverse kinematics on captured bodies, where no free recording holds the gesture.

A gesture is a path of the wrists in the frame of the chest, entered from the pose that the body has, held or repeated,
and left again. Waving and clapping are oscillations of that path; nodding is one of the head. A bow bends the trunk
over the hips, which go back while the feet stay; of sitting see `sitting`. The rest is a recording of somebody who
stands or walks.
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
from kinegraph_training.synthetic.posing import TRUNK, pose_arm, shift_hips, smoothstep, turn_about, unit
from kinegraph_training.synthetic.sitting import SITTING, sit

ENTER_SECONDS: Final = (0.4, 0.8)
"""Range of the time that a hand takes to its place, and back."""
BOW_SECONDS: Final = (0.6, 1.2)
"""Range of the time that a bow takes down, and up."""
BOW_DEGREES: Final = (30.0, 65.0)
BOW_JOINTS: Final = {"hips": 0.5, "spine1": 0.25, "spine2": 0.25}
"""Shares of a bow that are bent at each place."""
BOW_BACK: Final = 0.12
"""Metres that the hips go back, times the sine of the bow: so the weight stays over the feet."""
ARMS_HANG: Final = 0.6
"""Share of a bow that the arms do not follow, as they hang."""
HOLD_SECONDS: Final = (0.8, 3.5)
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
    "bow": ("bow", ()),
    **dict.fromkeys(SITTING, ("sit", ())),
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
    if name == "sit":
        return sit(body, label, rng)
    if name == "bow":
        return bow(body, gesture_weight(len(body), rng, BOW_SECONDS), rng)
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


def gesture_weight(frames: int, rng: np.random.Generator, seconds: tuple[float, float] = ENTER_SECONDS) -> DoubleArray:
    """Draw how much of a gesture is there at each frame (frames,): it comes, stays and usually goes."""
    enter, leave = (max(4, round(rng.uniform(*seconds) * FPS)) for _ in range(2))
    longest = max(1, frames - enter)
    hold = min(longest, round(rng.uniform(*HOLD_SECONDS) * FPS))
    if rng.random() < STAYS:
        hold = longest
    start = int(rng.integers(0, max(1, frames - enter - hold - leave)))
    index = np.arange(frames)
    rise, fall = (index - start) / enter, (start + enter + hold + leave - index) / leave
    return smoothstep(np.minimum(np.clip(rise, 0, 1), np.clip(fall, 0, 1)))


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


def bow(body: FloatArray, weight: DoubleArray, rng: np.random.Generator) -> FloatArray:
    """Let the body bow: the trunk bends forward over the hips, which go back; ankles and feet stay.

    Args:
        body: (frames, 22, 3).
        weight: (frames,) 0 leaves the body as it is, 1 is the whole bow.
        rng: draws how deep it is, by `BOW_DEGREES`.
    """
    angle = np.radians(rng.uniform(*BOW_DEGREES)) * weight
    hips = [JOINT_INDEX["left_hip"], JOINT_INDEX["right_hip"]]
    axis = unit((body[:, hips[0]] - body[:, hips[1]]).astype(np.float64))  # through both, so that they keep their bones
    left = unit(axis * [1, 0, 1])
    forward = np.cross(left, [0.0, 1.0, 0.0])
    out = shift_hips(body.astype(np.float64), -BOW_BACK * np.sin(angle)[:, None] * forward)
    for place, share in BOW_JOINTS.items():
        pivot = out[:, hips].mean(1) if place == "hips" else out[:, JOINT_INDEX[place]].copy()
        above = [JOINT_INDEX["pelvis"], *TRUNK] if place == "hips" else TRUNK[TRUNK.index(JOINT_INDEX[place]) + 1 :]
        out[:, above] = turn_about(out[:, above], pivot, axis if place == "hips" else left, share * angle)
    for side in ("left", "right"):
        shoulder, *arm = (JOINT_INDEX[f"{side}_{name}"] for name in ("shoulder", "elbow", "wrist"))
        out[:, arm] = turn_about(out[:, arm], out[:, shoulder], left, -ARMS_HANG * angle)
    return np.where((weight > 0)[:, None, None], out, body).astype(body.dtype)


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
