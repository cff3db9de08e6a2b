"""`.mp4`: the clip as H.264 video that browsers, phones and players show, drawn by `stick_figure`.

Needs the `plot` extra: PyAV, whose wheels carry FFmpeg (LGPL) and x264 (GPL). Nothing else of kinegraph loads them.
"""

from __future__ import annotations

import io
from fractions import Fraction
from typing import TYPE_CHECKING, Final

import numpy as np

from kinegraph.errors import MissingExtraError
from kinegraph.formats.stick_figure import SIZE, picture

if TYPE_CHECKING:
    from kinegraph.motion.clip import Clip

ENCODER: Final = "libx264"
SCALE: Final = 2
"""Of `stick_figure.SIZE`."""
QUALITY: Final = "18"
"""x264's constant rate factor: lines without visible blocks."""
_FINEST: Final = 10_000
"""Largest denominator of a frame rate: 29.97 is 2997/100, not the binary number next to it."""


def encode(clip: Clip) -> bytes:
    """The file of a clip; with one build of PyAV equal clips give equal bytes.

    Raises:
        MissingExtraError: this build of PyAV cannot make H.264.
    """
    import av

    if ENCODER not in av.codecs_available:
        raise MissingExtraError(f"this build of PyAV lacks {ENCODER}; pip install --force-reinstall av has it")
    buffer = io.BytesIO()
    with av.open(buffer, "w", format="mp4") as file:
        stream = file.add_stream(ENCODER, rate=Fraction(clip.fps).limit_denominator(_FINEST), options={"crf": QUALITY})
        stream.width, stream.height = SIZE[0] * SCALE, SIZE[1] * SCALE
        stream.pix_fmt = "yuv420p"  # the one that every player knows
        # how a picture is split among threads shows in its bytes, and would differ with the number of cores
        stream.thread_count = 1
        for pose in clip.shown:
            file.mux(stream.encode(av.VideoFrame.from_ndarray(np.asarray(picture(pose, SCALE)))))
        file.mux(stream.encode(None))
    return buffer.getvalue()
