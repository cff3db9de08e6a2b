"""Check what a caption claims in numbers against the motion: steps, degrees of a turn, height of the hands.

These are harder than the behaviours of `behaviour_prompts`, where every trained model soon reaches the rate of captured
clips, so they can rank models.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.motion.skeleton import JOINT_INDEX, facing_angle
from kinegraph_benchmarks.common import predicates as p

NUMBERS = ("one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve",
           "thirteen", "fourteen", "fifteen", "sixteen", "seventeen", "eighteen", "nineteen", "twenty")  # fmt: skip
_STEPS = re.compile(r"\b(" + "|".join(NUMBERS) + r")\s+(?:\w+\s+)?steps?\b")
_DEGREES = re.compile(r"\b(\d+)\s+degrees\b")
_HEIGHT = re.compile(r"\b(shoulder height|head height|above (?:the|their) head)\b")
STEP_SPREAD = 0.08
"""Metres by which one ankle must be ahead of the other before the next crossing counts."""
DEGREES_TOLERANCE = 30.0
"""Degrees by which a turn may miss the number, because captions round it."""
HEIGHTS = {"shoulder height": (-0.4, 0.06), "head height": (-0.06, 0.28), "above the head": (0.16, 1.0)}
"""Lowest and highest allowed height of the wrist above the head joint, metres (see `hand_height`)."""


@dataclass(frozen=True)
class Claim:
    """One claim of a caption that can be checked."""

    kind: str
    """"steps", "degrees" or "height"."""
    value: str
    """A whole number, or a key of `HEIGHTS`."""

    def holds(self, joints: FloatArray) -> bool:
        """Tell whether a motion (frames, 22, 3) keeps the claim; steps may differ by one."""
        if self.kind == "steps":
            return abs(count_steps(joints) - int(self.value)) <= 1
        if self.kind == "degrees":
            return abs(abs(p.net_turn(joints)) - float(self.value)) <= DEGREES_TOLERANCE
        low, high = HEIGHTS[self.value]
        return low <= hand_height(joints) <= high


def parse_claims(caption: str) -> list[Claim]:
    """Find all claims of a caption that can be checked."""
    text = caption.lower()
    claims = [Claim("steps", str(NUMBERS.index(word) + 1)) for word in _STEPS.findall(text)]
    claims += [Claim("degrees", number) for number in _DEGREES.findall(text)]
    claims += [Claim("height", words.replace("their", "the")) for words in _HEIGHT.findall(text)]
    return claims


def count_steps(joints: FloatArray) -> int:
    """Count steps: how often the legs change places along the facing direction.

    The labels of the data count in the same way: of 460 labelled clips, 441 get their label, the others 1 or 2 less.
    """
    offset = joints[:, JOINT_INDEX["left_ankle"]] - joints[:, JOINT_INDEX["right_ankle"]]
    heading = facing_angle(joints)
    # signed distance of the left ankle in front of the right one
    lead = np.sin(heading) * offset[:, 0] + np.cos(heading) * offset[:, 2]
    sides = np.sign(lead[np.abs(lead) > STEP_SPREAD])
    return int((np.diff(sides) != 0).sum())


def hand_height(joints: FloatArray) -> float:
    """Measure how far above the head joint the moving wrist gets, metres; if both move, the lower one."""
    head = joints[:, JOINT_INDEX["head"], 1]
    tops = [float((joints[:, JOINT_INDEX[f"{side}_wrist"], 1] - head).max()) for side in ("left", "right")]
    # The arm that is not asked for may be bent, but it stays far below the other one.
    return min(tops) if max(tops) - min(tops) < 0.25 else max(tops)
