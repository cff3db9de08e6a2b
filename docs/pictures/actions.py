"""Draw actions.png: 40 sentences by the default bundle, six moments of each clip; what it does, and what not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from kinegraph import Clip, MotionPipeline
from kinegraph.formats.contact_sheet import limb_colour, png_bytes
from kinegraph.motion.skeleton import JOINT_INDEX, PARENTS

ACTIONS = (
    "walks forward", "walks backward", "runs in a circle to the left", "makes a U-turn", "turns left", "stands still",
    "sits down", "gets up from the floor", "falls down", "crouches", "jumps up", "jumps forward",
    "hops on the left leg", "skips", "kicks high", "punches with the right hand", "boxes", "dribbles a basketball",
    "shoots a ball", "catches a ball", "plays table tennis", "plays tennis", "waves the right hand",
    "waves both hands", "raises the left hand", "raises both hands", "claps", "nods", "bows", "laughs",
    "picks something up from the floor", "reaches up with the right hand", "climbs a ladder", "is pushed forward",
    "dances salsa", "dances ballet", "walks proudly", "walks like an old person", "limps",
    "walks forward and waves the left hand",
)  # fmt: skip
COLUMNS, MOMENTS, SEED = 2, 6, 1
APART = 1.15
"""Metres between the bodies of two moments."""
VIEW = np.radians(35)


def draw(axis: Axes, clip: Clip) -> None:
    """Draw the body at `MOMENTS` moments of a clip side by side, turned as it is turned."""
    frames = np.linspace(0, len(clip.joints) - 1, MOMENTS).round().astype(int)
    for place, joints in enumerate(clip.joints[frames]):
        across = np.cos(VIEW) * joints[:, 0] + np.sin(VIEW) * joints[:, 2]
        across = across - across[0] + APART * place
        for child, parent in enumerate(PARENTS):
            if parent >= 0:
                bone = [child, parent]
                axis.plot(
                    across[bone], joints[bone, 1], color=limb_colour(child), linewidth=1.6, solid_capstyle="round"
                )
        head = JOINT_INDEX["head"]
        axis.plot(across[head], joints[head, 1] + 0.06, "o", color="#666666", markersize=5)
    axis.plot([-APART / 2, APART * (MOMENTS - 0.5)], [0, 0], color="#cccccc", linewidth=1)
    axis.set(xlim=(-APART / 2, APART * (MOMENTS - 0.5)), ylim=(-0.05, 2.25), aspect="equal")
    axis.set_title(f"{clip.text}, {len(clip.joints) / clip.fps:.1f} s", fontsize=8, loc="left", pad=1)
    axis.axis("off")


def main() -> None:
    pipe = MotionPipeline.load()
    rows = -(-len(ACTIONS) // COLUMNS)
    figure = Figure(figsize=(5.2 * COLUMNS, 1.72 * rows), dpi=75)
    axes = figure.subplots(rows, COLUMNS).ravel()
    for axis, action in zip(axes, ACTIONS, strict=True):
        draw(axis, pipe.generate(f"a person {action}", seed=SEED))
    figure.subplots_adjust(0.01, 0.003, 0.99, 0.988, 0.02, 0.12)
    Path(__file__).with_name("actions.png").write_bytes(png_bytes(figure))


if __name__ == "__main__":
    main()
