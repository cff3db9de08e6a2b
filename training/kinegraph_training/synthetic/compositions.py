"""Synthetic compositions: body splices ("walks while waving") and sequences ("walks, then bows").

Few captured clips show two actions, so nothing else teaches the models that actions can coexist. A splice takes legs
and trunk of one clip and one or both arms of others; made gestures (`gestures`) are placed on it as well. Pairs listed
as held out, and their mirror images, are never composed, so that composition can be measured on pairs the models have
not seen.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.errors import InvalidInputError
from kinegraph.motion.body_parts import ARMS, CHEST, chest_heading, rotate_about_y
from kinegraph.motion.features import features_from_joints, joints_from_features
from kinegraph.motion.postprocess import enforce_bone_lengths
from kinegraph.motion.skeleton import JOINT_INDEX, bone_lengths, facing_angle, start_at_origin
from kinegraph_training.data.clips import MotionClip, mirrored_label
from kinegraph_training.metrics import FPS
from kinegraph_training.synthetic.caption_grammar import (
    LOCOMOTION,
    PHRASES,
    partial_captions,
    sequence_caption,
    splice_caption,
)
from kinegraph_training.synthetic.gestures import MADE, make_gesture

LEFT_ARM, RIGHT_ARM = ARMS["left arm"], ARMS["right arm"]
BLEND = 8
"""Frames (0.4 s) over which two motions are faded into each other."""
MAX_SQUEEZE = 1.6
"""A gesture is played at most this much faster to fit its carrier."""
MADE_GESTURES = 0.3
"""Share of the gestures of splices that are made instead of recorded."""
CARRIERS = LOCOMOTION | {"stand-still", "stand-idle", "walk-turn-left", "walk-turn-right", "turn-left", "turn-right"}
"""Actions whose arms only swing along."""
SAME = {"byebye": "bye"}
"""Labels of two data sets for one action, when held-out pairs are looked up."""
SEQUENCE_SECONDS = (3.0, 9.8)
"""Range of the length of a sequence, drawn by its logarithm."""
PART_SECONDS = (1.2, 5.0)
"""Range of the length of one part of it, if any part of its action will do."""
NORMAL = "normal"
FEET = (JOINT_INDEX["left_foot"], JOINT_INDEX["right_foot"])
MAX_SLIDE = 0.25
"""Metres that the lower foot may slide further in a join than around it."""
MAX_DRAWS = 200
"""Draws at most for each clip that is to be made: in small data few may fit."""
CIRCLE_DEGREES = 270.0
"""A shorter part of a circle is no circle."""
MAX_POSE_GAP = 0.3
"""Metres, mean over joints in the body's frame: poses further apart are not joined."""


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
    entry = PHRASES.get(action)
    if entry is None or entry.parts != "arm":
        return LEFT_ARM + RIGHT_ARM
    return LEFT_ARM if entry.side == "left" else RIGHT_ARM


def resample_linear(joints: FloatArray, frames: int) -> FloatArray:
    """Resample (t, 22, 3) to (frames, 22, 3) by linear interpolation; first and last frame stay."""
    position = np.linspace(0, len(joints) - 1, frames)
    low = np.minimum(position.astype(int), len(joints) - 2)
    fraction = (position - low)[:, None, None].astype(np.float32)
    return joints[low] * (1 - fraction) + joints[low + 1] * fraction


def splice(carrier: FloatArray, gesture: MotionClip, rng: np.random.Generator) -> FloatArray:
    """Combine legs, root and trunk of the carrier with the arms of the gesture, which turn with the chest.

    A longer gesture is sped up to the carrier's length. A shorter one is stretched by 1.0 to 1.3 and placed at random
    inside the carrier, faded in and out over `BLEND` frames.

    Returns:
        (frames of the carrier, 22, 3) with the carrier's bone lengths.
    """
    frames = len(carrier)
    length = min(frames, int(len(gesture.joints) * rng.uniform(1.0, 1.3)))
    start = int(rng.integers(0, frames - length + 1))
    source = resample_linear(gesture.joints, length)
    arms = list(arms_of(gesture.action))
    relative = rotate_about_y(source[:, arms] - source[:, CHEST : CHEST + 1], -chest_heading(source))
    out = carrier.copy()
    span = out[start : start + length]
    moved = rotate_about_y(relative, chest_heading(span)) + span[:, CHEST : CHEST + 1]
    weight = np.ones(length, dtype=np.float32)
    ramp = (np.arange(1, BLEND + 1) / (BLEND + 1)).astype(np.float32)[: length // 2]
    if start > 0:
        weight[: len(ramp)] = ramp
    if start + length < frames:
        weight[-len(ramp) :] = ramp[::-1]
    span[:, arms] += weight[:, None, None] * (moved - span[:, arms])
    return enforce_bone_lengths(out, bone_lengths(carrier).mean(axis=0))


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


def can_splice(carrier: str, gestures: Sequence[str], held_out: HeldOut) -> bool:
    """Tell whether actions use different limbs, the carrier only legs and trunk, and no two are a held-out pair."""
    arms = [set(arms_of(gesture)) for gesture in gestures]
    if any(PHRASES[gesture].parts not in ("arm", "arms") for gesture in gestures):
        return False
    if len(arms) == 2 and arms[0] & arms[1]:
        return False
    # A gesture of one arm may carry one of the other.
    one_arm = PHRASES[carrier].parts == "arm" and not any(set(arms_of(carrier)) & other for other in arms)
    if carrier not in CARRIERS and not one_arm:
        return False
    everything = with_both_hands((carrier, *gestures))
    pairs = (frozenset((a, b)) for index, a in enumerate(everything) for b in everything[:index])
    return not any(pair in held_out.together for pair in pairs)


def with_both_hands(labels: Sequence[str]) -> list[str]:
    """Name what labels are when held-out pairs are looked up: a raised left and a raised right hand are both hands."""
    names = [SAME.get(label, label) for label in labels]
    lefts = [label.removesuffix("left-hand") for label in names if label.endswith("-left-hand")]
    return names + [f"{stem}both-hands" for stem in lefts if f"{stem}right-hand" in names]


def draws(made: Sequence[MotionClip], count: int) -> Iterator[None]:
    """Repeat until `count` clips are made, or `MAX_DRAWS` draws for each are over."""
    for _ in range(MAX_DRAWS * count):
        if len(made) == count:
            return
        yield


def by_style_and_action(clips: Iterable[MotionClip]) -> dict[str, dict[str, list[MotionClip]]]:
    """Group clips by style, then by action; clips without a style are normal ones."""
    groups: dict[str, dict[str, list[MotionClip]]] = {}
    for clip in clips:
        groups.setdefault(clip.style or NORMAL, {}).setdefault(clip.action, []).append(clip)
    return groups


def draw_style(groups: dict[str, dict[str, list[MotionClip]]], rng: np.random.Generator) -> str:
    """Draw a style of at least two actions by the square root of its number of clips."""
    styles = sorted(style for style, actions in groups.items() if len(actions) > 1)
    if not styles:
        raise InvalidInputError(
            "no style of the data has two actions to be composed; set splices, triples and sequences to 0 in [data]"
        )
    weights = np.array([sum(map(len, groups[style].values())) for style in styles], dtype=float) ** 0.5
    return styles[int(rng.choice(len(styles), p=weights / weights.sum()))]


def draw_of(groups: dict[str, list[MotionClip]], rng: np.random.Generator) -> MotionClip:
    """Draw an action by the square root of its number of clips, and one of its clips.

    Rare ones appear, and those that people combine most are seen with many partners: drawn evenly among 64 gestures,
    each side of raising a hand would be in one splice of a hundred.
    """
    actions = sorted(groups)
    weights = np.array([len(groups[action]) for action in actions], dtype=float) ** 0.5
    group = groups[actions[int(rng.choice(len(actions), p=weights / weights.sum()))]]
    return group[int(rng.integers(len(group)))]


def make_splices(
    clips: list[MotionClip], count: int, held_out: HeldOut, seed: int, *, actions: int = 2
) -> list[MotionClip]:
    """Make `count` clips of two or three actions at once, with captions of all of them and of parts.

    Args:
        clips: to make them of; both sides of each gesture should be among them.
        count: clips to make.
        held_out: pairs that must not be made.
        seed: of all draws.
        actions: 2, or 3: legs, left arm and right arm.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    known = [clip for clip in clips if clip.action in PHRASES]
    carriers = by_style_and_action(
        clip
        for clip in known
        if (clip.action in CARRIERS or PHRASES[clip.action].parts == "arm") and len(clip.joints) > 30
    )
    gestures = by_style_and_action(clip for clip in known if PHRASES[clip.action].parts in ("arm", "arms"))
    splices: list[MotionClip] = []
    for _ in draws(splices, count if carriers and gestures else 0):
        style = draw_style(carriers, rng)
        carrier = draw_of(carriers[style], rng)
        if carrier.action not in CARRIERS and (actions == 3 or rng.random() < 0.7):
            continue
        drawn = [draw_gesture(gestures, style, rng) for _ in range(actions - 1)]
        labels = [gesture if isinstance(gesture, str) else gesture.action for gesture in drawn]
        if not can_splice(carrier.action, labels, held_out) or not is_recorded(labels, style, gestures):
            continue
        joints = carrier.joints
        for gesture in drawn:
            made = isinstance(gesture, str)
            if not made and len(gesture.joints) > MAX_SQUEEZE * len(joints):
                break
            joints = make_gesture(joints, gesture, rng) if made else splice(joints, gesture, rng)
        else:
            together = (carrier.action, *labels)
            # Whoever waves is not motionless.
            told = tuple("stand-idle" if label == "stand-still" else label for label in together)
            splices.append(
                MotionClip(
                    id=f"splice{actions}_{len(splices):05d}",
                    joints=joints,
                    captions=splice_caption(told, style, rng),
                    partial_captions=partial_captions(told, style, rng),
                    actions=together,
                    style=style,
                    made_by=f"splices_{actions}",
                )
            )
    return splices


def is_recorded(labels: Sequence[str], style: str, gestures: Mapping[str, Mapping[str, Sequence[MotionClip]]]) -> bool:
    """Tell whether what two hands make together is recorded in a manner: gestures may be held out in it."""
    both = with_both_hands(labels)[len(labels) :]
    return style == NORMAL or all(label in gestures.get(style, ()) for label in both)


def draw_gesture(
    gestures: dict[str, dict[str, list[MotionClip]]], style: str, rng: np.random.Generator
) -> MotionClip | str:
    """Draw a recorded gesture, in the carrier's style where there is one, or the label of a made one.

    In a manner, only gestures are made that recordings have in it: others may be held out, and its captions say so.
    """
    if rng.random() < MADE_GESTURES:
        labels = sorted(label for label in MADE if MADE[label][1])
        if style != NORMAL:
            labels = [label for label in labels if label in gestures.get(style, {})]
        if labels:
            return labels[int(rng.integers(len(labels)))]
    other = NORMAL if NORMAL in gestures else sorted(gestures)[0]
    return draw_of(gestures[style if style in gestures else other], rng)


def make_sequences(
    clips: list[MotionClip], count: int, held_out: HeldOut, seed: int, max_frames: int
) -> list[MotionClip]:
    """Make `count` clips of two actions in order, most of 3 to 6 s: of steady actions a part is taken."""
    rng = np.random.Generator(np.random.PCG64(seed))
    groups = by_style_and_action(clip for clip in clips if clip.action in PHRASES and len(clip.joints) >= 2 * BLEND)
    sequences: list[MotionClip] = []
    for _ in draws(sequences, count if groups else 0):
        style = draw_style(groups, rng)
        first, second = (draw_of(groups[style], rng) for _ in range(2))
        if first.action == second.action or (first.action, second.action) in held_out.in_order:
            continue
        low, high = np.log(np.array(SEQUENCE_SECONDS) * FPS)
        longest = min(max_frames, round(float(np.exp(rng.uniform(low, high)))))
        parts = [part_of(clip, rng) for clip in (first, second)]
        if sum(map(len, parts)) - BLEND > longest or pose_gap(parts[0][-1], parts[1][0]) > MAX_POSE_GAP:
            continue
        joints = stitch_clips(*parts)
        if slide_of_join(joints, len(parts[0])) > MAX_SLIDE:
            continue
        sequences.append(
            MotionClip(
                id=f"sequence_{len(sequences):05d}",
                joints=joints,
                captions=sequence_caption(first.action, second.action, style, rng),
                actions=(first.action, second.action),
                style=style,
                in_order=True,
                made_by="sequences",
            )
        )
    return sequences


def part_of(clip: MotionClip, rng: np.random.Generator) -> FloatArray:
    """Take a part of a clip of a steady action, and the whole of any other."""
    if not PHRASES[clip.action].steady:
        return clip.joints
    low, high = np.log(np.array(PART_SECONDS) * FPS)
    frames = min(len(clip.joints), round(float(np.exp(rng.uniform(low, high)))))
    start = int(rng.integers(len(clip.joints) - frames + 1))
    part = clip.joints[start : start + frames]
    return start_at_origin(part if goes_round(clip.action, part) else clip.joints)


def goes_round(action: str, joints: FloatArray) -> bool:
    """Tell whether a part of a circle turns by `CIRCLE_DEGREES`; parts of other actions are what they are."""
    heading = np.unwrap(facing_angle(joints))
    return "circle" not in action or bool(abs(np.degrees(heading[-1] - heading[0])) >= CIRCLE_DEGREES)


def slide_of_join(joints: FloatArray, end: int) -> float:
    """Compute how much further the lower foot slides where two motions are joined than around it, in metres.

    Args:
        joints: (t, 22, 3) of `stitch_clips`.
        end: frames of the first motion.
    """
    feet = joints[:, list(FEET)]
    low = np.argmin(np.minimum(feet[:-1, :, 1], feet[1:, :, 1]), axis=1)
    steps = np.linalg.norm(np.diff(feet[..., [0, 2]], axis=0), axis=-1)[np.arange(len(low)), low]
    before, join, after = (
        steps[max(first, 0) : first + BLEND].sum() for first in range(end - 2 * BLEND, end + 1, BLEND)
    )
    return float(join - max(before, after))


def pose_gap(first: FloatArray, second: FloatArray) -> float:
    """Compute the mean distance in metres of the joints (22, 3) of two poses, both turned to face +Z."""
    gap = start_at_origin(first[None]) - start_at_origin(second[None])
    return float(np.linalg.norm(gap, axis=-1).mean())
