"""Made compositions: body splices ("walks while waving") and sequences ("walks, then bows").

No recorded clip holds two actions, so nothing else teaches the models that actions can coexist. Pairs listed as held
out (and their mirror images) are never made, so that composition can be measured on pairs the models have not seen.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.errors import InvalidInputError
from kinegraph.motion.features import features_from_joints, joints_from_features
from kinegraph.motion.postprocess import enforce_bone_lengths
from kinegraph.motion.skeleton import JOINT_INDEX, bone_lengths, facing_angle
from kinegraph_training.data.clips import MotionClip, mirrored_label
from kinegraph_training.synthetic.caption_grammar import LOCOMOTION, PHRASES, sequence_caption, splice_caption

LEFT_ARM = tuple(JOINT_INDEX[f"left_{name}"] for name in ("collar", "shoulder", "elbow", "wrist"))
RIGHT_ARM = tuple(JOINT_INDEX[f"right_{name}"] for name in ("collar", "shoulder", "elbow", "wrist"))
CHEST = JOINT_INDEX["spine3"]
BLEND = 8
"""Frames (0.4 s) over which two motions are faded into each other."""
MAX_SQUEEZE = 1.6
"""A gesture is played at most this much faster to fit its carrier."""


@dataclass(frozen=True)
class HeldOut:
    """Pairs of contents that must not be composed in training, mirror images included."""

    together: frozenset[frozenset[str]]
    in_order: frozenset[tuple[str, str]]

    @staticmethod
    def read(path: Path) -> HeldOut:
        """From a JSON file with the lists "together" and "in_order".

        Raises:
            InvalidInputError: it cannot be read, or is no such file.
        """
        try:
            raw = json.loads(path.read_text(encoding="utf-8"))
            together = [(str(a), str(b)) for a, b in raw["together"]]
            ordered = [(str(a), str(b)) for a, b in raw["in_order"]]
        except OSError as error:
            raise InvalidInputError(
                f"{path} cannot be read ({error.strerror}); name the file of held-out pairs"
            ) from error
        except (ValueError, KeyError, TypeError) as error:
            wanted = 'an object with "together" and "in_order", each a list of pairs of labels'
            raise InvalidInputError(f"{path} must be {wanted}: {error!r}") from error
        together += [(mirrored_label(a), mirrored_label(b)) for a, b in together]
        ordered += [(mirrored_label(a), mirrored_label(b)) for a, b in ordered]
        return HeldOut(frozenset(frozenset(pair) for pair in together), frozenset(ordered))


def arms_of(content: str) -> tuple[int, ...]:
    """Joints a gesture moves: one arm if its label names a side, else both."""
    if "left" in content:
        return LEFT_ARM
    if "right" in content:
        return RIGHT_ARM
    return LEFT_ARM + RIGHT_ARM


def resampled(joints: FloatArray, frames: int) -> FloatArray:
    """Linear in time, end to end: (t, 22, 3) -> (frames, 22, 3)."""
    position = np.linspace(0, len(joints) - 1, frames)
    low = np.minimum(position.astype(int), len(joints) - 2)
    part = (position - low)[:, None, None].astype(np.float32)
    return joints[low] * (1 - part) + joints[low + 1] * part


def chest_heading(joints: FloatArray) -> FloatArray:
    """Direction across the shoulders' roots about +Y; collars move little, arms do not matter."""
    across = joints[:, RIGHT_ARM[0]] - joints[:, LEFT_ARM[0]]
    return np.unwrap(np.arctan2(across[:, 2], -across[:, 0])).astype(np.float32)


def rotated_y(vectors: FloatArray, angle: FloatArray) -> FloatArray:
    """(t, n, 3) vectors turned by +angle (t,) about Y."""
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, z = vectors[..., 0], vectors[..., 2]
    return np.stack([cos * x + sin * z, vectors[..., 1], cos * z - sin * x], axis=-1)


def splice(carrier: MotionClip, gesture: MotionClip, rng: np.random.Generator) -> FloatArray:
    """Legs, root and trunk of one clip with the arms of another, which turn with the chest.

    A gesture that is longer is squeezed to the carrier's length; a shorter one is stretched by at most 1.3 and placed
    inside, faded in and out over `BLEND` frames.
    """
    frames = len(carrier.joints)
    length = min(frames, int(len(gesture.joints) * rng.uniform(1.0, 1.3)))
    start = int(rng.integers(0, frames - length + 1))
    source = resampled(gesture.joints, length)
    arms = list(arms_of(gesture.content))
    relative = rotated_y(source[:, arms] - source[:, CHEST : CHEST + 1], -chest_heading(source))
    out = carrier.joints.copy()
    place = out[start : start + length]
    moved = rotated_y(relative, chest_heading(place)) + place[:, CHEST : CHEST + 1]
    weight = np.ones(length, dtype=np.float32)
    ramp = (np.arange(1, BLEND + 1) / (BLEND + 1)).astype(np.float32)[: length // 2]
    if start > 0:
        weight[: len(ramp)] = ramp
    if start + length < frames:
        weight[-len(ramp) :] = ramp[::-1]
    place[:, arms] += weight[:, None, None] * (moved - place[:, arms])
    return enforce_bone_lengths(out, bone_lengths(carrier.joints).mean(axis=0))


def stitch_clips(first: FloatArray, second: FloatArray) -> FloatArray:
    """`second` after `first`, placed and turned to continue it, faded in feature space over `BLEND` frames."""
    a, b = features_from_joints(first), features_from_joints(second)
    part = ((np.arange(BLEND) + 1) / (BLEND + 1)).astype(np.float32)[:, None]
    blend = a[-BLEND:] * (1 - part) + b[:BLEND] * part
    rows = np.concatenate([a[:-BLEND], blend, b[BLEND:]])
    joints = joints_from_features(rows, heading=float(facing_angle(first)[0]))
    return enforce_bone_lengths(joints, bone_lengths(first).mean(axis=0))


def may_be_together(carrier: MotionClip, gesture: MotionClip, held_out: HeldOut) -> bool:
    """Whether the gesture leaves the carrier its own limbs, fits its length, and the pair is not held out."""
    if gesture.content in LOCOMOTION:
        return False
    both_gestures = carrier.content not in LOCOMOTION
    if both_gestures and set(arms_of(carrier.content)) & set(arms_of(gesture.content)):
        return False
    if frozenset((carrier.content, gesture.content)) in held_out.together:
        return False
    return len(gesture.joints) <= MAX_SQUEEZE * len(carrier.joints)


def spliceable(clips: Iterable[MotionClip]) -> list[MotionClip]:
    """Clips of actions of the arms or of the legs."""
    return [clip for clip in clips if clip.content in PHRASES and PHRASES[clip.content].arms_or_legs]


def drawn_pair(clips: list[MotionClip], rng: np.random.Generator) -> tuple[MotionClip, MotionClip]:
    """Two clips of one style, contents drawn evenly so that rare ones are not drowned."""
    by_style: dict[str, dict[str, list[MotionClip]]] = {}
    for clip in clips:
        by_style.setdefault(clip.style, {}).setdefault(clip.content, []).append(clip)
    styles = sorted(style for style, contents in by_style.items() if len(contents) > 1)
    weights = np.array([sum(map(len, by_style[style].values())) for style in styles], dtype=float) ** 0.5
    style = styles[int(rng.choice(len(styles), p=weights / weights.sum()))]
    contents = sorted(by_style[style])
    first, second = rng.choice(len(contents), size=2, replace=False)
    groups = (by_style[style][contents[first]], by_style[style][contents[second]])
    return groups[0][rng.integers(len(groups[0]))], groups[1][rng.integers(len(groups[1]))]


def make_splices(clips: list[MotionClip], count: int, held_out: HeldOut, seed: int) -> list[MotionClip]:
    """`count` body splices with captions of both actions."""
    rng = np.random.Generator(np.random.PCG64(seed))
    usable = spliceable(clips)
    made: list[MotionClip] = []
    while len(made) < count and usable:
        carrier, gesture = drawn_pair(usable, rng)
        if not may_be_together(carrier, gesture, held_out):
            continue
        made.append(
            MotionClip(
                id=f"splice_{len(made):05d}",
                joints=splice(carrier, gesture, rng),
                captions=splice_caption(carrier.content, gesture.content, carrier.style, rng),
                content=f"{carrier.content}+{gesture.content}",
                style=carrier.style,
            )
        )
    return made


def make_sequences(
    clips: list[MotionClip], count: int, held_out: HeldOut, seed: int, max_frames: int
) -> list[MotionClip]:
    """`count` clips of two actions in order, at most `max_frames` long."""
    rng = np.random.Generator(np.random.PCG64(seed))
    usable = [clip for clip in clips if clip.content in PHRASES and 2 * BLEND <= len(clip.joints) <= max_frames - 30]
    made: list[MotionClip] = []
    while len(made) < count and usable:
        first, second = drawn_pair(usable, rng)
        if (first.content, second.content) in held_out.in_order:
            continue
        if len(first.joints) + len(second.joints) - BLEND > max_frames:
            continue
        made.append(
            MotionClip(
                id=f"sequence_{len(made):05d}",
                joints=stitch_clips(first.joints, second.joints),
                captions=sequence_caption(first.content, second.content, first.style, rng),
                content=f"{first.content}>{second.content}",
                style=first.style,
            )
        )
    return made
