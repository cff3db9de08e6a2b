"""The frame of a body: where its pelvis is on the floor and where it faces, as HumanML3D (Guo et al., 2022) has it.

A clip begins in the frame of its own first pose. `BodyFrame` brings points from there into the world and back.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from kinegraph.arrays import DoubleArray, FloatArray, Floats
from kinegraph.motion.quaternions import about_axis, rotate
from kinegraph.motion.skeleton import HORIZONTAL, PELVIS, facing_angle


@dataclass(frozen=True)
class BodyFrame:
    """Origin and heading of a body in the world."""

    position: DoubleArray
    """(3,) metres; the height is 0."""
    heading: float
    """Radians from +Z towards +X."""

    @classmethod
    def of(cls, pose: Floats) -> Self:
        """Take the frame of a pose (22, 3), metres."""
        heading = float(facing_angle(pose[None].astype(np.float32))[0])
        return cls(np.asarray(pose[PELVIS].astype(np.float64) * HORIZONTAL), heading)

    def to_world(self, points: Floats) -> DoubleArray:
        """Bring points (..., 3) of this frame into the world."""
        turned = rotate(about_axis(1, np.array(self.heading)), points.astype(np.float64))
        return np.asarray(turned + self.position, dtype=np.float64)

    def to_body(self, points: Any) -> DoubleArray:
        """Bring points (..., 3) of the world into this frame."""
        moved = np.asarray(points, dtype=np.float64) - self.position
        return np.asarray(rotate(about_axis(1, np.array(-self.heading)), moved), dtype=np.float64)

    def floor_to_body(self, points: Any) -> DoubleArray:
        """Bring points (..., 2) on the floor of the world, x and z, into this frame."""
        flat = np.asarray(points, dtype=np.float64)
        raised = np.stack([flat[..., 0], np.zeros(flat.shape[:-1]), flat[..., 1]], axis=-1)
        return self.to_body(raised)[..., [0, 2]]


def append_part(whole: FloatArray, part: FloatArray, overlap: int) -> FloatArray:
    """Put a part behind a motion in whose last frames it begins, and fade from one to the other over these.

    Args:
        whole: (frames, 22, 3) metres in the world.
        part: (frames', 22, 3) metres, from the origin on and facing +Z; its first `overlap` frames are nearly the last
            ones of `whole`.
        overlap: frames that both have, at least 1.

    Returns:
        (frames + frames' - overlap, 22, 3) float32 metres.
    """
    placed = BodyFrame.of(whole[-overlap]).to_world(part)
    share = (np.arange(1, overlap + 1) / (overlap + 1))[:, None, None]
    faded = (1 - share) * whole[-overlap:] + share * placed[:overlap]
    return np.concatenate([whole[:-overlap], faded, placed[overlap:]]).astype(np.float32)
