"""`.gif` and `.mp4`: moving pictures of a clip as a stick figure, seen by a camera that follows the pelvis.

Both need the extra `plot`: Pillow draws the frames; PyAV, whose wheels carry FFmpeg (LGPL) and x264 (GPL), encodes the
H.264 video, which browsers, phones and players show. Nothing else of kinegraph imports these packages.
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
"""Width and height of a frame at scale 1, pixels; even, as video needs it."""
PIXELS_PER_METRE: Final = 150.0
"""At scale 1."""
FLOOR_ROW: Final = 320.0
"""Pixels from the top to y = 0 at scale 1."""
_SUPERSAMPLING: Final = 2
"""Frames are drawn this many times larger and scaled down, for smooth lines."""

GIF_MAX_FPS: Final = 50.0
"""Fastest rate that GIF viewers show; frames of a faster clip are left out."""

H264_ENCODER: Final = "libx264"
MP4_SCALE: Final = 2
"""Video frames are `SIZE` times this."""
MP4_CRF: Final = "18"
"""x264's constant rate factor: no visible blocks around lines."""
_MAX_DENOMINATOR: Final = 10_000
"""Largest denominator of a frame rate: 29.97 becomes 2997/100, not the binary fraction next to it."""


def encode_gif(clip: Clip) -> bytes:
    """Encode a clip as an animated GIF; equal clips give equal bytes."""
    from PIL import Image

    stride = int(np.ceil(clip.fps / GIF_MAX_FPS))
    frames = [draw_pose(pose) for pose in clip.shown[::stride]]
    palette = frames[0].quantize(32)
    pictures = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    # GIF counts hundredths of a second: round the end times, so that errors of the durations do not add up
    ends = np.round(np.arange(1, len(frames) + 1) * stride * 100 / clip.fps)
    durations = (np.diff(ends, prepend=0) * 10).astype(int).tolist()
    buffer = io.BytesIO()
    pictures[0].save(
        buffer, format="GIF", save_all=True, append_images=pictures[1:], duration=durations, loop=0, optimize=False
    )
    return buffer.getvalue()


def encode_mp4(clip: Clip) -> bytes:
    """Encode a clip as H.264 video; with one build of PyAV equal clips give equal bytes.

    Raises:
        MissingExtraError: this build of PyAV has no H.264 encoder.
    """
    import av

    if H264_ENCODER not in av.codecs_available:
        raise MissingExtraError(f"this build of PyAV lacks {H264_ENCODER}; pip install --force-reinstall av has it")
    buffer = io.BytesIO()
    rate = Fraction(clip.fps).limit_denominator(_MAX_DENOMINATOR)
    with av.open(buffer, "w", format="mp4") as file:
        stream = file.add_stream(H264_ENCODER, rate=rate, options={"crf": MP4_CRF})
        stream.width, stream.height = SIZE[0] * MP4_SCALE, SIZE[1] * MP4_SCALE
        stream.pix_fmt = "yuv420p"  # the one that every player supports
        # the split of a frame among threads shows in its bytes and would differ with the number of cores
        stream.thread_count = 1
        for pose in clip.shown:
            file.mux(stream.encode(av.VideoFrame.from_ndarray(np.asarray(draw_pose(pose, MP4_SCALE)))))
        file.mux(stream.encode(None))
    return buffer.getvalue()


def draw_pose(pose: FloatArray, scale: int = 1) -> Any:
    """Draw one pose, with marks on the floor a metre apart so that travel is visible.

    Args:
        pose: (22, 3) metres, Y up.
        scale: factor of `SIZE`.

    Returns:
        A Pillow image.
    """
    from PIL import Image, ImageDraw

    size, unit = (SIZE[0] * scale, SIZE[1] * scale), scale * _SUPERSAMPLING
    image = Image.new("RGB", (SIZE[0] * unit, SIZE[1] * unit), "white")
    draw = ImageDraw.Draw(image)
    across = np.cos(VIEW) * pose[:, 0] + np.sin(VIEW) * pose[:, 2]
    x = (SIZE[0] / 2 + PIXELS_PER_METRE * (across - across[0])) * unit
    y = (FLOOR_ROW - PIXELS_PER_METRE * pose[:, 1]) * unit
    ground = FLOOR_ROW * unit
    draw.line([(0, ground), (image.width, ground)], fill=LIGHT_GREY, width=2 * unit)
    for metre in range(int(np.floor(across[0])) - 2, int(np.ceil(across[0])) + 3):
        mark = (SIZE[0] / 2 + PIXELS_PER_METRE * (metre - across[0])) * unit
        draw.line([(mark, ground), (mark - 12 * unit, ground + 14 * unit)], fill=LIGHT_GREY, width=2 * unit)
    for child, parent in enumerate(PARENTS):
        if parent >= 0:
            ends = [(float(x[joint]), float(y[joint])) for joint in (parent, child)]
            draw.line(ends, fill=limb_colour(child), width=5 * unit)
            # Pillow ends lines squarely, which leaves gaps where limbs bend
            for end in ends:
                draw.circle(end, 2.5 * unit, fill=limb_colour(child))
    head, radius = JOINT_INDEX["head"], 0.09 * PIXELS_PER_METRE * unit
    draw.circle((float(x[head]), float(y[head]) - 0.6 * radius), radius, fill=GREY)
    return image.resize(size, Image.Resampling.LANCZOS)
