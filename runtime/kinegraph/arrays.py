"""Array types that all modules share, and the check that numbers are numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinegraph.errors import NonFiniteError

FloatArray = NDArray[np.float32]
"""What models take and give, and joints in metres."""
DoubleArray = NDArray[np.float64]
"""What is computed more exactly than models do."""
Floats = NDArray[np.floating[Any]]
"""Either of the two: functions that keep the precision they are given."""
IntArray = NDArray[np.int64]
"""Token ids, indices, timesteps, frames."""


def require_finite(values: FloatArray, stage: str) -> FloatArray:
    """Return `values` as they are, or refuse NaN and infinity.

    Args:
        values: any shape.
        stage: what produced them, for the message.

    Raises:
        NonFiniteError: naming the stage.
    """
    if not np.isfinite(values).all():
        raise NonFiniteError(f"{stage} produced NaN or infinity; the bundle's weights are broken")
    return values
