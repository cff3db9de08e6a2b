"""Synthetic compositions: body splices ("walks while waving") and sequences ("walks, then bows").

No captured clip shows two actions, so nothing else teaches the models that actions can coexist. Pairs listed as held
out, and their mirror images, are never composed, so that composition can be measured on pairs the models have not seen.
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
    """Pairs of action labels that must not be composed in training, mirror images included."""

    together: frozenset[frozenset[str]]
    """Pairs that must not happen at once."""
    in_order: frozenset[tuple[str, str]]
    """Pairs (first, second) that must not follow each other."""

    @staticmethod
    def read(path: Path) -> HeldOut:
        """Read a JSON file with the lists "together" and "in_order", and add the mirror images.

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


def arms_of(action: str) -> tuple[int, ...]:
    """Return the joints that a gesture moves: one arm if its label names a side, else both."""
    if "left" in action:
        return LEFT_ARM
    if "right" in action:
        return RIGHT_ARM
    return LEFT_ARM + RIGHT_ARM


def resample_linear(joints: FloatArray, frames: int) -> FloatArray:
    """Resample (t, 22, 3) to (frames, 22, 3) by linear interpolation; first and last frame stay."""
    position = np.linspace(0, len(joints) - 1, frames)
    low = np.minimum(position.astype(int), len(joints) - 2)
    fraction = (position - low)[:, None, None].astype(np.float32)
    return joints[low] * (1 - fraction) + joints[low + 1] * fraction


def chest_heading(joints: FloatArray) -> FloatArray:
    """Compute the heading (t,) of the chest about +Y from the line between the collars, whatever the arms do."""
    across = joints[:, RIGHT_ARM[0]] - joints[:, LEFT_ARM[0]]
    return np.unwrap(np.arctan2(across[:, 2], -across[:, 0])).astype(np.float32)


def rotate_about_y(vectors: FloatArray, angle: FloatArray) -> FloatArray:
    """Rotate vectors (t, n, 3) by +angle (t,) about Y."""
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, z = vectors[..., 0], vectors[..., 2]
    return np.stack([cos * x + sin * z, vectors[..., 1], cos * z - sin * x], axis=-1)


def splice(carrier: MotionClip, gesture: MotionClip, rng: np.random.Generator) -> FloatArray:
    """Combine legs, root and trunk of the carrier with the arms of the gesture, which turn with the chest.

    A longer gesture is sped up to the carrier's length. A shorter one is stretched by 1.0 to 1.3 and placed at random
    inside the carrier, faded in and out over `BLEND` frames.

    Returns:
        (frames of the carrier, 22, 3) with the carrier's bone lengths.
    """
    frames = len(carrier.joints)
    length = min(frames, int(len(gesture.joints) * rng.uniform(1.0, 1.3)))
    start = int(rng.integers(0, frames - length + 1))
    source = resample_linear(gesture.joints, length)
    arms = list(arms_of(gesture.action))
    relative = rotate_about_y(source[:, arms] - source[:, CHEST : CHEST + 1], -chest_heading(source))
    out = carrier.joints.copy()
    span = out[start : start + length]
    moved = rotate_about_y(relative, chest_heading(span)) + span[:, CHEST : CHEST + 1]
    weight = np.ones(length, dtype=np.float32)
    ramp = (np.arange(1, BLEND + 1) / (BLEND + 1)).astype(np.float32)[: length // 2]
    if start > 0:
        weight[: len(ramp)] = ramp
    if start + length < frames:
        weight[-len(ramp) :] = ramp[::-1]
    span[:, arms] += weight[:, None, None] * (moved - span[:, arms])
    return enforce_bone_lengths(out, bone_lengths(carrier.joints).mean(axis=0))


def stitch_clips(first: FloatArray, second: FloatArray) -> FloatArray:
    """Append one motion to another, placed and turned to continue it.

    The two overlap by `BLEND` frames, over which their features are faded into each other.

    Args:
        first: (t1, 22, 3) metres.
        second: (t2, 22, 3) metres.

    Returns:
        (t1 + t2 - BLEND, 22, 3) with the bone lengths of `first`.
    """
    a, b = features_from_joints(first), features_from_joints(second)
    weight = ((np.arange(BLEND) + 1) / (BLEND + 1)).astype(np.float32)[:, None]
    blend = a[-BLEND:] * (1 - weight) + b[:BLEND] * weight
    rows = np.concatenate([a[:-BLEND], blend, b[BLEND:]])
    joints = joints_from_features(rows, heading=float(facing_angle(first)[0]))
    return enforce_bone_lengths(joints, bone_lengths(first).mean(axis=0))


def can_splice(carrier: MotionClip, gesture: MotionClip, held_out: HeldOut) -> bool:
    """Tell whether two clips use different limbs, have fitting lengths, and are no held-out pair."""
    if gesture.action in LOCOMOTION:
        return False
    both_gestures = carrier.action not in LOCOMOTION
    if both_gestures and set(arms_of(carrier.action)) & set(arms_of(gesture.action)):
        return False
    if frozenset((carrier.action, gesture.action)) in held_out.together:
        return False
    return len(gesture.joints) <= MAX_SQUEEZE * len(carrier.joints)


def select_spliceable(clips: Iterable[MotionClip]) -> list[MotionClip]:
    """Select the clips of actions that move arms or legs alone."""
    return [clip for clip in clips if clip.action in PHRASES and PHRASES[clip.action].arms_or_legs]


def draw_pair(clips: list[MotionClip], rng: np.random.Generator) -> tuple[MotionClip, MotionClip]:
    """Draw two clips of different actions in one style.

    Styles are drawn by the square root of their number of clips, actions evenly, so that rare ones appear.
    """
    by_style: dict[str, dict[str, list[MotionClip]]] = {}
    for clip in clips:
        by_style.setdefault(clip.style, {}).setdefault(clip.action, []).append(clip)
    styles = sorted(style for style, actions in by_style.items() if len(actions) > 1)
    weights = np.array([sum(map(len, by_style[style].values())) for style in styles], dtype=float) ** 0.5
    style = styles[int(rng.choice(len(styles), p=weights / weights.sum()))]
    actions = sorted(by_style[style])
    first, second = rng.choice(len(actions), size=2, replace=False)
    groups = (by_style[style][actions[first]], by_style[style][actions[second]])
    return groups[0][rng.integers(len(groups[0]))], groups[1][rng.integers(len(groups[1]))]


def make_splices(clips: list[MotionClip], count: int, held_out: HeldOut, seed: int) -> list[MotionClip]:
    """Make `count` clips of two actions at once, with captions of both."""
    rng = np.random.Generator(np.random.PCG64(seed))
    usable = select_spliceable(clips)
    splices: list[MotionClip] = []
    while len(splices) < count and usable:
        carrier, gesture = draw_pair(usable, rng)
        if not can_splice(carrier, gesture, held_out):
            continue
        splices.append(
            MotionClip(
                id=f"splice_{len(splices):05d}",
                joints=splice(carrier, gesture, rng),
                captions=splice_caption(carrier.action, gesture.action, carrier.style, rng),
                actions=(carrier.action, gesture.action),
                style=carrier.style,
            )
        )
    return splices


def make_sequences(
    clips: list[MotionClip], count: int, held_out: HeldOut, seed: int, max_frames: int
) -> list[MotionClip]:
    """Make `count` clips of two actions in order, of at most `max_frames`."""
    rng = np.random.Generator(np.random.PCG64(seed))
    usable = [clip for clip in clips if clip.action in PHRASES and 2 * BLEND <= len(clip.joints) <= max_frames - 30]
    sequences: list[MotionClip] = []
    while len(sequences) < count and usable:
        first, second = draw_pair(usable, rng)
        if (first.action, second.action) in held_out.in_order:
            continue
        if len(first.joints) + len(second.joints) - BLEND > max_frames:
            continue
        sequences.append(
            MotionClip(
                id=f"sequence_{len(sequences):05d}",
                joints=stitch_clips(first.joints, second.joints),
                captions=sequence_caption(first.action, second.action, first.style, rng),
                actions=(first.action, second.action),
                style=first.style,
                in_order=True,
            )
        )
    return sequences
