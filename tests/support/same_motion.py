"""When two ways to the same clip agree: to rounding in float32, roughly where one int8 scale spans the rows of a run.

The identities themselves are tested on an fp32 bundle in tests/training/test_stages.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinegraph import MotionPipeline

INT8_MEAN = 0.1
"""Metres, mean over joints and frames. At default steps it is 0.02; two seeds of the default bundle are 0.27 apart."""


def assert_same_motion(
    pipe: MotionPipeline, one: NDArray[np.float32], other: NDArray[np.float32], room: float = 1e-4
) -> None:
    if pipe.manifest.precision == "fp32":
        np.testing.assert_allclose(one, other, atol=room)
    else:
        assert one.shape == other.shape
        assert np.linalg.norm(one - other, axis=-1).mean() < INT8_MEAN
