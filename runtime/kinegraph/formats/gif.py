"""`.gif`: the clip as a moving picture, seen by a camera that goes along. Needs the `plot` extra."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from kinegraph.formats.png import FAINT, MIDDLE, VIEW, colour_of
from kinegraph.motion.skeleton import JOINT_INDEX, PARENTS, FloatArray

if TYPE_CHECKING:
    from kinegraph.motion.clip import Clip

SIZE: Final = (320, 360)
"""Pixels."""
METRE: Final = 150.0
"""Pixels of a metre."""
FLOOR: Final = 320.0
"""Pixels from the top to y = 0."""
MOST_FPS: Final = 50.0
"""What viewers of GIF show at most; a clip of more frames per second is thinned."""
_SHARP: Final = 2
"""Drawn so many times larger and scaled down: lines without steps."""


def encode(clip: Clip) -> bytes:
    """The file of a clip; equal clips give equal bytes."""
    from PIL import Image

    every = int(np.ceil(clip.fps / MOST_FPS))
    frames = [_frame(pose) for pose in clip.joints[::every]]
    palette = frames[0].quantize(32)
    pictures = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    # hundredths of a second are all that the format knows; rounding errors must not add up
    ends = np.round(np.arange(1, len(frames) + 1) * every * 100 / clip.fps)
    lengths = (np.diff(ends, prepend=0) * 10).astype(int).tolist()
    buffer = io.BytesIO()
    pictures[0].save(
        buffer, format="GIF", save_all=True, append_images=pictures[1:], duration=lengths, loop=0, optimize=False
    )
    return buffer.getvalue()


def _frame(pose: FloatArray) -> Any:
    """One pose (22, 3), with marks on the floor a metre apart so that travel is seen."""
    from PIL import Image, ImageDraw

    image = Image.new("RGB", (SIZE[0] * _SHARP, SIZE[1] * _SHARP), "white")
    draw = ImageDraw.Draw(image)
    across = np.cos(VIEW) * pose[:, 0] + np.sin(VIEW) * pose[:, 2]
    x = (SIZE[0] / 2 + METRE * (across - across[0])) * _SHARP
    y = (FLOOR - METRE * pose[:, 1]) * _SHARP
    ground = FLOOR * _SHARP
    draw.line([(0, ground), (image.width, ground)], fill=FAINT, width=2 * _SHARP)
    for mark in range(int(np.floor(across[0])) - 2, int(np.ceil(across[0])) + 3):
        place = (SIZE[0] / 2 + METRE * (mark - across[0])) * _SHARP
        draw.line([(place, ground), (place - 12 * _SHARP, ground + 14 * _SHARP)], fill=FAINT, width=2 * _SHARP)
    for child, parent in enumerate(PARENTS):
        if parent >= 0:
            ends = [(float(x[joint]), float(y[joint])) for joint in (parent, child)]
            draw.line(ends, fill=colour_of(child), width=5 * _SHARP, joint="curve")
    head, radius = JOINT_INDEX["head"], 0.09 * METRE * _SHARP
    middle = (float(x[head]), float(y[head]) - 0.6 * radius)
    draw.ellipse([(middle[0] - radius, middle[1] - radius), (middle[0] + radius, middle[1] + radius)], fill=MIDDLE)
    return image.resize(SIZE, Image.Resampling.LANCZOS)
