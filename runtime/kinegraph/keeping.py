"""What an edit keeps of a clip: spans of time, and parts of the body.

Legs are kept where they are in the world, and the pelvis with them: they carry the person. Parts of the upper body are
kept relative to the pelvis and its heading, so that they come along wherever the new motion goes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import DoubleArray, Floats
from kinegraph.constraints import Miss
from kinegraph.errors import InvalidInputError
from kinegraph.motion.energies import Energy, position_energy, relative_energy, to_own_frames
from kinegraph.motion.quaternions import about_axis, rotate
from kinegraph.motion.reaching import Pins
from kinegraph.motion.skeleton import HORIZONTAL, JOINT_INDEX, PELVIS, facing_angle
from kinegraph.validation import finite_number, short_repr

_LEG: Final = ("hip", "knee", "ankle", "foot")
_ARM: Final = ("collar", "shoulder", "elbow", "wrist")


def _limb(names: Sequence[str], *sides: str) -> tuple[int, ...]:
    return tuple(JOINT_INDEX[f"{side}_{name}"] for side in sides for name in names)


PARTS: Final[Mapping[str, tuple[int, ...]]] = MappingProxyType(
    {
        "legs": (PELVIS, *_limb(_LEG, "left", "right")),
        "left leg": (PELVIS, *_limb(_LEG, "left")),
        "right leg": (PELVIS, *_limb(_LEG, "right")),
        "arms": _limb(_ARM, "left", "right"),
        "left arm": _limb(_ARM, "left"),
        "right arm": _limb(_ARM, "right"),
        "head": (JOINT_INDEX["neck"], JOINT_INDEX["head"]),
        "torso": tuple(JOINT_INDEX[name] for name in ("spine1", "spine2", "spine3", "neck")),
    }
)
"""Part of the body -> its joints."""


@dataclass(frozen=True)
class Kept:
    """What is kept of a motion."""

    joints: DoubleArray
    """(frames, 22, 3) metres, the motion as it was."""
    parts: tuple[str, ...]
    """Of `PARTS`, kept over all frames."""
    spans: tuple[tuple[int, int], ...]
    """Half-open spans of frames in which the whole body is kept."""

    @cached_property
    def world(self) -> NDArray[np.bool_]:
        """Tell which joints are kept where they are: (frames, 22)."""
        kept = np.zeros(self.joints.shape[:2], dtype=np.bool_)
        for start, end in self.spans:
            kept[start:end] = True
        for part in self.parts:
            if PELVIS in PARTS[part]:
                kept[:, list(PARTS[part])] = True
        return kept

    @cached_property
    def relative(self) -> NDArray[np.bool_]:
        """Tell which joints are kept relative to the pelvis: (frames, 22)."""
        kept = np.zeros(self.joints.shape[:2], dtype=np.bool_)
        for part in self.parts:
            if PELVIS not in PARTS[part]:
                kept[:, list(PARTS[part])] = True
        return kept & ~self.world

    @cached_property
    def own(self) -> DoubleArray:
        """Place the joints relative to the pelvis and its heading: (frames, 22, 3) metres."""
        return to_own_frames(self.joints)[0]

    def energy(self, joints: Floats) -> Energy:
        """Compute half the mean squared distance of what is kept, and its gradient."""
        total, gradient = 0.0, np.zeros(joints.shape)
        world, relative = self.world, self.relative
        if world.any():
            weight = np.repeat(world[..., None] / world.sum(), 3, axis=-1)
            value, slope = position_energy(joints, self.joints, weight)
            total, gradient = total + value, gradient + slope
        if relative.any():
            value, slope = relative_energy(joints, self.own, relative / relative.sum())
            total, gradient = total + value, gradient + slope
        return total, gradient

    def pins(self, joints: Floats) -> Pins:
        """Tell where what is kept has to be in a motion."""
        turned = rotate(about_axis(1, facing_angle(joints.astype(np.float32)).astype(np.float64))[:, None], self.own)
        placed = turned + joints[:, :1] * HORIZONTAL
        world = self.world[..., None]
        wanted = world | self.relative[..., None]
        return Pins(np.where(world, self.joints, placed), np.broadcast_to(wanted, joints.shape).copy())

    def miss(self, joints: Floats) -> Miss:
        """Measure how far a motion is from what is kept."""
        pins = self.pins(joints)
        distance = np.linalg.norm(joints - pins.target, axis=-1)[pins.wanted.any(axis=-1)]
        return Miss("what is kept", float(distance.mean()), float(distance.max()))


def check_keep(keep: object, joints: Floats, fps: float) -> Kept:
    """Check what an edit is asked to keep of a motion.

    Args:
        keep: names of `PARTS`, and pairs (begin, end) of seconds; one of them, or a list.
        joints: (frames, 22, 3) metres, of the motion.
        fps: frames per second.

    Raises:
        InvalidInputError: nothing, everything, an unknown part, or a span outside the motion.
    """
    items = [keep] if isinstance(keep, str) or _is_span(keep) else keep
    if not isinstance(items, list | tuple) or not items:
        raise InvalidInputError(
            f"keep is a list of parts ({', '.join(PARTS)}) and of spans (begin, end) in seconds, not {short_repr(keep)}"
        )
    parts: list[str] = []
    spans: list[tuple[int, int]] = []
    duration = len(joints) / fps
    for item in items:
        if isinstance(item, str):
            if item not in PARTS:
                raise InvalidInputError(f"keep names {short_repr(item)}; the parts are {', '.join(PARTS)}")
            parts.append(item)
            continue
        if not _is_span(item):
            raise InvalidInputError(f"keep holds {short_repr(item)}; it must be a part or (begin, end) in seconds")
        begin, end = (finite_number(value) for value in item)
        if begin is None or end is None or not 0 <= begin < end <= duration + 1e-6:
            raise InvalidInputError(f"a span to keep must rise from 0 to {duration:g} s, not {short_repr(item)}")
        first = min(round(begin * fps), len(joints) - 1)
        spans.append((first, max(round(end * fps), first + 1)))
    kept = Kept(joints.astype(np.float64), tuple(dict.fromkeys(parts)), tuple(spans))
    if (kept.world | kept.relative).all():
        raise InvalidInputError(f"keep names all of the clip, {short_repr(keep)}; leave something to the sentence")
    return kept


def _is_span(value: object) -> bool:
    if not isinstance(value, tuple | list) or len(value) != 2:
        return False
    return not any(isinstance(part, str | tuple | list) for part in value)
