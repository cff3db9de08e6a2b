"""Lengths of clips: too short ones are refused, long ones are cut into windows at moments of little motion."""

from __future__ import annotations

import re
from typing import Final

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.errors import InvalidInputError
from kinegraph.limits import MAX_FRAMES

MIN_FRAMES: Final = 16
"""Frames of the shortest clip that the presets train on; the longest has `MAX_FRAMES`."""

_USUAL: Final = 0.8
"""Length of a window, as a share of `MAX_FRAMES`; the rest is the freedom to look for a moment of little motion."""

_ORDER: Final = re.compile(
    r"\b(then|after|afterwards?|before|until|till|finally|lastly|first(ly)?|second(ly)?|next|eventually|later|again|once"
    r"|twice|thrice|times|starts?|starting|begins?|beginning|stops?|stopping|stopped|ends?|ending|finish(es|ing)?"
    r"|return(s|ing)?|turns? around|and"
    r"|(sits?|sitting|stands?|standing|lies|lie|lying|lays?|gets?|getting|kneels?|crouch(es)?"
    r"|bends?|falls?|picks?|puts?|places?|sets?|climbs?|jumps?) (it |them |something )?(up|down|over|off|on))\b",
    re.IGNORECASE,
)
"""Words of captions that tell of an order, a number or one moment, and so not of every part of a clip."""


def holds_at_any_moment(caption: str) -> bool:
    """Tell whether a caption describes every part of its clip: it names no order, no number, no change of posture.

    "and" may join actions at once or in order ("walks and waves", "walks and sits down"), so it does not.
    """
    return not _ORDER.search(caption)


def cut_windows(joints: FloatArray) -> list[tuple[int, int]]:
    """Cut a long clip into windows of `MIN_FRAMES` to `MAX_FRAMES`, at moments of little motion.

    Args:
        joints: (frames, 22, 3) metres.

    Returns:
        First frame and end of each window, in order and without gaps; one window if the clip is not too long.

    Raises:
        InvalidInputError: shorter than `MIN_FRAMES`.
    """
    frames = len(joints)
    if frames < MIN_FRAMES:
        raise InvalidInputError(f"{frames} frames are too short: a clip must have {MIN_FRAMES}, 0.8 s at 20 per second")
    if frames <= MAX_FRAMES:
        return [(0, frames)]
    count = int(np.ceil(frames / (_USUAL * MAX_FRAMES)))
    # each cut may move so far that no window becomes too long, even if its neighbour moves the other way
    freedom = min(int((MAX_FRAMES - 1 - frames / count) / 2), int((frames / count - MIN_FRAMES) / 2))
    steps = np.linalg.norm(np.diff(joints.astype(np.float64), axis=0), axis=-1).mean(axis=-1)
    speed = np.convolve(steps, np.ones(5) / 5, mode="same")
    cuts = [0]
    for number in range(1, count):
        middle = round(number * frames / count)
        low = middle - freedom
        cuts.append(low + int(speed[low : middle + freedom + 1].argmin()))
    return list(zip(cuts, [*cuts[1:], frames], strict=True))
