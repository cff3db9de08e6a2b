"""Limits of one call; beyond them a typed error is raised before any model runs."""

from __future__ import annotations

from typing import Final

MAX_TEXT: Final = 512
"""Characters of a caption."""

MAX_PIECES: Final = 512
"""Word pieces of a caption, two special ones included: the positions that the text encoder was trained with."""

MAX_NODES: Final = 32
"""Nodes of one semantic graph, the motion node included."""

MAX_FRAMES: Final = 196
"""Frames of one generated clip (HumanML3D's limit; 9.8 s at 20 frames per second)."""

MAX_READ_FRAMES: Final = 200_000
"""Frames of a saved clip that is read: an hour at 50 per second."""

MAX_TAKES: Final = 64
"""Clips of one call."""

MAX_SHARED: Final = 32
"""Clips of one shared run: their keys and values and the decoder's buffers take 150 MB."""

MAX_PARTS: Final = 256
"""Sentences of one sequence."""

MAX_ROWS: Final = 48
"""Graphs whose noise predictions make up one clip: concepts, joint text, and those of weighted edges."""

MAX_CONCEPTS: Final = 8
"""Concepts of one composition."""

MAX_CONSTRAINTS: Final = 256
"""Constraints of one clip."""

MAX_KEYFRAMES: Final = 64
"""Whole poses among them."""

MAX_PATH_POINTS: Final = 1000
"""Points of one path."""

MAX_POSE_FRAMES: Final = 40
"""Frames of a start or end pose."""

MAX_METRES: Final = 1000.0
"""Farthest place that a constraint names, along each axis."""

MAX_WEIGHT: Final = 100.0
"""Largest weight of a constraint."""
