"""One pose as a picture, seen by a camera that goes along: the frames of `.gif` and `.mp4`. Needs Pillow."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from kinegraph.formats.png import FAINT, MIDDLE, VIEW, colour_of
from kinegraph.motion.skeleton import JOINT_INDEX, PARENTS, FloatArray

SIZE: Final = (320, 360)
"""Pixels of a picture at scale 1; even, as video wants it."""
METRE: Final = 150.0
"""Pixels of a metre at scale 1."""
FLOOR: Final = 320.0
"""Pixels from the top to y = 0 at scale 1."""
_SHARP: Final = 2
"""Drawn so many times larger and scaled down: lines without steps."""


def picture(pose: FloatArray, scale: int = 1) -> Any:
    """A Pillow image of one pose (22, 3), with marks on the floor a metre apart so that travel is seen."""
    from PIL import Image, ImageDraw

    size, drawn = (SIZE[0] * scale, SIZE[1] * scale), scale * _SHARP
    image = Image.new("RGB", (SIZE[0] * drawn, SIZE[1] * drawn), "white")
    draw = ImageDraw.Draw(image)
    across = np.cos(VIEW) * pose[:, 0] + np.sin(VIEW) * pose[:, 2]
    x = (SIZE[0] / 2 + METRE * (across - across[0])) * drawn
    y = (FLOOR - METRE * pose[:, 1]) * drawn
    ground = FLOOR * drawn
    draw.line([(0, ground), (image.width, ground)], fill=FAINT, width=2 * drawn)
    for mark in range(int(np.floor(across[0])) - 2, int(np.ceil(across[0])) + 3):
        place = (SIZE[0] / 2 + METRE * (mark - across[0])) * drawn
        draw.line([(place, ground), (place - 12 * drawn, ground + 14 * drawn)], fill=FAINT, width=2 * drawn)
    for child, parent in enumerate(PARENTS):
        if parent >= 0:
            ends = [(float(x[joint]), float(y[joint])) for joint in (parent, child)]
            draw.line(ends, fill=colour_of(child), width=5 * drawn)
            # Pillow ends a line squarely, which leaves gaps where limbs bend
            for end in ends:
                draw.circle(end, 2.5 * drawn, fill=colour_of(child))
    head, radius = JOINT_INDEX["head"], 0.09 * METRE * drawn
    draw.circle((float(x[head]), float(y[head]) - 0.6 * radius), radius, fill=MIDDLE)
    return image.resize(size, Image.Resampling.LANCZOS)
