"""Array types that all modules share, and the check for NaN and infinity."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float32]
"""Single precision: inputs and outputs of models, joints in metres."""
DoubleArray = NDArray[np.float64]
"""Double precision, for maths outside the models."""
Floats = NDArray[np.floating[Any]]
"""Either precision; functions on it keep that of their arguments."""
IntArray = NDArray[np.int64]
"""Token ids, indices, timesteps, frames."""
