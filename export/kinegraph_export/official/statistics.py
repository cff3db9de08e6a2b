"""Read the statistics of features that come with HumanML3D and KIT-ML: Mean.npy and Std.npy."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.errors import InvalidInputError

DATA_OF_WIDTH = {263: "HumanML3D (22 joints)", 251: "KIT-ML (21 joints)"}
"""Features of the layouts of Guo et al. -> their data set."""
FILES = ("Mean.npy", "Std.npy")


def read_statistics(folder: Path, features: int) -> tuple[FloatArray, FloatArray]:
    """Read mean and standard deviation of features.

    Args:
        folder: with `FILES`.
        features: that the checkpoint's autoencoders take.

    Returns:
        Mean and standard deviation, (features,) each.

    Raises:
        InvalidInputError: a file is missing or no array of that many finite numbers, or a deviation is not positive;
            says whose statistics they are.
    """
    arrays = []
    for name in FILES:
        path = folder / name
        try:
            array = np.load(path, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise InvalidInputError(
                f"{path} cannot be read: {error}; --stats is the data set's folder, with {' and '.join(FILES)}"
            ) from error
        if not isinstance(array, np.ndarray) or array.shape != (features,):
            shape = getattr(array, "shape", None)
            given = DATA_OF_WIDTH.get(shape[0], "other data") if shape and len(shape) == 1 else "other data"
            wanted = DATA_OF_WIDTH.get(features, "other data")
            raise InvalidInputError(
                f"{path} has the shape {shape}, of {given}; the checkpoint has {features} features, of {wanted}: take "
                "the statistics of the data that it was trained on"
            )
        arrays.append(array.astype(np.float32))
    mean, std = arrays
    if not (np.isfinite(mean).all() and np.isfinite(std).all() and (std > 0).all()):
        raise InvalidInputError(f"{folder}: Mean.npy and Std.npy must be finite, and deviations positive")
    return mean, std
