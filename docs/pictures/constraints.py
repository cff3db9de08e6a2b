"""Draw constraint_path.png, constraint_spot.png and constraint_between.png; what was asked is green."""

from __future__ import annotations

from pathlib import Path as FilePath

import numpy as np
from matplotlib.figure import Figure

from kinegraph import Clip, EndPose, MotionPipeline, Path, StartPose, Waypoint
from kinegraph.formats.contact_sheet import POSES, draw_row, png_bytes, title_line

GREEN = "#15803d"
FOLDER = FilePath(__file__).parent


def s_curve() -> Path:
    """An S of four metres, as somebody draws it: first to the left, then to the right."""
    ahead = np.linspace(0.0, 4.0, 33)
    return Path(np.column_stack([0.7 * np.sin(ahead * np.pi / 2), ahead]))


def draw(name: str, clip: Clip, places: np.ndarray, marker: str) -> None:
    """Draw a clip's contact sheet with places (n, 2), x and z, on its path from above."""
    figure = Figure(figsize=(1.4 * (POSES + 1.5), 2.9), dpi=110)
    axes = figure.subplots(1, POSES + 1, width_ratios=[1.0] * POSES + [1.5])
    draw_row(axes, clip.joints, clip.fps)
    axes[-1].plot(-places[:, 0], places[:, 1], marker, color=GREEN, linewidth=1.2, markersize=8)
    figure.suptitle(title_line(clip.text), fontsize=12, y=0.97)
    figure.subplots_adjust(left=0.01, right=0.97, bottom=0.14, top=0.88, wspace=0.02)
    (FOLDER / name).write_bytes(png_bytes(figure))


def main() -> None:
    pipe = MotionPipeline.load()
    path = s_curve()
    walk = pipe.generate("a person walks forward", seconds=5, seed=7, constraints=[path])
    draw("constraint_path.png", walk, path.points, "-")

    spot = (0.8, 2.0)
    pinned = [Waypoint(seconds, spot) for seconds in (3.0, 4.5, 6.0)]
    wave = pipe.generate("a person walks forward, then waves the right hand", seconds=6, seed=3, constraints=pinned)
    draw("constraint_spot.png", wave, np.array([spot]), "+")

    bow = pipe.generate("a person bows", seconds=3, seed=1)
    raised = pipe.generate("a person raises both hands", seconds=3, seed=1)
    between = pipe.generate(
        "a person stands",
        seconds=3,
        seed=2,
        constraints=[
            StartPose(bow.joints[28:32], fps=bow.fps),
            EndPose(raised.joints[28:32], fps=raised.fps),
        ],
    )
    draw("constraint_between.png", between, np.zeros((1, 2)), "+")


if __name__ == "__main__":
    main()
