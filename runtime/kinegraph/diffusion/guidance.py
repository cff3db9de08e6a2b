"""Classifier-free guidance (GraphMotion, Eq. A)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float32]


def guided(unconditional: FloatArray, conditional: FloatArray, scale: float) -> FloatArray:
    """eps = eps_0 + s (eps_c - eps_0); s = 1 is the condition alone, s = 0 no condition. Equal shapes."""
    return unconditional + np.float32(scale) * (conditional - unconditional)
