"""How limbs and spine are twisted about their own length, which positions of joints do not show directly.

Arms and legs: an elbow and a knee are hinges, so the plane in which they bend tells how the upper arm and the thigh are
turned. The straighter the limb, the less its plane says; there the turn is taken from the frames around, and from the
shortest turn where those are straight, too. Spine: what chest and pelvis are turned against each other is shared out
evenly between them, as vertebrae do.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.motion.quaternions import between, conjugate, multiply, normalised, rotate
from kinegraph.motion.skeleton import JOINT_INDEX

Floats = NDArray[np.floating[Any]]

HINGES: Final[dict[int, tuple[int, int, tuple[float, float, float]]]] = {
    JOINT_INDEX[f"{side}_{upper}"]: (JOINT_INDEX[f"{side}_{middle}"], JOINT_INDEX[f"{side}_{end}"], axis)
    for upper, middle, end, axes in (
        ("shoulder", "elbow", "wrist", {"left": (0.0, -1.0, 0.0), "right": (0.0, 1.0, 0.0)}),
        ("hip", "knee", "ankle", {"left": (1.0, 0.0, 0.0), "right": (1.0, 0.0, 0.0)}),
    )
    for side, axis in axes.items()
}
"""Joint -> its hinge, the end of the limb, and the axis about which the hinge bends in the T-pose: forearms forward,
shins backward, right-handed."""

BENT: Final = 0.35
"""Sine of a bend from which its plane is believed fully (20 degrees)."""
STRAIGHT: Final = 0.1
"""How much the shortest turn counts beside planes, whose weights are up to 1."""
WINDOW_SECONDS: Final = 0.2
"""To each side: frames that have a say, in a bell curve."""


def hinge_twist(rest: Floats, goal: Floats, lower: Floats, axis: Floats, fps: float, *, loops: bool = False) -> Floats:
    """Turns (frames,) in radians about the upper bone that bring the rest hinge into the plane that is seen.

    Args:
        rest: (3,) the upper bone at rest.
        goal: (frames, 3) the upper bone, in the frame of its parent.
        lower: (frames, 3) the lower bone, in the same frame.
        axis: (3,) of the hinge at rest.
        fps: frames per second.
        loops: whether the last frame is the first again, so that what is beside one is beside the other.
    """
    along, across = normalised(goal), np.cross(normalised(goal), normalised(lower), axis=-1)
    swung = rotate(between(rest, goal), np.asarray(axis, dtype=np.float64))
    # angle from the swung axis to the seen one about the bone; the length of `across` is the sine of the bend
    sine = (np.cross(swung, across, axis=-1) * along).sum(-1)
    cosine = (swung * across).sum(-1)
    size = np.hypot(sine, cosine)
    believed = np.minimum(size / BENT, 1.0) ** 2
    seen = believed * (cosine + 1j * sine) / np.where(size > 0, size, 1.0)
    return np.asarray(np.angle(_smoothed(seen, max(1, round(WINDOW_SECONDS * fps)), loops) + STRAIGHT))


def spine_twist(pelvis: Floats, chest: Floats) -> Floats:
    """How far (frames,) in radians the chest is turned against the pelvis about the spine, to the left positive.

    Args:
        pelvis, chest: (frames, 4) turns from rest, in the world.
    """
    relative = multiply(conjugate(pelvis), chest)
    # the turn about Y of a swing-twist decomposition; q and -q are the same turn
    return np.asarray(2 * np.arctan2(relative[:, 2] * np.sign(relative[:, 0]), np.abs(relative[:, 0])))


def twisted(swing: Floats, rest: Floats, angle: Floats) -> Floats:
    """A swing (frames, 4) after a turn by `angle` (frames,) about the resting bone `rest` (3,)."""
    half = np.asarray(angle)[:, None] / 2
    turn = np.concatenate([np.cos(half), np.sin(half) * normalised(np.asarray(rest, dtype=np.float64))], axis=-1)
    return multiply(swing, turn)


def _smoothed(
    values: NDArray[np.complexfloating[Any, Any]], window: int, loops: bool
) -> NDArray[np.complexfloating[Any, Any]]:
    """A mean over `window` frames to each side in a bell curve; frames beyond the ends are left out, or those of the
    round before and after."""
    bell = np.exp(-0.5 * (np.arange(-window, window + 1) / (window / 2)) ** 2)
    padded = np.pad(values[:-1], (window, window + 1), mode="wrap") if loops else np.pad(values, window)
    counts = np.pad(np.ones(len(values)), window, constant_values=float(loops))
    windows = np.lib.stride_tricks.sliding_window_view
    return np.asarray((windows(padded, len(bell)) @ bell) / (windows(counts, len(bell)) @ bell))
