"""`.png`: a contact sheet, poses of a clip from left to right and its path from above. Needs the extra `plot`."""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from kinegraph.arrays import FloatArray, IntArray
from kinegraph.motion.skeleton import JOINT_INDEX, JOINT_NAMES, PARENTS, facing_angle

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from kinegraph.clip import Clip

POSES: Final = 8
"""Poses shown, evenly spaced in time."""
VIEW: Final = 0.6
"""Azimuth of the camera, radians: 0 shows the body from its front in the first frame."""
RED, BLUE, GREY, LIGHT_GREY = "#c2410c", "#1d4ed8", "#3f3f46", "#d4d4d8"
_HALF_WIDTH: Final = 0.8
"""Metres shown on each side of the pelvis."""


def encode(clip: Clip) -> bytes:
    """Draw a clip's contact sheet; equal clips give equal bytes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(1.4 * (POSES + 1.5), 2.9), dpi=110)
    axes = figure.subplots(1, POSES + 1, width_ratios=[1.0] * POSES + [1.5])
    draw_row(axes, clip.joints, clip.fps)
    figure.suptitle(title_line(clip.text), fontsize=12, y=0.97)
    figure.subplots_adjust(left=0.01, right=0.97, bottom=0.14, top=0.88, wspace=0.02)
    return png_bytes(figure)


def draw_row(axes: Sequence[Axes], joints: FloatArray, fps: float) -> None:
    """Draw a clip's joints (frames, 22, 3) on a row of axes: `POSES` poses and the path from above."""
    frames = np.linspace(0, len(joints) - 1, POSES).round().astype(int)
    top = max(1.9, float(joints[..., 1].max()) + 0.1)
    for axis, frame in zip(axes, frames, strict=False):
        _draw_pose(axis, joints[frame], f"{frame / fps:.1f} s", top)
    _draw_path(axes[-1], joints, frames)


def png_bytes(figure: Figure) -> bytes:
    """Render a figure as PNG; equal figures give equal bytes."""
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        # scripts that the font lacks are drawn as boxes
        warnings.filterwarnings("ignore", message="Glyph")
        # without the program's name and version the bytes depend on the figure alone
        figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def limb_colour(joint: int) -> str:
    """Choose the colour of the bone that leads to a joint: red on the left, blue on the right."""
    name = JOINT_NAMES[joint]
    return RED if name.startswith("left") else BLUE if name.startswith("right") else GREY


def title_line(text: str, width: int = 110) -> str:
    """Shorten a text to one line of `width` characters and escape what matplotlib reads as a formula."""
    line = " ".join(text.split())
    return (line if len(line) <= width else line[: width - 1] + "…").replace("$", r"\$")


def _draw_pose(axis: Axes, joints: FloatArray, label: str, top: float) -> None:
    """Draw one pose (22, 3) as a stick figure, from the floor up to `top` metres."""
    across = np.cos(VIEW) * joints[:, 0] + np.sin(VIEW) * joints[:, 2]
    across = across - across[0]
    axis.plot([-_HALF_WIDTH, _HALF_WIDTH], [0, 0], color=LIGHT_GREY, linewidth=1)
    for child, parent in enumerate(PARENTS):
        if parent >= 0:
            bone = [child, parent]
            axis.plot(across[bone], joints[bone, 1], color=limb_colour(child), linewidth=2.4, solid_capstyle="round")
    head = JOINT_INDEX["head"]
    axis.plot(across[head], joints[head, 1] + 0.06, "o", color=GREY, markersize=9)
    axis.set(xlim=(-_HALF_WIDTH, _HALF_WIDTH), ylim=(-0.1, top), aspect="equal")
    axis.axis("off")
    axis.text(0.5, -0.03, label, transform=axis.transAxes, ha="center", va="top", fontsize=9, color=GREY)


def _draw_path(axis: Axes, joints: FloatArray, frames: IntArray) -> None:
    """Draw the path of the pelvis from above, with an arrow in the facing direction at each of `frames`."""
    # seen from above with +Z up the page, the body's left side (+X) is on the left
    side, ahead = -joints[:, 0, 0], joints[:, 0, 2]
    heading = facing_angle(joints)[frames]
    axis.plot(side, ahead, color=LIGHT_GREY, linewidth=3)
    axis.quiver(
        *(side[frames], ahead[frames], -np.sin(heading), np.cos(heading)),
        color=GREY, scale=9, width=0.012, pivot="tail",
    )  # fmt: skip
    centre = [(float(values.min()) + float(values.max())) / 2 for values in (side, ahead)]
    half = max(1.0, 0.6 * float(np.ptp(side)) + 0.3, 0.6 * float(np.ptp(ahead)) + 0.3)
    axis.set(xlim=(centre[0] - half, centre[0] + half), ylim=(centre[1] - half, centre[1] + half), aspect="equal")
    axis.set_title("from above, metres", fontsize=8, color=GREY)
    axis.tick_params(labelsize=7, colors=GREY)
    axis.yaxis.tick_right()
    for spine in axis.spines.values():
        spine.set_color(LIGHT_GREY)
