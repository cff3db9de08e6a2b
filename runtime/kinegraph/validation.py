"""Checks of values that callers pass and models produce.

Python integers have no limit, and `repr` of a value may be huge or raise: nothing here does, whatever comes in.
"""

from __future__ import annotations

import math
from numbers import Integral, Real
from typing import TYPE_CHECKING, Final

from kinegraph.errors import InvalidInputError, NonFiniteError

if TYPE_CHECKING:
    from kinegraph.arrays import FloatArray

MAX_FPS: Final = 240.0
"""Frames per second."""

_LONGEST_REPR: Final = 80
_LARGEST_SHOWN: Final = 10**40


def short_repr(value: object) -> str:
    """Describe a value briefly for a message, whatever the caller passed."""
    if isinstance(value, int) and abs(value) >= _LARGEST_SHOWN:
        return "a number of more than 40 digits"
    if value is None or isinstance(value, str | int | float):
        return repr(value if not isinstance(value, str) else value[:_LONGEST_REPR])[:_LONGEST_REPR]
    return f"a value of type {type(value).__name__}"


def whole_number(value: object) -> int | None:
    """Return a value as an int, or None if it is not a whole number."""
    # bool is an int to Python, but nobody means seed=True; numpy's integers are Integral
    return int(value) if isinstance(value, Integral) and not isinstance(value, bool) else None


def finite_number(value: object) -> float | None:
    """Return a real number as a float, or None if it is not one, not finite, or beyond 1e308."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return None
    try:
        number = float(value)
    except OverflowError:  # an integer or fraction beyond 1e308
        return None
    return number if math.isfinite(number) else None


def check_flag(value: object, name: str) -> bool:
    """Return a flag, or refuse what is neither True nor False.

    Raises:
        InvalidInputError: naming the option.
    """
    if not isinstance(value, bool):
        raise InvalidInputError(f"{name} must be True or False, not {short_repr(value)}")
    return value


def check_callback(value: object, name: str) -> None:
    """Refuse a callback that cannot be called.

    Raises:
        InvalidInputError: naming the option.
    """
    if value is not None and not callable(value):
        raise InvalidInputError(f"{name} must be a function or None, not {short_repr(value)}")


def check_fps(fps: object) -> None:
    """Refuse values that are no frame rate.

    Raises:
        InvalidInputError: not a number from 1 to `MAX_FPS`.
    """
    number = finite_number(fps)
    if number is None or not 1 <= number <= MAX_FPS:
        raise InvalidInputError(f"fps must be 1 to {MAX_FPS:g} frames per second, not {short_repr(fps)}")


def require_finite(values: FloatArray, stage: str) -> FloatArray:
    """Return `values` as they are, or refuse NaN and infinity.

    Args:
        values: any shape.
        stage: what produced them, for the message.

    Raises:
        NonFiniteError: naming the stage.
    """
    import numpy as np  # here, because `--help` needs this module and not numpy

    if not np.isfinite(values).all():
        raise NonFiniteError(f"{stage} produced NaN or infinity; the bundle's weights are broken")
    return values
