"""A user's BVH skeleton, and a clip on it: joints, offsets and channels are theirs, the motion is ours.

The rest pose is the one of the OFFSETs, with all rotations zero. Position channels replace the OFFSET, as in
`formats.bvh`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from kinegraph.arrays import Floats
from kinegraph.errors import InvalidInputError
from kinegraph.formats.bvh import euler_angles
from kinegraph.motion.quaternions import IDENTITY, to_matrix
from kinegraph.motion.retargeting import RigMotion
from kinegraph.motion.rig import Rig

_MAX_LINES: Final = 20_000
_AXES: Final = {"X": 0, "Y": 1, "Z": 2}


@dataclass(frozen=True, eq=False)
class BvhSkeleton:
    """The HIERARCHY of a file."""

    lines: tuple[str, ...]
    """Its lines, up to MOTION."""
    rig: Rig
    """Joints in the order of the file; End Sites are joints without channels."""
    channels: tuple[tuple[str, ...], ...]
    """Channels of each joint in the order of the file: "Xposition", "Zrotation" ..."""

    def moves(self, joint: int) -> bool:
        """Whether a joint has the three position channels."""
        return {f"{axis}position" for axis in _AXES} <= set(self.channels[joint])


def read_skeleton(data: bytes) -> BvhSkeleton:
    """Read the HIERARCHY of a BVH file; the MOTION is not looked at.

    Raises:
        InvalidInputError: not a BVH file, or channels that are none.
    """
    try:
        lines = data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise InvalidInputError("it is no text in UTF-8") from error
    names: list[str] = []
    parents: list[int] = []
    offsets: list[list[float]] = []
    channels: list[tuple[str, ...]] = []
    open_joints: list[int] = []
    for number, line in enumerate(lines[:_MAX_LINES]):
        words = line.split()
        match words:
            case [] | ["HIERARCHY"] | ["{"]:
                continue
            case ["ROOT" | "JOINT", *name] if name:
                parents.append(open_joints[-1] if open_joints else -1)
                names.append(" ".join(name))
            case ["End", "Site"] if open_joints:
                parents.append(open_joints[-1])
                names.append(f"end of {names[open_joints[-1]]}")
            case ["OFFSET", x, y, z] if len(offsets) == len(names) - 1:
                offsets.append(_numbers(x, y, z))
                channels.append(())
                open_joints.append(len(names) - 1)
            case ["CHANNELS", count, *kinds] if open_joints and count == str(len(kinds)):
                channels[open_joints[-1]] = _check_channels(names[open_joints[-1]], kinds)
            case ["}"] if open_joints:
                open_joints.pop()
            case ["MOTION"] if names and not open_joints and len(offsets) == len(names):
                return _assembled(tuple(lines[:number]), names, parents, offsets, channels)
            case _:
                raise InvalidInputError(f"line {number + 1} of its HIERARCHY is not understood: {line.strip()[:60]!r}")
    raise InvalidInputError("its HIERARCHY does not end with MOTION")


def encode(skeleton: BvhSkeleton, motion: RigMotion, fps: float) -> bytes:
    """Write the skeleton with a motion; joints that it does not turn stay as they rest.

    Args:
        skeleton: of the file.
        motion: tracks of its joints; a position of a joint without position channels is given to the one above that
            has them.
        fps: frames per second.

    Raises:
        InvalidInputError: a joint that must turn has not three rotation channels, or none can travel.
    """
    frames = len(next(iter(motion.rotations.values())))
    positions = {node: skeleton.rig.translations[node] for node in range(len(skeleton.rig.names))}
    for node, track in motion.translations.items():
        mover = next((above for above in skeleton.rig.ancestors(node) if skeleton.moves(above)), None)
        if mover is None:
            raise InvalidInputError(f"neither {skeleton.rig.names[node]!r} nor a joint above has position channels")
        # joints between the two do not turn, so their offsets are what lies between
        positions[mover] = track - (skeleton.rig.translations[node] - skeleton.rig.translations[mover]) * (
            mover != node
        )
    columns: list[Floats] = []
    for node, kinds in enumerate(skeleton.channels):
        axes = tuple(_AXES[kind[0]] for kind in kinds if kind.endswith("rotation"))
        angles = np.zeros((frames, 3))
        if node in motion.rotations:
            if len(axes) != 3:
                raise InvalidInputError(f"{skeleton.rig.names[node]!r} must turn, and has not three rotation channels")
            turns = np.degrees(euler_angles(to_matrix(motion.rotations[node][:, None]), axes))[:, 0]
            angles[:, list(axes)] = turns
        for kind in kinds:
            axis = _AXES[kind[0]]
            place = np.broadcast_to(positions[node], (frames, 3))
            columns.append((angles if kind.endswith("rotation") else place)[:, axis])
    rows = np.round(np.stack(columns, axis=1), 6) + 0.0
    lines = [*skeleton.lines, "MOTION", f"Frames: {frames}", f"Frame Time: {1.0 / fps:.8f}"]
    lines += [" ".join(f"{value:.6f}" for value in row) for row in rows]
    return ("\n".join(lines) + "\n").encode()


def _numbers(*words: str) -> list[float]:
    try:
        numbers = [float(word) for word in words]
    except ValueError as error:
        raise InvalidInputError(f"an OFFSET is no number: {' '.join(words)[:60]!r}") from error
    if not np.isfinite(numbers).all():
        raise InvalidInputError("an OFFSET is not finite")
    return numbers


def _check_channels(name: str, kinds: list[str]) -> tuple[str, ...]:
    known = {f"{axis}{kind}" for axis in _AXES for kind in ("position", "rotation")}
    if len(set(kinds)) != len(kinds) or not known.issuperset(kinds):
        raise InvalidInputError(f"{name[:60]!r} has the channels {' '.join(kinds)[:120]!r}")
    return tuple(kinds)


def _assembled(
    lines: tuple[str, ...],
    names: list[str],
    parents: list[int],
    offsets: list[list[float]],
    channels: list[tuple[str, ...]],
) -> BvhSkeleton:
    count = len(names)
    rig = Rig(
        tuple(names),
        tuple(parents),
        np.array(offsets),
        np.tile(np.array(IDENTITY), (count, 1)),
        np.ones((count, 3)),
        (frozenset(range(count)),),
    )
    return BvhSkeleton(lines, rig, tuple(channels))
