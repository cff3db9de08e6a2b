"""What a game or a shot asks of a finished clip: another frame rate, no travel.

joints are (frames, 22, 3) metres, Y up; every function returns new ones.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import FloatArray, Floats
from kinegraph.errors import InvalidInputError
from kinegraph.motion.blending import OVER_FLOOR
from kinegraph.motion.kinematics import forward_kinematics, rotations_from_positions
from kinegraph.motion.quaternions import about_axis, rotate, slerp
from kinegraph.motion.skeleton import facing_angle

MAX_FPS: Final = 240.0


def check_fps(fps: object) -> None:
    """Refuse what is no frame rate.

    Raises:
        InvalidInputError: not a number of 1 to `MAX_FPS`.
    """
    if isinstance(fps, bool) or not isinstance(fps, int | float | np.number) or not 1 <= fps <= MAX_FPS:
        raise InvalidInputError(f"fps must be 1 to {MAX_FPS:g} frames per second, not {fps!r}")


def resample(joints: FloatArray, fps: float, wanted: float, *, loops: bool = False) -> FloatArray:
    """The same motion at another frame rate: rotations along the shorter way (slerp), the root on a straight line.

    A frame that was there before comes out as it was; as long as before, to half a frame. What `loops` keeps its last
    frame, the first of the next round, and gives up half a frame of its length for it.
    """
    if loops:
        time = np.linspace(0, len(joints) - 1, max(1, round((len(joints) - 1) * wanted / fps)) + 1)
    else:
        count = max(1, round(len(joints) * wanted / fps))
        time = np.minimum(np.arange(count) * (fps / wanted), len(joints) - 1)
    before = np.minimum(time.astype(np.int64), max(0, len(joints) - 2))
    after = np.minimum(before + 1, len(joints) - 1)
    share = time - before
    motion = rotations_from_positions(joints, fps, loops=loops)
    solved = forward_kinematics(motion.rest_offsets, motion.root, motion.rotations)
    # what fixed bones cannot follow is put back, so that known frames stay as they are
    rest = _between(joints - solved, before, after, share[:, None, None])
    turns = slerp(motion.rotations[before], motion.rotations[after], share[:, None])
    root = _between(motion.root, before, after, share[:, None])
    return (forward_kinematics(motion.rest_offsets, root, turns) + rest).astype(np.float32)


def in_place(joints: FloatArray, *, loops: bool = False) -> FloatArray:
    """Without travel over the floor: the pelvis stays above where it was first; turns and height stay.

    What `loops` ends facing where it began: what a round turns in all is taken away evenly over it.
    """
    still = np.array(joints, dtype=np.float64)
    still[..., [0, 2]] -= joints[:, :1, [0, 2]] - joints[:1, :1, [0, 2]]
    if loops and len(joints) > 1:
        heading = facing_angle(joints)
        even = np.linspace(0.0, float(heading[-1] - heading[0]), len(joints))
        pivot = still[:, :1] * OVER_FLOOR
        still = rotate(about_axis(1, -even)[:, None], still - pivot) + pivot
    return still.astype(np.float32)


def _between(values: Floats, before: NDArray[np.int64], after: NDArray[np.int64], share: Floats) -> Floats:
    return np.asarray(values[before] + share * (values[after] - values[before]))
