"""Single actions that are recognised on any window of a clip: a sentence, a predicate, and a check of the predicate.

Benchmarks of parts (sequences, negations, orders) cut windows out of clips. A predicate that holds of whole clips may
be blind on windows, so `check_windows` says how many captured windows of its action meet it, and how many of others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.motion.skeleton import JOINT_INDEX
from kinegraph_benchmarks.common import predicates as p
from kinegraph_training.data.clips import MotionClip

STRAIGHT_DEGREES: Final = 45.0
"""Net turn of a walk or run that names none, at most."""
RUNNING: Final = 1.75
"""Metres per second between walks and runs of the normal style."""

UP_SECONDS: Final = 0.25
"""Time for which a raised hand is up at least."""


@dataclass(frozen=True)
class WindowAction:
    """One action, how it is asked for and how it is recognised on a window."""

    sentence: str
    label: str
    """Label of its captured clips."""
    holds: p.Predicate
    seconds: float
    """A usual length: what captured clips last, to half a second, 6 s at most."""


def goes_straight(joints: FloatArray) -> bool:
    """Tell whether a body ends more than 0.5 m ahead, facing as it did within `STRAIGHT_DEGREES`."""
    return p.goes(1, 1, 0.5)(joints) and abs(p.net_turn(joints)) < STRAIGHT_DEGREES


def bends(joints: FloatArray) -> bool:
    """Tell whether the head comes down by more than 0.1 m over the pelvis, from where it is at first.

    A runner's head and pelvis bob together; and the part before a bow may still travel where the two meet.
    """
    height = joints[:, JOINT_INDEX["head"], 1] - joints[:, 0, 1]
    return bool(height[0] - height.min() > 0.1)


def raises_on_window(side: str) -> p.Predicate:
    """Make a predicate: that wrist alone, for "both" each, is above the head for `UP_SECONDS`, and no hand waves.

    In the rest of the window the other hand may come down from what was before it, or go up for what comes next.
    """

    def holds(joints: FloatArray) -> bool:
        head = joints[:, JOINT_INDEX["head"], 1]
        above = {hand: joints[:, JOINT_INDEX[f"{hand}_wrist"], 1] > head for hand in p.SIDES}
        moments = np.all([above[hand] == (side in (hand, "both")) for hand in p.SIDES], axis=0)
        return bool(moments.sum() >= UP_SECONDS * p.FPS) and not any(p.hand_waves(joints, hand) for hand in p.SIDES)

    return holds


def _hands(verb: str, label: str, make: Any, seconds: float) -> dict[str, WindowAction]:
    """Describe an action of the left hand, the right hand and both."""
    return {
        f"{label} {side}": WindowAction(
            f"a person {verb} {'both hands' if side == 'both' else f'the {side} hand'}",
            f"{label}-{side}-hand{'s' if side == 'both' else ''}",
            make(side),
            seconds,
        )
        for side in ("left", "right", "both")
    }


ACTIONS: Final[Mapping[str, WindowAction]] = {
    "walk": WindowAction("a person walks forward", "walk", p.all_of(goes_straight, p.slower(RUNNING)), 4.0),
    "run": WindowAction("a person runs forward", "run", p.all_of(goes_straight, p.faster(RUNNING)), 3.0),
    "turn left": WindowAction("a person walks and turns left", "walk-turn-left", p.turns("left"), 4.0),
    "turn right": WindowAction("a person walks and turns right", "walk-turn-right", p.turns("right"), 4.0),
    **_hands("raises", "raise-up", raises_on_window, 2.5),
    **_hands("waves", "wave", p.waves, 6.0),
    "bow": WindowAction("a person bows", "bow", bends, 4.0),
}
"""By name. Raises last as long as captured ones: longer ones of the default bundle wave (`quality.waves`)."""


def middle_window(joints: FloatArray, seconds: float) -> FloatArray:
    """Cut a window out of the middle of a clip; the whole clip where it is not longer."""
    frames = min(round(seconds * p.FPS), len(joints))
    start = (len(joints) - frames) // 2
    return joints[start : start + frames]


def check_windows(clips: Sequence[MotionClip], names: Sequence[str], style: str | None = "normal") -> dict[str, Any]:
    """Check predicates on captured windows of the length of their action.

    Args:
        clips: captured clips.
        names: keys of `ACTIONS`; windows of the labels of these actions are compared.
        style: of the clips; None for all.

    Returns:
        For each name: `clips`, the share of its own windows that meet it (`met`) and of those of the others (`wrong`).
    """
    chosen = [clip for clip in clips if style in (None, clip.style)]
    report = {}
    for name in names:
        action = ACTIONS[name]
        held: dict[str, list[bool]] = {ACTIONS[other].label: [] for other in names}
        for clip in chosen:
            if clip.action in held:
                held[clip.action].append(action.holds(middle_window(clip.joints, action.seconds)))
        own = held.pop(action.label)
        others = [value for values in held.values() for value in values]
        report[name] = {
            "clips": len(own),
            "met": float(np.mean(own)) if own else None,
            "wrong": float(np.mean(others)) if others else None,
        }
    return report
