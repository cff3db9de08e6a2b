"""Checks of the values in constraints: arrays, poses, places, moments and weights.

Each returns the value as constraints hold it, or raises `InvalidInputError` with its name and what to do.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from kinegraph.arrays import DoubleArray, FloatArray
from kinegraph.errors import InvalidInputError
from kinegraph.limits import MAX_METRES, MAX_WEIGHT
from kinegraph.motion.quaternions import from_matrix, normalised
from kinegraph.validation import finite_number, short_repr

ROTATION_TOLERANCE: Final = 1e-3
"""Largest error of the length of a quaternion and of the entries of a matrix times its transpose."""


def check_array(value: object, what: str, shape: tuple[int, ...], wanted: str) -> DoubleArray:
    """Copy numbers to a read-only array.

    Args:
        value: of the caller.
        what: it is, for the message.
        shape: with -1 for any number.
        wanted: shape in words, for the message.

    Raises:
        InvalidInputError: no numbers, another shape, NaN or infinity.
    """
    if not isinstance(value, np.ndarray | list | tuple):
        raise InvalidInputError(f"{what} must be an array of shape {wanted}, not {short_repr(value)}")
    try:
        array = np.asarray(value)
    except (ValueError, OverflowError) as error:
        raise InvalidInputError(f"{what} are no array of shape {wanted} ({error})") from error
    if array.dtype.kind not in "fiu":
        raise InvalidInputError(f"{what} have type {array.dtype}; they must be real numbers of shape {wanted}")
    fits = array.ndim == len(shape) and all(size in (-1, own) for size, own in zip(shape, array.shape, strict=True))
    if not fits:
        raise InvalidInputError(f"{what} have shape {array.shape}; it must be {wanted}")
    if not isinstance(value, np.ndarray) and _holds_flags(value):
        raise InvalidInputError(f"{what} hold true or false; they must be real numbers of shape {wanted}")
    copy = np.array(array, dtype=np.float64)
    if not np.isfinite(copy).all():
        index = tuple(int(number) for number in np.argwhere(~np.isfinite(copy))[0])
        raise InvalidInputError(f"{what} are not finite at index {index}; leave out what is not known")
    copy.flags.writeable = False
    return copy


def _holds_flags(values: object) -> bool:
    """Tell whether nested lists hold a bool, which numpy would take for 0 or 1."""
    if isinstance(values, list | tuple):
        return any(map(_holds_flags, values))
    return isinstance(values, bool | np.bool_)


def check_pose(value: object, what: str, shape: tuple[int, ...], wanted: str) -> FloatArray:
    """Copy joints in metres to a read-only array; see `check_array`."""
    metres = within_metres(check_array(value, what, shape, wanted), what)
    joints = metres.astype(np.float32)
    joints.flags.writeable = False
    return joints


def within_metres(values: DoubleArray, what: str) -> DoubleArray:
    """Refuse places beyond `MAX_METRES`.

    Raises:
        InvalidInputError: naming the first such value.
    """
    far = np.abs(values) > MAX_METRES
    if far.any():
        value = float(values[far][0])
        raise InvalidInputError(
            f"{what} is at {value:g} m; places are at most {MAX_METRES:g} m away: are these metres?"
        )
    return values


def check_coordinates(value: object, what: str, axes: str, *, free: bool = False) -> tuple[float | None, ...]:
    """Check a place: a number of metres for each axis, or None where `free` allows it.

    Raises:
        InvalidInputError: naming the axis.
    """
    values = value.tolist() if isinstance(value, np.ndarray) else value
    if not isinstance(values, list | tuple) or len(values) != len(axes):
        named = ", ".join(axes)
        raise InvalidInputError(f"{what} is at ({named}) in metres, not at {short_repr(value)}")
    numbers = [None if number is None and free else finite_number(number) for number in values]
    for axis, number, given in zip(axes, numbers, values, strict=True):
        if number is None and not (free and given is None):
            raise InvalidInputError(f"{axis} of {what} must be metres, not {short_repr(given)}")
        if number is not None and abs(number) > MAX_METRES:
            raise InvalidInputError(f"{axis} of {what} is {number:g} m; places are at most {MAX_METRES:g} m away")
    return tuple(numbers)


def check_moment(value: object, what: str) -> float:
    """Check a time.

    Raises:
        InvalidInputError: not a number of seconds from 0 on.
    """
    seconds = finite_number(value)
    if seconds is None or seconds < 0:
        raise InvalidInputError(f"{what} must be seconds from 0 on, not {short_repr(value)}")
    return seconds


def check_weight(value: object, what: str) -> float:
    """Check a weight.

    Raises:
        InvalidInputError: not a number from 0 to `MAX_WEIGHT`.
    """
    return _within_limits(
        value, f"the weight of {what} must be 0 to {MAX_WEIGHT:g}, not {short_repr(value)}; 1 is usual"
    )


def check_rotations(value: object, what: str, count: int) -> DoubleArray:
    """Convert rotations, quaternions (count, 4) or matrices (count, 3, 3), to unit quaternions (count, 4).

    Raises:
        InvalidInputError: another shape, not finite, a quaternion that is not of unit length, or a matrix that is no
            rotation, both to `ROTATION_TOLERANCE`.
    """
    shape = (count, 3, 3) if _depth(value) == 3 else (count, 4)
    numbers = check_array(value, what, shape, f"({count}, 4) of quaternions or ({count}, 3, 3) of matrices")
    if numbers.ndim == 2:
        wrong = np.abs(np.linalg.norm(numbers, axis=-1) - 1.0) > ROTATION_TOLERANCE
    else:
        off = np.abs(numbers @ np.swapaxes(numbers, 1, 2) - np.eye(3)).max(axis=(1, 2))
        wrong = (off > ROTATION_TOLERANCE) | (np.linalg.det(numbers) < 0)
    if wrong.any():
        index = int(np.argmax(wrong))
        raise InvalidInputError(f"{what} hold no rotation at index {index}; give unit quaternions or rotation matrices")
    return np.asarray(normalised(numbers) if numbers.ndim == 2 else from_matrix(numbers), dtype=np.float64)


def _depth(value: object) -> int:
    """Count the dimensions of an array or of nested lists, up to 4."""
    if isinstance(value, np.ndarray):
        return value.ndim
    depth = 0
    while isinstance(value, list | tuple) and value and depth < 4:
        value, depth = value[0], depth + 1
    return depth


def check_total_weight(weight: object) -> float:
    """Check the weight of all constraints of a call against its text.

    Raises:
        InvalidInputError: not a number from 0 to `MAX_WEIGHT`.
    """
    allowed = f"constraint_weight must be 0 to {MAX_WEIGHT:g}, not {short_repr(weight)}; 1 is usual, 0 is without"
    return _within_limits(weight, allowed)


def _within_limits(value: object, refusal: str) -> float:
    """Return a number from 0 to `MAX_WEIGHT`; refuse all else with a message."""
    number = finite_number(value)
    if number is None or not 0 <= number <= MAX_WEIGHT:
        raise InvalidInputError(refusal)
    return number
