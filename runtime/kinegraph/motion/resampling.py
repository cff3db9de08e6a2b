"""Resampling to another frame rate, and removal of travel over the floor.

Joints are (frames, 22, 3) metres with Y up. Every function returns a new array.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import DoubleArray, FloatArray, Floats
from kinegraph.motion.kinematics import SkeletonMotion, forward_kinematics, rotations_from_positions
from kinegraph.motion.quaternions import about_axis, rotate, slerp
from kinegraph.motion.skeleton import HORIZONTAL, facing_angle


def resample(joints: FloatArray, fps: float, new_fps: float, *, loops: bool = False) -> FloatArray:
    """Resample a motion to another frame rate: slerp for rotations, linear interpolation for the root.

    Frames whose time exists in both rates stay as they are. The duration is kept to half a frame.

    Args:
        joints: (frames, 22, 3) metres.
        fps: frames per second of `joints`.
        new_fps: frames per second of the result.
        loops: treat the clip as periodic (last frame == first but for travel). The last frame is then kept, and the
            duration may change by half a frame for it.

    Returns:
        (frames', 22, 3) float32 metres.
    """
    motion = rotations_from_positions(joints, fps, loops=loops)
    solved = forward_kinematics(motion.rest_offsets, motion.root, motion.rotations)
    # interpolate the residual that rigid bones cannot follow and add it back, so that old frames stay as they are
    before, after, share = _neighbours(len(joints), fps, new_fps, loops)
    residual = _lerp(joints - solved, before, after, share[:, None, None])
    between = resample_motion(motion, fps, new_fps, loops=loops)
    return (forward_kinematics(between.rest_offsets, between.root, between.rotations) + residual).astype(np.float32)


def resample_motion(motion: SkeletonMotion, fps: float, new_fps: float, *, loops: bool = False) -> SkeletonMotion:
    """Resample a solved motion, as `resample` does for joints: slerp for rotations, linear interpolation for the root.

    Args:
        motion: at `fps` frames per second.
        fps, new_fps, loops: see `resample`.

    Returns:
        The same skeleton at `new_fps`; its errors are interpolated, too.
    """
    before, after, share = _neighbours(len(motion.root), fps, new_fps, loops)
    return replace(
        motion,
        root=_lerp(motion.root, before, after, share[:, None]),
        rotations=slerp(motion.rotations[before], motion.rotations[after], share[:, None]),
        error=_lerp(motion.error, before, after, share[:, None]),
    )


def in_place(joints: FloatArray, *, loops: bool = False) -> FloatArray:
    """Remove travel over the floor: the pelvis stays above its first position; rotation and height stay.

    For loops, remove the net rotation linearly so that the last frame faces the same way as the first.

    Args:
        joints: (frames, 22, 3) metres.
        loops: whether the motion is a loop.

    Returns:
        (frames, 22, 3) float32 metres.
    """
    still = np.array(joints, dtype=np.float64)
    still[..., [0, 2]] -= joints[:, :1, [0, 2]] - joints[:1, :1, [0, 2]]
    if loops and len(joints) > 1:
        heading = facing_angle(joints)
        drift = np.linspace(0.0, float(heading[-1] - heading[0]), len(joints))
        pivot = still[:, :1] * HORIZONTAL
        still = rotate(about_axis(1, -drift)[:, None], still - pivot) + pivot
    return still.astype(np.float32)


def _neighbours(
    frames: int, fps: float, new_fps: float, loops: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64], DoubleArray]:
    """Find the old frames before and after each new one, and the share of the latter."""
    # time of each new frame, in frames of the old rate
    if loops:
        time = np.linspace(0, frames - 1, max(1, round((frames - 1) * new_fps / fps)) + 1)
    else:
        count = max(1, round(frames * new_fps / fps))
        time = np.minimum(np.arange(count) * (fps / new_fps), frames - 1)
    before = np.minimum(time.astype(np.int64), max(0, frames - 2))
    return before, np.minimum(before + 1, frames - 1), time - before


def _lerp(values: Floats, before: NDArray[np.int64], after: NDArray[np.int64], share: Floats) -> Floats:
    """Interpolate linearly between the frames `before` and `after`."""
    return np.asarray(values[before] + share * (values[after] - values[before]))
