"""What a game or a shot asks of a finished clip: another frame rate, no travel, no seam.

joints are (frames, 22, 3) metres, Y up; every function returns new ones.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.errors import InvalidInputError
from kinegraph.motion.quaternions import about_axis, conjugate, multiply, rotate, slerp
from kinegraph.motion.rotations import forward_kinematics, solve_rotations
from kinegraph.motion.skeleton import FloatArray, facing_angle

Floats = NDArray[np.floating[Any]]

MAX_FPS: Final = 240.0
SHORTEST_LOOP: Final = 0.5
"""Share of a clip that a loop keeps at least."""
BLEND_SECONDS: Final = 0.4
"""In which the end of a loop turns into its beginning."""


def check_fps(fps: object) -> None:
    """Refuse what is no frame rate.

    Raises:
        InvalidInputError: not a number of 1 to `MAX_FPS`.
    """
    if isinstance(fps, bool) or not isinstance(fps, int | float | np.number) or not 1 <= fps <= MAX_FPS:
        raise InvalidInputError(f"fps must be 1 to {MAX_FPS:g} frames per second, not {fps!r}")


def resampled(joints: FloatArray, fps: float, wanted: float) -> FloatArray:
    """The same motion at another frame rate: rotations along the shorter way (slerp), the root on a straight line.

    A frame that was there before comes out as it was; as long as before, to half a frame.
    """
    count = max(1, round(len(joints) * wanted / fps))
    time = np.minimum(np.arange(count) * (fps / wanted), len(joints) - 1)
    before = np.minimum(time.astype(np.int64), max(0, len(joints) - 2))
    after = np.minimum(before + 1, len(joints) - 1)
    share = time - before
    motion = solve_rotations(joints)
    solved = forward_kinematics(motion.rest_offsets, motion.root, motion.rotations)
    # what fixed bones cannot follow is put back, so that known frames stay as they are
    rest = _between(joints - solved, before, after, share[:, None, None])
    turns = slerp(motion.rotations[before], motion.rotations[after], share[:, None])
    root = _between(motion.root, before, after, share[:, None])
    return (forward_kinematics(motion.rest_offsets, root, turns) + rest).astype(np.float32)


def in_place(joints: FloatArray) -> FloatArray:
    """Without travel over the floor: the pelvis stays above where it was first; turns and height stay."""
    still = np.array(joints, dtype=np.float32)
    still[..., [0, 2]] -= joints[:, :1, [0, 2]] - joints[:1, :1, [0, 2]]
    return still


def looped(joints: FloatArray, fps: float) -> FloatArray:
    """A clip whose last frame leads into its first: cut where the pose comes back, its end blended into its start.

    The pose, the height and the lean come back; travel and heading go on from round to round.

    Raises:
        InvalidInputError: fewer than 8 frames.
    """
    if len(joints) < 8:
        raise InvalidInputError(f"a loop needs 8 frames, this clip has {len(joints)}")
    motion = solve_rotations(joints)
    own = local_poses(joints)
    end = _cut(own)
    window = max(2, min(end // 2, round(BLEND_SECONDS * fps)))
    # frame `end` is to be frame 0 again; what is missing to that is spread over the frames before it, smoothly
    part = (np.arange(window) + 1.0) / window
    share = np.zeros(end + 1)
    share[end + 1 - window :] = part * part * (3 - 2 * part)
    heading = about_axis(1, facing_angle(joints)[: end + 1].astype(np.float64))
    turns = motion.rotations[: end + 1].copy()
    turns[:, 0] = multiply(conjugate(heading), turns[:, 0])
    turns = slerp(turns, np.broadcast_to(turns[:1], turns.shape), share[:, None])
    turns[:, 0] = multiply(heading, turns[:, 0])
    root = motion.root[: end + 1].copy()
    root[:, 1] += share * (motion.root[0, 1] - root[:, 1])
    return forward_kinematics(motion.rest_offsets, root, turns)[:end].astype(np.float32)


def local_poses(joints: FloatArray) -> Floats:
    """(frames, 22, 3) with the pelvis above the origin and the body facing +Z."""
    centred = joints - joints[:, :1] * np.array([1.0, 0.0, 1.0])
    back = about_axis(1, -facing_angle(joints).astype(np.float64))
    return rotate(back[:, None], centred)


def _cut(poses: Floats) -> int:
    """The frame that is most like the first, in pose and in how it moves, not before half of the clip."""
    first = max(4, round(SHORTEST_LOOP * len(poses)))
    velocity = np.gradient(poses, axis=0)
    ends = np.arange(first, len(poses))
    apart = np.linalg.norm(poses[ends] - poses[0], axis=-1).mean(axis=-1)
    moving = np.linalg.norm(velocity[ends] - velocity[0], axis=-1).mean(axis=-1)
    return int(ends[np.argmin(apart + 4.0 * moving)])


def _between(values: Floats, before: NDArray[np.int64], after: NDArray[np.int64], share: Floats) -> Floats:
    return np.asarray(values[before] + share * (values[after] - values[before]))
