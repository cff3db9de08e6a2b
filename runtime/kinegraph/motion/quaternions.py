"""Unit quaternions (..., 4) in the order w, x, y, z; they turn vectors of a right-handed frame.

Every function keeps the floating type of what it is given and broadcasts over the leading axes.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from kinegraph.arrays import Floats

IDENTITY: Final = (1.0, 0.0, 0.0, 0.0)


def multiply(first: Floats, second: Floats) -> Floats:
    """The turn that does `second`, then `first`."""
    a, b = first, second
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def conjugate(turn: Floats) -> Floats:
    """The turn back."""
    return np.concatenate([turn[..., :1], -turn[..., 1:]], axis=-1)


def rotate(turn: Floats, vector: Floats) -> Floats:
    """`vector` (..., 3) turned."""
    turn, vector = _broadcast(turn, vector)
    axis = turn[..., 1:]
    # An explicit axis: numpy.cross guesses, and a clip of three frames goes wrong.
    once = np.cross(axis, vector, axis=-1)
    twice = np.cross(axis, once, axis=-1)
    return np.asarray(vector + 2.0 * (turn[..., :1] * once + twice))


def between(start: Floats, end: Floats) -> Floats:
    """The shortest turn that takes the direction `start` (..., 3) to `end`; lengths do not matter.

    Opposite directions have no shortest turn: one of the half turns is returned. A zero vector gives the
    identity.
    """
    start, end = np.broadcast_arrays(start, end)
    size = np.sqrt((start * start).sum(-1, keepdims=True) * (end * end).sum(-1, keepdims=True))
    scalar = size + (start * end).sum(-1, keepdims=True)
    turn = np.concatenate([scalar, np.cross(start, end, axis=-1)], axis=-1)
    opposite = (scalar <= 1e-6 * size)[..., 0]
    if opposite.any():
        turn[opposite] = np.concatenate([np.zeros_like(size), _perpendicular(start)], axis=-1)[opposite]
    turn[size[..., 0] == 0] = IDENTITY
    return normalised(turn)


def normalised(vector: Floats) -> Floats:
    """`vector` (..., n) at length 1; a zero vector stays zero."""
    length = np.sqrt((vector * vector).sum(-1, keepdims=True))
    return np.asarray(vector / np.where(length > 0, length, 1.0).astype(vector.dtype))


def continuous(turns: Floats) -> Floats:
    """The same turns (frames, ..., 4) with signs chosen so that each lies next to the one before it."""
    dots = (turns[1:] * turns[:-1]).sum(-1)
    flips = np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0).astype(turns.dtype)
    return np.concatenate([turns[:1], turns[1:] * flips[..., None]])


def slerp(first: Floats, second: Floats, share: Floats) -> Floats:
    """The turn at `share` (...,) of the shorter way from `first` to `second` (Shoemake, 1985)."""
    dot = (first * second).sum(-1, keepdims=True)
    second = np.where(dot < 0, -second, second)
    angle = np.arccos(np.clip(np.abs(dot), 0.0, 1.0))
    near = angle < 1e-4
    sine = np.where(near, 1.0, np.sin(angle))
    share = np.asarray(share)[..., None]
    # Close turns are mixed linearly: their sines would be divided by almost nothing.
    left = np.where(near, 1.0 - share, np.sin((1.0 - share) * angle) / sine)
    right = np.where(near, share, np.sin(share * angle) / sine)
    return normalised((left * first + right * second).astype(first.dtype))


def to_matrix(turn: Floats) -> Floats:
    """Rotation matrices (..., 3, 3); columns are where the axes x, y, z go."""
    axes = np.eye(3, dtype=turn.dtype)
    return np.stack([rotate(turn, axes[index]) for index in range(3)], axis=-1)


def from_matrix(matrix: Floats) -> Floats:
    """Quaternions of rotation matrices (..., 3, 3), with w >= 0."""
    m = matrix
    diagonal = np.stack([m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]], axis=-1)
    trace = diagonal.sum(-1, keepdims=True)
    # 4 q q^T, of which the row with the largest diagonal entry is the best conditioned.
    outer = np.empty((*m.shape[:-2], 4, 4), dtype=m.dtype)
    outer[..., 0, 0] = 1 + trace[..., 0]
    for index in range(3):
        outer[..., index + 1, index + 1] = 1 + 2 * diagonal[..., index] - trace[..., 0]
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        outer[..., 0, i + 1] = outer[..., i + 1, 0] = m[..., k, j] - m[..., j, k]
        outer[..., j + 1, k + 1] = outer[..., k + 1, j + 1] = m[..., k, j] + m[..., j, k]
    best = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    row = np.take_along_axis(outer, best[..., None, None], axis=-2)[..., 0, :]
    return normalised(np.where(row[..., :1] < 0, -row, row))


def about_axis(axis: int, angle: Floats) -> Floats:
    """Turns by `angle` (...,) radians about x, y or z (0, 1, 2)."""
    turn = np.zeros((*angle.shape, 4), dtype=angle.dtype)
    turn[..., 0] = np.cos(angle / 2)
    turn[..., 1 + axis] = np.sin(angle / 2)
    return turn


def _broadcast(turn: Floats, vector: Floats) -> tuple[Floats, Floats]:
    shape = np.broadcast_shapes(turn.shape[:-1], vector.shape[:-1])
    return np.broadcast_to(turn, (*shape, 4)), np.broadcast_to(vector, (*shape, 3))


def _perpendicular(vector: Floats) -> Floats:
    """Some direction at right angles to each vector."""
    flat = np.zeros_like(vector)
    smallest = np.argmin(np.abs(vector), axis=-1)
    np.put_along_axis(flat, smallest[..., None], 1.0, axis=-1)
    return normalised(np.cross(vector, flat, axis=-1))
