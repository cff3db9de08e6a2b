"""Feature layouts that a model may be trained on, told apart by their width.

Both begin with yaw velocity, root velocity, height and local positions, in these columns. They differ in what a unit of
yaw is, in whose frame the root moves, and in the rotations of `humanml3d-263`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.errors import InvalidInputError
from kinegraph.motion import features, humanml3d


@dataclass(frozen=True)
class FeatureLayout:
    """How a clip is written as features."""

    name: Literal["joints-137", "humanml3d-263"]
    width: int
    heading: Literal["true", "humanml3d"]
    """Facing direction, as in the manifest of a bundle."""
    groups: tuple[slice, ...]
    """Columns that share one standard deviation."""
    from_joints: Callable[[FloatArray], FloatArray]
    """(frames, 22, 3) metres -> (frames - `lost`, width)."""
    to_joints: Callable[[FloatArray], FloatArray]
    """(frames, width), not normalised -> (frames, 22, 3) metres."""
    lost: int
    """Frames of a clip that have no row."""
    turn: float
    """Radians to the left per frame that a unit of yaw velocity stands for."""
    moves_after_turning: bool
    """Whether the root velocity is in the facing frame at the end of its frame instead of at the start."""


JOINTS_137: Final = FeatureLayout(
    "joints-137",
    features.WIDTH,
    "true",
    features.GROUPS,
    features.features_from_joints,
    features.joints_from_features,
    lost=0,
    turn=1.0,
    moves_after_turning=False,
)
HUMANML3D_263: Final = FeatureLayout(
    "humanml3d-263",
    humanml3d.WIDTH,
    "humanml3d",
    humanml3d.GROUPS,
    humanml3d.humanml3d_from_joints,
    humanml3d.joints_from_humanml3d,
    lost=1,
    turn=-2.0,
    moves_after_turning=True,
)
LAYOUTS: Final = {layout.width: layout for layout in (JOINTS_137, HUMANML3D_263)}


def layout_of(width: int) -> FeatureLayout:
    """Return the layout of a width.

    Raises:
        InvalidInputError: no layout has it.
    """
    if width not in LAYOUTS:
        known = ", ".join(f"{width} ({layout.name})" for width, layout in LAYOUTS.items())
        raise InvalidInputError(f"no feature layout is {width} wide; `features` in [vae.shared] must be {known}")
    return LAYOUTS[width]


def measure_normalisation(clips: Iterable[FloatArray], layout: FeatureLayout) -> tuple[FloatArray, FloatArray]:
    """Measure what `kinegraph.motion.features.normalisation` does, of any layout, one clip at a time.

    Args:
        clips: (frames, width) each.
        layout: of their features.

    Returns:
        Mean per feature and standard deviation per group, both (width,) float32.
    """
    count, total, squares = 0, np.zeros(layout.width), np.zeros(layout.width)
    for rows in clips:
        values = rows.astype(np.float64)
        count += len(values)
        total += values.sum(axis=0)
        squares += np.square(values).sum(axis=0)
    mean = total / max(count, 1)
    variance = np.maximum(squares / max(count, 1) - np.square(mean), 0.0)
    std = np.empty(layout.width)
    for group in layout.groups:
        deviation = np.sqrt(variance[group].mean())
        std[group] = deviation if deviation > 1e-6 else 1.0
    return mean.astype(np.float32), std.astype(np.float32)
