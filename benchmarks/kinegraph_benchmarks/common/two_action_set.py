"""Two actions one after another, or at once, made from captured clips that no training has seen: what a caption of two
actions asks for, with each action's own captured clip beside it.

The same joins and splices as in training (`kinegraph_training.synthetic.compositions`), on other clips. Pairs of
contents that
are held out of training are marked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph_benchmarks.common import predicates as p
from kinegraph_benchmarks.common.behaviour_prompts import CONTENTS, RARE
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


ALONE: dict[str, p.Predicate] = {behaviour.content: behaviour.holds for behaviour in CONTENTS + RARE}
"""The predicate of an action that nothing else goes on beside."""
BESIDE = ALONE | {
    "wave-left-hand": p.swings_high("left"),
    "wave-right-hand": p.swings_high("right"),
    "wave-both-hands": p.swings_high("both"),
    "raise-up-left-hand": lambda joints: p.above_head(joints, "left"),
    "raise-up-right-hand": lambda joints: p.above_head(joints, "right"),
}
"""The predicate of an action beside another one: the other hand and the legs are free."""


@dataclass(frozen=True)
class Composed:
    """Two captured actions in one motion."""

    kind: Kind
    contents: tuple[str, str]
    style: str
    caption: str
    texts: tuple[str, str]
    """A caption of each action alone."""
    parts: tuple[FloatArray, FloatArray]
    """The captured clip of each action."""
    joints: FloatArray
    held_out: bool
    """Whether training never joins these two contents."""

    @property
    def cut(self) -> int:
        """Frame at which the second action begins ("in_order")."""
        return len(self.parts[0]) - BLEND // 2

    def crops(self, joints: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The part of a motion of the same length that each action has."""
        return (joints[: self.cut], joints[self.cut :]) if self.kind == "in_order" else (joints, joints)

    def holds(self, joints: FloatArray) -> bool:
        """Whether both actions happen, and in their order."""
        first, second = self.contents
        if self.kind == "together":
            return BESIDE[first](joints) and BESIDE[second](joints)
        return in_order(joints, ALONE[first], ALONE[second])


def in_order(joints: FloatArray, first: p.Predicate, second: p.Predicate) -> bool:
    """Whether at some moment the first action has been done and the second has not, but is done after it."""
    moments = range(2 * STEP, len(joints) - 2 * STEP, STEP)
    return any(first(joints[:moment]) and second(joints[moment:]) and not second(joints[:moment]) for moment in moments)


def pairs(kind: Kind) -> list[tuple[str, str]]:
    """Contents that can be told apart in one motion."""
    sides = [(a, b) for a in ONE_HAND for b in ONE_HAND if ("left" in a) != ("left" in b)]
    if kind == "together":
        return [(travel, gesture) for travel in TRAVEL for gesture in GESTURES] + sides
    mixed = [(travel, gesture) for travel in TRAVEL for gesture in (*GESTURES, "bow")]
    return mixed + [(gesture, travel) for travel, gesture in mixed] + sides


def composed_set(clips: Sequence[MotionClip], held_out: HeldOut, kind: Kind, seed: int = 0) -> list[Composed]:
    """One motion per pair and style that has clips of both, as far as it fits into `MAX_FRAMES`."""
    rng = np.random.Generator(np.random.PCG64(seed))
    found: dict[tuple[str, str], list[MotionClip]] = {}
    for clip in clips:
        found.setdefault((clip.style, clip.content), []).append(clip)
    made = []
    for style in sorted({clip.style for clip in clips}):
        for first, second in pairs(kind):
            piles = [found[key] for key in ((style, first), (style, second)) if key in found]
            if len(piles) == 2:
                a, b = (pile[int(rng.integers(len(pile)))] for pile in piles)
                one = composed(kind, a, b, held_out, rng)
                made += [one] if one is not None else []
    return made


def composed(
    kind: Kind, first: MotionClip, second: MotionClip, held_out: HeldOut, rng: np.random.Generator
) -> Composed | None:
    """Two clips as one; None where the motion would be too long, or does not show both."""
    contents = (first.content, second.content)
    if kind == "together":
        joints, captions = splice(first, second, rng), splice_caption(*contents, first.style, rng)
        held = frozenset(contents) in held_out.together
    else:
        joints, captions = stitch_clips(first.joints, second.joints), sequence_caption(*contents, first.style, rng)
        held = contents in held_out.in_order
    if len(joints) > MAX_FRAMES:
        return None
    caption = captions[int(rng.integers(len(captions)))]
    texts = (first.captions[0], second.captions[0])
    return Composed(kind, contents, first.style, caption, texts, (first.joints, second.joints), joints, held)
