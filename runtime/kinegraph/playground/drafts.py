"""Drafts of clips under constraints, for who drags them: the clip of the same words, bent to where they are now.

Nothing is sampled: the joints of the clip that was made last are corrected (`motion.reaching`), however far that is. So
a draft is there at once, and shows where, not how; the clip itself follows.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from kinegraph.clip import Clip
from kinegraph.constrained_denoising import Wanted
from kinegraph.motion.reaching import Pins, reach
from kinegraph.motion.skeleton import bone_lengths
from kinegraph.part_memory import PartMemory
from kinegraph.playground.schemas import ClipRequest

MAX_DRAFTS: Final = 8
"""Clips that are kept to be bent."""
MAX_FRAMES: Final = 600
"""Frames of a clip that is bent: the time grows with their cube."""


class Drafts:
    """The latest clip of each words, options and seed, whatever its constraints. Not shared by threads."""

    def __init__(self) -> None:
        self._clips = PartMemory(MAX_DRAFTS)

    def keep(self, request: ClipRequest, clip: Clip) -> None:
        """Keep a clip as it was made, neither looped nor in place."""
        if request.seed is not None and clip.frames <= MAX_FRAMES:
            self._clips.keep(_words(request), clip)

    def draft(self, request: ClipRequest) -> Clip | None:
        """Bend the clip of the same words to the constraints of a request; None where there is none.

        Raises:
            InvalidInputError: as in `feasibility.check_constraints`.
        """
        clip = self._clips.get(_words(request))
        return None if clip is None else bent(clip, request)


def bent(clip: Clip, request: ClipRequest) -> Clip:
    """Correct the joints of a clip for the constraints of a request; as far as bones allow, the places are met."""
    wanted = Wanted(request.constraints, 1.0, fix=True, strict=False).for_clip(clip.frames, clip.fps)
    pins = wanted.pins(clip.joints, clip.fps)
    lengths = np.median(bone_lengths(clip.joints), axis=0)
    joints = reach(
        clip.joints, Pins(pins.target, pins.wanted, certain=pins.wanted), lengths, clip.fps, foot_fix=request.foot_fix
    )
    return replace(clip, joints=joints, notes=(), misses=wanted.misses(joints, clip.fps))


def _words(request: ClipRequest) -> str:
    """All of a request but its constraints and what is done to the clip afterwards."""
    return repr(replace(request, constraints=(), constraint_weight=1.0, draft=False, loop=False, in_place=False))
