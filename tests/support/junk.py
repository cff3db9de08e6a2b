"""Values that callers pass by mistake or on purpose, for tests that nothing but typed errors comes of them."""

from __future__ import annotations

from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np


class Unfriendly:
    """An object whose methods all fail."""

    def __repr__(self) -> str:
        raise RuntimeError("no repr")

    def __bool__(self) -> bool:
        raise RuntimeError("neither true nor false")

    def __eq__(self, other: object) -> bool:
        raise RuntimeError("not comparable")

    __hash__ = object.__hash__


class OneShot:
    """An iterator over one value that is fresh again once it is exhausted, for there is one in the whole process."""

    def __init__(self) -> None:
        self._left = 1

    def __iter__(self) -> OneShot:
        return self

    def __next__(self) -> int:
        self._left -= 1
        if self._left < 0:
            self._left = 1
            raise StopIteration
        return 1


def nested(depth: int) -> list[Any]:
    """Nest lists deeper than `repr` can follow."""
    value: list[Any] = []
    for _ in range(depth):
        value = [value]
    return value


HUGE = 10**5000
JUNK: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 5, HUGE, -HUGE, 2**63, 1.5, float("nan"), float("inf"), 1e308, 5e-324),
    *(Fraction(HUGE, 3), Fraction(1, 3), Decimal("NaN"), 1j, np.float32("nan"), np.int64(3), np.bool_(False)),
    *(np.array([1, 2, 3]), np.array([]), np.array("text"), np.array([None]), np.zeros((2, 22, 3))),
    *("", " ", "x" * 100_000, "\ud800", "a\0b", "…", "NaN", b"", b"\xff\xfe", bytearray(b"a"), memoryview(b"a")),
    *([], (), {}, set(), [None], [[]], {"a": 1}, {None: None}, {"motion": HUGE}, nested(5000), range(10**9), OneShot()),
    *(object(), object, len, lambda *_: None, Unfriendly(), [Unfriendly()], NotImplemented, ...),
)
"""One of each kind."""
