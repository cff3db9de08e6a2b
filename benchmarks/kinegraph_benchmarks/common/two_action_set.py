"""Build the test set of two actions, one after another or at once, from captured clips that no training has seen.

Each item is what a caption of two actions asks for, with each action's own captured clip beside it. Clips are joined
as in training (`kinegraph_training.synthetic.compositions`). Pairs of actions that are held out of training are marked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph_benchmarks.common import predicates as p
from kinegraph_benchmarks.common.behaviour_prompts import ACTIONS, RARE
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.synthetic.caption_grammar import sequence_caption, splice_caption
from kinegraph_training.synthetic.compositions import BLEND, HeldOut, splice, stitch_clips

Kind = Literal["in_order", "together"]

TRAVEL = ("walk", "run", "walk-turn-left", "walk-turn-right")
ONE_HAND = ("raise-up-left-hand", "raise-up-right-hand", "wave-left-hand", "wave-right-hand")
GESTURES = (*ONE_HAND, "raise-up-both-hands", "wave-both-hands")
MAX_FRAMES = 196
STEP = 4
"""Frames between the moments at which one action may give way to the next."""


ALONE: dict[str, p.Predicate] = {behaviour.action: behaviour.holds for behaviour in ACTIONS + RARE}
"""The predicate of an action while nothing else goes on."""
BESIDE = ALONE | {
    "wave-left-hand": p.waves_beside("left"),
    "wave-right-hand": p.waves_beside("right"),
    "wave-both-hands": p.waves_beside("both"),
    "raise-up-left-hand": p.raises_beside("left"),
    "raise-up-right-hand": p.raises_beside("right"),
    "raise-up-both-hands": p.raises_beside("both"),
}
"""The predicate of an action beside another one, which may use the other hand and the legs."""


@dataclass(frozen=True)
class TwoActionClip:
    """Two captured actions joined into one motion."""

    kind: Kind
    actions: tuple[str, str]
    """Labels."""
    style: str
    caption: str
    texts: tuple[str, str]
    """A caption of each action alone."""
    parts: tuple[FloatArray, FloatArray]
    """Joints (frames, 22, 3) of the captured clip of each action."""
    joints: FloatArray
    """(frames, 22, 3) of the joined motion."""
    held_out: bool
    """Whether training never joins these two actions."""

    @property
    def cut(self) -> int:
        """Frame at which the second action begins ("in_order")."""
        return len(self.parts[0]) - BLEND // 2

    def crops(self, joints: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Cut a motion of the same length into the part of each action; actions at once share the whole motion."""
        return (joints[: self.cut], joints[self.cut :]) if self.kind == "in_order" else (joints, joints)

    def holds(self, joints: FloatArray) -> bool:
        """Tell whether both actions happen in a motion, and in their order."""
        first, second = self.actions
        if self.kind == "together":
            return BESIDE[first](joints) and BESIDE[second](joints)
        return happen_in_order(joints, ALONE[first], ALONE[second])


def happen_in_order(joints: FloatArray, first: p.Predicate, second: p.Predicate) -> bool:
    """Tell whether at some moment the first action has been done and the second, not done so far, is done after it."""
    moments = range(2 * STEP, len(joints) - 2 * STEP, STEP)
    return any(first(joints[:moment]) and second(joints[moment:]) and not second(joints[:moment]) for moment in moments)


def distinguishable_pairs(kind: Kind) -> list[tuple[str, str]]:
    """List the pairs of actions that can be told apart in one motion."""
    sides = [(a, b) for a in ONE_HAND for b in ONE_HAND if ("left" in a) != ("left" in b)]
    if kind == "together":
        return [(travel, gesture) for travel in TRAVEL for gesture in GESTURES] + sides
    mixed = [(travel, gesture) for travel in TRAVEL for gesture in (*GESTURES, "bow")]
    return mixed + [(gesture, travel) for travel, gesture in mixed] + sides


def build_two_action_set(
    clips: Sequence[MotionClip], held_out: HeldOut, kind: Kind, seed: int = 0
) -> list[TwoActionClip]:
    """Join one motion for every pair and style that has clips of both, where it fits into `MAX_FRAMES`.

    Args:
        clips: captured clips to draw from.
        held_out: pairs of actions that training never joins.
        kind: one after another, or at once.
        seed: draws clips and captions.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    by_label: dict[tuple[str, str], list[MotionClip]] = {}
    for clip in clips:
        by_label.setdefault((clip.style, clip.action), []).append(clip)
    items = []
    for style in sorted({clip.style for clip in clips}):
        for actions in distinguishable_pairs(kind):
            candidates = [by_label[style, action] for action in actions if (style, action) in by_label]
            if len(candidates) == 2:
                first, second = (options[int(rng.integers(len(options)))] for options in candidates)
                item = join_clips(kind, first, second, held_out, rng)
                items += [item] if item is not None else []
    return items


def join_clips(
    kind: Kind, first: MotionClip, second: MotionClip, held_out: HeldOut, rng: np.random.Generator
) -> TwoActionClip | None:
    """Join two clips into one; None if that would be longer than `MAX_FRAMES`."""
    actions = (first.action, second.action)
    if kind == "together":
        joints, captions = splice(first.joints, second, rng), splice_caption(actions, first.style, rng)
        never_joined = frozenset(actions) in held_out.together
    else:
        joints, captions = stitch_clips(first.joints, second.joints), sequence_caption(*actions, first.style, rng)
        never_joined = actions in held_out.in_order
    if len(joints) > MAX_FRAMES:
        return None
    caption = captions[int(rng.integers(len(captions)))]
    texts = (first.captions[0], second.captions[0])
    return TwoActionClip(
        kind, actions, first.style, caption, texts, (first.joints, second.joints), joints, never_joined
    )
