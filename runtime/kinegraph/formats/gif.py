"""`.gif`: the clip as a moving picture, drawn by `stick_figure`. Needs the `plot` extra."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Final

import numpy as np

from kinegraph.formats.stick_figure import picture

if TYPE_CHECKING:
    from kinegraph.motion.clip import Clip

MOST_FPS: Final = 50.0
"""What viewers of GIF show at most; a clip of more frames per second is thinned."""


def encode(clip: Clip) -> bytes:
    """The file of a clip; equal clips give equal bytes."""
    from PIL import Image

    every = int(np.ceil(clip.fps / MOST_FPS))
    frames = [picture(pose) for pose in clip.shown[::every]]
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
