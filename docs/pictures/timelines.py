"""Draw timeline_path.png: a path for the whole body and a wave for the left arm alone, in one run of skeleton space."""

from __future__ import annotations

import sys

from constraints import draw, s_curve

from kinegraph import MotionPipeline
from kinegraph.intervals import Interval


def main() -> None:
    pipe = MotionPipeline.load(sys.argv[1] if len(sys.argv) > 1 else None)
    timeline = [
        Interval("a person walks forward", 0, 6),
        Interval("a person waves the left hand", 1.5, 5, ("left arm",)),
    ]
    path = s_curve()
    clip = pipe.timeline(timeline, constraints=[path], space="frames", seed=5)
    draw("timeline_path.png", clip, path.points, "-")


if __name__ == "__main__":
    main()
