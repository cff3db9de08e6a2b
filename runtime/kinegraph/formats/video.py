"""One pose as a picture, seen by a camera that goes along: the frames of `.gif` and `.mp4`. Needs Pillow.

`.gif`: the clip as a moving picture, drawn by `stick_figure`. Needs the `plot` extra.

`.mp4`: the clip as H.264 video that browsers, phones and players show, drawn by `stick_figure`.

Needs the `plot` extra: PyAV, whose wheels carry FFmpeg (LGPL) and x264 (GPL). Nothing else of kinegraph loads them.
"""

from __future__ import annotations

import io
from fractions import Fraction
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.errors import MissingExtraError
from kinegraph.formats.contact_sheet import GREY, LIGHT_GREY, VIEW, limb_colour
from kinegraph.motion.skeleton import JOINT_INDEX, PARENTS

if TYPE_CHECKING:
    from kinegraph.clip import Clip


SIZE: Final = (320, 360)
"""Pixels of a picture at scale 1; even, as video wants it."""
METRE: Final = 150.0
"""Pixels of a metre at scale 1."""
FLOOR: Final = 320.0
"""Pixels from the top to y = 0 at scale 1."""
_SHARP: Final = 2
"""Drawn so many times larger and scaled down: lines without steps."""


def draw_pose(pose: FloatArray, scale: int = 1) -> Any:
    """A Pillow image of one pose (22, 3), with marks on the floor a metre apart so that travel is seen."""
    from PIL import Image, ImageDraw

    size, drawn = (SIZE[0] * scale, SIZE[1] * scale), scale * _SHARP
    image = Image.new("RGB", (SIZE[0] * drawn, SIZE[1] * drawn), "white")
    draw = ImageDraw.Draw(image)
    across = np.cos(VIEW) * pose[:, 0] + np.sin(VIEW) * pose[:, 2]
    x = (SIZE[0] / 2 + METRE * (across - across[0])) * drawn
    y = (FLOOR - METRE * pose[:, 1]) * drawn
    ground = FLOOR * drawn
    draw.line([(0, ground), (image.width, ground)], fill=LIGHT_GREY, width=2 * drawn)
    for mark in range(int(np.floor(across[0])) - 2, int(np.ceil(across[0])) + 3):
        place = (SIZE[0] / 2 + METRE * (mark - across[0])) * drawn
        draw.line([(place, ground), (place - 12 * drawn, ground + 14 * drawn)], fill=LIGHT_GREY, width=2 * drawn)
    for child, parent in enumerate(PARENTS):
        if parent >= 0:
            ends = [(float(x[joint]), float(y[joint])) for joint in (parent, child)]
            draw.line(ends, fill=limb_colour(child), width=5 * drawn)
            # Pillow ends a line squarely, which leaves gaps where limbs bend
            for end in ends:
                draw.circle(end, 2.5 * drawn, fill=limb_colour(child))
    head, radius = JOINT_INDEX["head"], 0.09 * METRE * drawn
    draw.circle((float(x[head]), float(y[head]) - 0.6 * radius), radius, fill=GREY)
    return image.resize(size, Image.Resampling.LANCZOS)


MOST_FPS: Final = 50.0
"""What viewers of GIF show at most; a clip of more frames per second is thinned."""


def encode_gif(clip: Clip) -> bytes:
    """The file of a clip; equal clips give equal bytes."""
    from PIL import Image

    every = int(np.ceil(clip.fps / MOST_FPS))
    frames = [draw_pose(pose) for pose in clip.shown[::every]]
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


ENCODER: Final = "libx264"
MP4_SCALE: Final = 2
"""Of `stick_figure.SIZE`."""
QUALITY: Final = "18"
"""x264's constant rate factor: lines without visible blocks."""
_FINEST: Final = 10_000
"""Largest denominator of a frame rate: 29.97 is 2997/100, not the binary number next to it."""


def encode_mp4(clip: Clip) -> bytes:
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
        stream.width, stream.height = SIZE[0] * MP4_SCALE, SIZE[1] * MP4_SCALE
        stream.pix_fmt = "yuv420p"  # the one that every player knows
        # how a picture is split among threads shows in its bytes, and would differ with the number of cores
        stream.thread_count = 1
        for pose in clip.shown:
            file.mux(stream.encode(av.VideoFrame.from_ndarray(np.asarray(draw_pose(pose, MP4_SCALE)))))
        file.mux(stream.encode(None))
    return buffer.getvalue()
