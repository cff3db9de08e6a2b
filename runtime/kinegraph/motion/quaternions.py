"""Unit quaternions (..., 4) in the order w, x, y, z, which rotate vectors of a right-handed frame.

Every function broadcasts over the leading axes and keeps the floating-point type of its arguments.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from kinegraph.arrays import Floats

IDENTITY: Final = (1.0, 0.0, 0.0, 0.0)


def multiply(first: Floats, second: Floats) -> Floats:
    """Compute the Hamilton product: the rotation that applies `second`, then `first`."""
    a, b = first, second
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    return _stacked(
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def conjugate(rotation: Floats) -> Floats:
    """Invert unit quaternions."""
    return np.concatenate([rotation[..., :1], -rotation[..., 1:]], axis=-1)


def rotate(rotation: Floats, vector: Floats) -> Floats:
    """Rotate vectors (..., 3): v + 2 (w (u x v) + u x (u x v)) for the quaternion (w, u)."""
    axis = rotation[..., 1:]
    once = cross(axis, vector)
    return np.asarray(vector + 2.0 * (rotation[..., :1] * once + cross(axis, once)))


def cross(first: Floats, second: Floats) -> Floats:
    """Compute the cross product of vectors (..., 3); numpy.cross, which moves axes about, takes twice as long."""
    ax, ay, az = first[..., 0], first[..., 1], first[..., 2]
    bx, by, bz = second[..., 0], second[..., 1], second[..., 2]
    return _stacked(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


def shortest_rotation(start: Floats, end: Floats) -> Floats:
    """Find the shortest rotation from the direction `start` (..., 3) to the direction `end` (..., 3).

    Lengths do not matter. Opposite directions have no unique shortest rotation: one of the half turns is returned.
    A zero vector gives the identity.
    """
    # q ~ (|a| |b| + a . b, a x b)
    size = np.sqrt(_dot(start, start) * _dot(end, end))
    scalar = size + _dot(start, end)
    rotation = np.concatenate([scalar[..., None], cross(start, end)], axis=-1)
    opposite = np.asarray(scalar <= 1e-6 * size)
    if opposite.any():
        aside = np.broadcast_to(_perpendicular(start), (*size.shape, 3))
        rotation[opposite] = np.concatenate([np.zeros_like(size)[..., None], aside], axis=-1)[opposite]
        rotation[size == 0] = IDENTITY
    return normalised(rotation)


def normalised(vector: Floats) -> Floats:
    """Scale vectors (..., n) to length 1; a zero vector stays zero."""
    length = np.sqrt((vector * vector).sum(-1, keepdims=True))
    return np.asarray(vector / np.where(length > 0, length, 1.0).astype(vector.dtype, copy=False))


def continuous_signs(rotations: Floats) -> Floats:
    """Choose signs so that consecutive quaternions (frames, ..., 4) lie on the same half-sphere.

    q and -q are the same rotation, but programs that interpolate between keys need neighbours of one sign.
    """
    dots = (rotations[1:] * rotations[:-1]).sum(-1)
    flips = np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0).astype(rotations.dtype)
    return np.concatenate([rotations[:1], rotations[1:] * flips[..., None]])


def slerp(first: Floats, second: Floats, share: Floats) -> Floats:
    """Interpolate spherically along the shorter arc (Shoemake, 1985).

    Args:
        first, second: (..., 4) unit quaternions.
        share: (...,) of `second`, 0 to 1.

    Returns:
        (..., 4).
    """
    dot = (first * second).sum(-1, keepdims=True)
    second = np.where(dot < 0, -second, second)
    angle = np.arccos(np.clip(np.abs(dot), 0.0, 1.0))
    # below 1e-4 radians sin(angle) is too small to divide by: interpolate linearly
    near = angle < 1e-4
    sine = np.where(near, 1.0, np.sin(angle))
    share = np.asarray(share)[..., None]
    left = np.where(near, 1.0 - share, np.sin((1.0 - share) * angle) / sine)
    right = np.where(near, share, np.sin(share * angle) / sine)
    return normalised((left * first + right * second).astype(first.dtype))


def to_matrix(rotation: Floats) -> Floats:
    """Convert to rotation matrices (..., 3, 3); the columns are the rotated x, y and z axes."""
    w, x, y, z = rotation[..., 0], rotation[..., 1], rotation[..., 2], rotation[..., 3]
    dx, dy, dz = x + x, y + y, z + z
    wx, wy, wz, xx, xy, xz = w * dx, w * dy, w * dz, x * dx, x * dy, x * dz
    yy, yz, zz = y * dy, y * dz, z * dz
    rows = (1 - yy - zz, xy - wz, xz + wy, xy + wz, 1 - xx - zz, yz - wx, xz - wy, yz + wx, 1 - xx - yy)
    return _stacked(*rows).reshape(*rotation.shape[:-1], 3, 3)


def from_matrix(matrix: Floats) -> Floats:
    """Convert rotation matrices (..., 3, 3) to quaternions with w >= 0.

    Builds 4 q q^T from the matrix and takes the row with the largest diagonal entry, the best conditioned one
    (Shepperd, 1978).
    """
    m = matrix
    diagonal = np.stack([m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]], axis=-1)
    trace = diagonal.sum(-1, keepdims=True)
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
    """Build rotations by `angle` (...,) radians about a coordinate axis: 0, 1, 2 for x, y, z."""
    rotation = np.zeros((*angle.shape, 4), dtype=angle.dtype)
    rotation[..., 0] = np.cos(angle / 2)
    rotation[..., 1 + axis] = np.sin(angle / 2)
    return rotation


def _dot(first: Floats, second: Floats) -> Floats:
    """Compute the dot product of vectors (..., 3)."""
    ax, ay, az = first[..., 0], first[..., 1], first[..., 2]
    return np.asarray(ax * second[..., 0] + ay * second[..., 1] + az * second[..., 2])


def _stacked(*parts: Floats) -> Floats:
    """Stack arrays of one shape along a new last axis; numpy.stack takes twice as long for a clip."""
    whole = np.empty((*parts[0].shape, len(parts)), dtype=parts[0].dtype)
    for index, part in enumerate(parts):
        whole[..., index] = part
    return whole


def _perpendicular(vector: Floats) -> Floats:
    """Pick a unit vector at right angles to each vector (..., 3)."""
    axis = np.zeros_like(vector)
    smallest = np.argmin(np.abs(vector), axis=-1)
    np.put_along_axis(axis, smallest[..., None], 1.0, axis=-1)
    return normalised(np.cross(vector, axis, axis=-1))
