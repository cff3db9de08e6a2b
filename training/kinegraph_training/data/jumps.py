"""Jumps of a recording: a pose that was put before the motion, and joints that leap within it."""

from __future__ import annotations

from typing import Final

import numpy as np

from kinegraph.arrays import Floats, IntArray

STILL: Final = 0.02
"""Metres that joints move from frame to frame, at most, in a pose that is held."""
LONGEST_POSE: Final = 0.5
"""Seconds that a pose before the motion is held, at most."""


def motion_start(joints: Floats, fps: float) -> int:
    """Find the first frame of the motion: the one after a jump out of a held pose, such as a T-pose, else 0.

    Args:
        joints: (frames, 22, 3) metres.
        fps: frames per second.
    """
    steps = _largest_steps(joints)
    for frame in range(min(len(steps) - 2, int(LONGEST_POSE * fps) + 1)):
        after = float(steps[frame + 1 : frame + 3].max())
        if steps[frame] > max(0.12, 4.0 * after) and steps[frame] * fps > 4.0:
            return frame + 1
        if steps[frame] > STILL:
            break
    return 0


def find_jumps(joints: Floats, fps: float) -> IntArray:
    """Find the frames after which a joint moves much further than in the frames around: 25 cm, and 12 m/s.

    Args:
        joints: (frames, 22, 3) metres.
        fps: frames per second.
    """
    steps = _largest_steps(joints)
    padded = np.pad(steps, 1)
    around = np.maximum(padded[:-2], padded[2:])
    return np.flatnonzero((steps > 0.25) & (steps * fps > 12.0) & (steps > 5.0 * around))


def _largest_steps(joints: Floats) -> Floats:
    """Return how far the fastest joint moves from each frame to the next: (frames - 1,) metres."""
    return np.asarray(np.linalg.norm(np.diff(joints, axis=0), axis=-1).max(axis=-1))
