"""Made sitting: a captured body that stands is put on a seat of the height of a chair.

The free recordings hold five clips of somebody on a low stool. Here the hips go down and back while the feet stay, the
trunk leans forward on the way, and the hands end on the thighs or hang. The seat itself is not drawn.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from kinegraph.arrays import DoubleArray, FloatArray
from kinegraph.motion.skeleton import JOINT_INDEX, PELVIS
from kinegraph_training.metrics import FPS
from kinegraph_training.synthetic.posing import TRUNK, pose_arm, shift_hips, smoothstep, turn_about, unit

SITTING: Final = ("sit", "sit-down", "sit-down-and-stand-up", "stand-up")
"""Labels: seated all the time, from standing to sitting, there and back, and from sitting to standing."""
SEAT: Final = (0.42, 0.52)
"""Range of the height of the hip joints on the seat, metres."""
BACK: Final = (0.32, 0.42)
"""Range of the way that the hips go back, metres."""
ON_THE_WAY: Final = (22.0, 40.0)
"""Degrees that the trunk leans forward half-way down or up."""
SEATED: Final = (-4.0, 10.0)
"""Degrees that it leans forward on the seat."""
SECONDS: Final = (0.8, 1.6)
"""Range of the time that it takes to sit down, and to stand up."""
ON_THIGHS: Final = 0.6
"""Share of the clips in which the hands end on the thighs."""
THIGHS: Final = (-0.02, -0.40, 0.24)
"""The wrist's place there from the shoulder in the frame of the chest: outwards, up, forward, metres."""
ELBOWS: Final = (0.7, -0.6, -0.6)
"""Direction of the elbows in that frame, as the hands are there."""


def sit(body: FloatArray, label: str, rng: np.random.Generator) -> FloatArray:
    """Let a captured body that stands sit down, sit, or stand up.

    Args:
        body: (frames, 22, 3) metres, at least 1.5 s; the feet stay where they are.
        label: one of `SITTING`.
        rng: draws the seat, the times and what the arms do.

    Returns:
        (frames, 22, 3) with the body's bone lengths.
    """
    weight = seated_weight(len(body), label, rng)
    hips = [JOINT_INDEX["left_hip"], JOINT_INDEX["right_hip"]]
    middle = body[:, hips].astype(np.float64).mean(1)
    axis = unit((body[:, hips[0]] - body[:, hips[1]]).astype(np.float64))
    left = unit(axis * [1, 0, 1])
    forward = np.cross(left, [0.0, 1.0, 0.0])
    height, back = rng.uniform(*SEAT), rng.uniform(*BACK)
    down = np.maximum(middle[:, 1] - body[:, :, 1].min() - height, 0.0)
    shift = weight[:, None] * (-back * forward - down[:, None] * [0.0, 1.0, 0.0])
    out = shift_hips(body.astype(np.float64), shift, 2.0 * weight[:, None] * forward)
    lean = rng.uniform(*ON_THE_WAY) * np.sin(np.pi * weight) + rng.uniform(*SEATED) * weight
    above = [PELVIS, *TRUNK]
    out[:, above] = turn_about(out[:, above], out[:, hips].mean(1), axis, np.radians(lean))
    if rng.random() < ON_THIGHS:
        place = np.tile(np.array(THIGHS) + rng.normal(0.0, 0.02, 3), (len(body), 1))
        for side in ("left", "right"):
            out = pose_arm(out, side, place, np.array(ELBOWS), weight)
    return np.where((weight > 0)[:, None, None], out, body).astype(body.dtype)


def seated_weight(frames: int, label: str, rng: np.random.Generator) -> DoubleArray:
    """Draw how far down a body is at each frame (frames,): 0 stands, 1 sits."""
    if label == "sit":
        return np.ones(frames)
    down, up = (round(rng.uniform(*SECONDS) * FPS) for _ in range(2))
    index = np.arange(frames)
    if label == "sit-down-and-stand-up":
        shrunk = min(1.0, 0.6 * frames / (down + up))
        start = rng.uniform(0.0, 0.2) * (frames - shrunk * (down + up))
        return smoothstep(
            np.minimum(
                np.clip((index - start) / (shrunk * down), 0, 1), np.clip((frames - 1 - index) / (shrunk * up), 0, 1)
            )
        )
    start = rng.uniform(0.0, 0.5) * max(frames - down - FPS, 0)
    weight = smoothstep(np.clip((index - start) / min(down, frames - 1), 0, 1))
    return weight[::-1].copy() if label == "stand-up" else weight
